"""The first part of the demo: an arm identified from its files, as a user does it.

The files are those of `jaxcslc example panda`: a URDF and two simulated logs, whose truth is known.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
from jaxcslc.report import (
    AbstractBlock,
    ArmChart,
    Code,
    Column,
    Grid,
    Link,
    Page,
    PanelChart,
    Picture,
    Section,
    Table,
)
from scripts.tools.readme_picture import picture


FOLDER = "panda"  # of the files, beside the page
COMMANDS = """\
jaxcslc example panda        # a robot file and two logs; or your own
cd panda
jaxcslc identify panda.urdf train.csv --validate validation.csv -o results
jaxcslc export panda.urdf results -o panda_identified.urdf
jaxcslc excite panda.urdf --previous results --duration 10 -o next.csv"""
_IDENTIFY = COMMANDS.splitlines()[2]
_SIMULATED = 0.5  # s of simulation that is reported


@dataclasses.dataclass(frozen=True)
class OwnArm:
    """An arm that was identified from its files.

    **Attributes**

    - `report`: what `jaxcslc identify` writes.
    - `truth`: the true coefficients.
    - `distances`: errors of the hand's position after half a second of simulation by recorded
      torques, with identified parameters and with those of the file [m]; None if there was none.
    """

    report: jc.Report
    truth: np.ndarray
    distances: tuple[float, float] | None

    @property
    def contained(self) -> str:
        """Return how many intervals contain the truth."""
        table = self.report.to_pandas()
        inside = (table["low"] <= self.truth) & (self.truth <= table["high"])
        return f"{int(inside.sum())} of {len(self.truth)} intervals contain the true value"

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return what the truth, and a simulation if there is one, say of the report."""
        return (self.contained,) if self.simulated is None else (self.contained, self.simulated)

    @property
    def simulated(self) -> str | None:
        """The errors of the simulation in a sentence; None if nothing was simulated."""
        if self.distances is None:
            return None
        identified, file = self.distances
        return (
            f"in a simulation of {_SIMULATED:g} s by recorded torques alone, the hand ends"
            f" {1e3 * identified:.1f} mm off; with the robot file's values {1e3 * file:.0f} mm"
        )


def identify_example(folder: Path, *, quick: bool = False) -> OwnArm:
    """Write the example's files and its report into `folder`.

    **Arguments**

    - `quick`: without the simulation, which takes half a minute.
    """
    example = jc.examples.write_example("panda", folder)
    network = jc.derive(jc.load_robot(example.robot))
    train, held_out = (
        jc.load_recording(path, joints=7) for path in (example.train, example.validation)
    )
    report = jc.identify(  # as the command does by default
        network, train, validation=held_out, friction="offset", simulate=not quick
    )
    report.save(folder / "results", command=_IDENTIFY + " --simulate" * (not quick))
    truth = np.asarray(jc.examples.read_truth(example, report.network))
    drawing = picture(report, train, held_out, truth)
    (folder / "identify.svg").write_text(drawing, encoding="utf-8")
    return OwnArm(report, truth, None if quick else _distances(report))


def _distances(report: jc.Report) -> tuple[float, float]:
    row = report.horizon.horizons.tolist().index(_SIMULATED)
    identified, file = (float(report.horizon.distance[name][row]) for name in ("fit", "file"))
    return identified, file


def own_arm_sections(arm: OwnArm) -> list[Section]:
    """Sections of the page: what to type, and what comes back."""
    page = arm.report.page()
    results = [
        Picture(
            f"{FOLDER}/identify.svg",
            "Motion of the second log, which the fit has not used; torque of joint 4; and intervals"
            " of some coefficients as the fit gets more seconds of the first log.",
        ),
        _friction_table(arm),
        *_charts(page),
        Link(f"{FOLDER}/results/index.html", "The full report: every joint and coefficient"),
    ]
    return [
        Section(
            "Identify an arm from its files",
            "You need a robot file and a log of positions and torques. The second log only judges."
            " These commands made what follows:",
            (Code(COMMANDS),),
        ),
        Section(
            "What comes back",
            "Parameters with intervals, a verdict for each, errors on held-out motion, and a robot"
            " file with physically consistent masses and inertias.",
            results,
        ),
    ]


def _friction_table(arm: OwnArm) -> Table:
    """Identified and true friction of each joint; the truth is known because it was simulated."""
    rows = dict(zip(arm.report.names, arm.report.rows(), strict=True))
    truth = dict(zip(arm.report.names, arm.truth, strict=True))

    def column(stem: str, entry: str) -> Iterator[str]:
        for name in (f"{stem}{joint}" for joint in range(1, 8)):
            row = rows[name]
            half = 0.5 * (float(row["high"]) - float(row["low"]))
            value = float(row["value"])
            yield f"{value:.3f} ± {half:.3f}" if entry == "value" else f"{truth[name]:.3f}"

    return Table.from_columns(
        (
            (Column("joint"), range(1, 8)),
            (Column("Coulomb friction [N m]"), column("kd", "value")),
            (Column("true [N m]"), column("kd", "true")),
            (Column("viscous friction [N m s/rad]"), column("kv", "value")),
            (Column("true [N m s/rad]"), column("kv", "true")),
        ),
        f"Friction with 95 % intervals, and the truth of the simulation. {arm.contained}.",
        "friction",
    )


def _charts(page: Page) -> list[AbstractBlock]:
    """The arm's bodies; measured and predicted torque of a shoulder and an elbow joint."""
    blocks = [block for section in page.sections for block in _flattened(section.blocks)]
    (bodies,) = (block for block in blocks if isinstance(block, ArmChart))
    # The validation recording comes first, a chart per joint.
    torques = [block for block in blocks if isinstance(block, PanelChart)]
    shown = [
        dataclasses.replace(
            torques[joint - 1],
            caption=f"Joint {joint} on the second log: measured and predicted torque, and residual",
        )
        for joint in (2, 4)
    ]
    return [bodies, Grid(tuple(shown))]


def _flattened(blocks: Sequence[AbstractBlock]) -> Iterator[AbstractBlock]:
    for block in blocks:
        yield block
        yield from _flattened(getattr(block, "blocks", ()))

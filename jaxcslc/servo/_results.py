"""Report on an arm of servos: errors of simulated positions, parameters, and files for simulators.

Text, JSON, a page, the MuJoCo model, and C code of commands; read with `_fit`, `_mjcf` and
`_feedforward`.
"""

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .._text_table import text_table
from ..manipulator import Manipulator, link_poses
from ..report import (
    Code,
    Column,
    Curve,
    Details,
    Link,
    Message,
    Messages,
    Page,
    Panel,
    PanelChart,
    Section,
    Table,
    Value,
    all_or_nothing,
    envelope,
    notebook_frame,
    render,
    rounded,
    write_csv,
    write_json,
)
from ._drive import DRIVE_UNITS
from ._feedforward import servo_feedforward
from ._fit import ServoFit
from ._mjcf import replay_in_mujoco, write_servo_mjcf
from ._recording import ServoRecording


LONGEST_LAG = 0.3
"""Longest delay of the command that errors are compared with [s]: slow servos lag by 0.24 s."""

SERVO_FILES = ("index.html", "servo.json", "parameters.csv", "servos.xml")
"""Files of a report on servos, besides C code named after the robot."""

_PAGE, _DOCUMENT, _PARAMETERS, _MODEL = SERVO_FILES
_MOST_POINTS = 2000  # of a curve of the page

Positions = Float[np.ndarray, "samples joints"]


@dataclass(frozen=True, eq=False)
class ServoReport:
    """The result of `identify --drive servo`: drives, and how well their simulation moves.

    Errors are root mean squares of simulated minus measured positions. Simulations are open loop:
    they get the commands of a whole recording, and its first sample.

    **Attributes**

    - `fit`: the drives.
    - `training`, `held_out`: recordings by name; errors are those of `judged`, the held-out ones
      if there are any.
    - `simulated`: positions by recording, of `fit`.
    - `replayed`: positions by recording of `judged`, of the MuJoCo model; empty without it.
    - `lag`: delay of the command that positions of the training recordings follow best [s].
    - `model`: text of the MuJoCo model; None of robots that come from no URDF or MJCF file.
    - `approximations`: what the model cannot express, a sentence each.
    - `notes`: on the recordings.

    >>> import dataclasses
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import LinkParameters
    >>> from jaxcslc.servo import ServoDrive, ServoFit, ServoRecording, servo_report, simulate
    >>> rod = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), 0.002 * np.eye(3))
    >>> arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    >>> drive = ServoDrive(12.0, 0.8, delay=0.02, armature=0.02)
    >>> time = np.arange(100) * 0.02
    >>> command = np.sin(3.0 * time)[:, None]
    >>> position = simulate(arm, [drive], time, command, [0.0])
    >>> recording = ServoRecording(time, position, command)
    >>> fit = ServoFit(arm, (drive,), (), np.zeros((0, 0)), "torque")
    >>> report = servo_report(fit, {"sine": recording})
    >>> [row["joint"] for row in report.error_rows()]
    ['joint 1', 'all']
    """

    fit: ServoFit
    training: Mapping[str, ServoRecording]
    held_out: Mapping[str, ServoRecording]
    simulated: Mapping[str, Positions]
    replayed: Mapping[str, Positions]
    lag: float
    model: str | None = None
    approximations: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def judged(self) -> Mapping[str, ServoRecording]:
        """The recordings by which the simulation is judged."""
        return self.held_out or self.training

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(self.fit.robot.joint_names)

    def commanded(self, recording: ServoRecording) -> Positions:
        """Return the command as it was `lag` before: an arm that follows, delayed."""
        earlier = recording.time - self.lag
        rows = np.searchsorted(recording.time, earlier + 1e-9, side="right") - 1
        return recording.command[np.maximum(rows, 0)]

    def errors(self, positions: Mapping[str, Positions]) -> Float[np.ndarray, " joints"]:
        """Return the error of each joint over the judged recordings [rad or m]."""
        differences = [positions[name] - x.position for name, x in self.judged.items()]
        return np.sqrt(np.mean(np.concatenate(differences) ** 2, axis=0))

    def tip_error(self, positions: Mapping[str, Positions]) -> float:
        """Return the error of the last link's centre of mass over the judged recordings [m]."""
        robot = self.fit.robot
        offsets = np.array([drive.offset for drive in self.fit.drives])
        squares = [
            np.sum(
                (_tip(robot, positions[name] - offsets) - _tip(robot, x.position - offsets)) ** 2, 1
            )
            for name, x in self.judged.items()
        ]
        return float(np.sqrt(np.mean(np.concatenate(squares))))

    def compared(self) -> dict[str, Mapping[str, Positions]]:
        """Return the positions that are compared with those measured, by name."""
        commands = {name: self.commanded(x) for name, x in self.judged.items()}
        kinds = {"command": commands, "simulation": self.simulated, "MuJoCo": self.replayed}
        return {kind: positions for kind, positions in kinds.items() if positions}

    def error_rows(self) -> list[dict[str, Any]]:
        """Return errors by joint: in mrad, and of the simulation in steps of the encoder."""
        errors = {name: self.errors(values) for name, values in self.compared().items()}
        rows: list[dict[str, Any]] = []
        for j, name in enumerate(self.joint_names):
            step = self.fit.drives[j].encoder_step
            ticks = float(errors["simulation"][j] / step) if step else math.nan
            rows.append(
                {"joint": name, **{k: 1e3 * float(v[j]) for k, v in errors.items()}, "ticks": ticks}
            )
        everything = {k: 1e3 * float(np.sqrt(np.mean(v**2))) for k, v in errors.items()}
        return [*rows, {"joint": "all", **everything, "ticks": math.nan}]

    def parameter_rows(self) -> list[dict[str, Any]]:
        """Return the estimated parameters with their 95 % intervals, those that are determined."""
        return [
            {
                "joint": self.joint_names[p.joint],
                "parameter": p.name,
                "value": p.value,
                "low": p.low,
                "high": p.high,
                "standard_error": p.error,
                "unit": p.unit,
            }
            for p in self.fit.parameters
            if p.is_determined
        ]

    @property
    def undetermined(self) -> list[str]:
        """Parameters that the recordings do not determine, a sentence per joint."""
        by_joint: dict[int, list[str]] = {}
        for p in self.fit.parameters:
            if not p.is_determined:
                by_joint.setdefault(p.joint, []).append(p.name)
        return [f"{self.joint_names[j]}: {', '.join(names)}" for j, names in by_joint.items()]

    @property
    def confounded(self) -> list[str]:
        """Parameters that recordings cannot tell apart, with reason and remedy, a sentence each."""
        joints: dict[tuple[Any, ...], list[str]] = {}
        for pair in self.fit.confounded:
            key = pair.parameters, pair.reason, pair.remedy
            joints.setdefault(key, []).append(self.joint_names[pair.joint])
        return [
            f"{', '.join(names)}: {' and '.join(parameters)} ({reason}); {remedy}"
            for (parameters, reason, remedy), names in joints.items()
        ]

    @property
    def currents(self) -> list[str]:
        """Gains of currents, a sentence per joint."""
        sentences: list[str] = []
        for x in self.fit.currents:
            name = self.joint_names[x.joint]
            kind = "signed" if x.is_signed else "unsigned"
            if x.is_reading:
                sentences.append(
                    f"{name}: {x.value:.3g} [{x.low:.3g}, {x.high:.3g}] per N m, {kind}; torque"
                    f" explains {100.0 * x.explained:.0f} % of its variance"
                )
            else:
                sentences.append(f"{name}: {kind}, does not follow the torque")
        return sentences

    @property
    def headline(self) -> str:
        """The result in a sentence."""
        total = self.error_rows()[-1]
        kind = "motions that were not fitted" if self.held_out else "the fitted motions"
        return (
            f"Simulated positions are {total['simulation']:.1f} mrad (RMS) from those measured on"
            f" {kind}; commands {1e3 * self.lag:.0f} ms late are {total['command']:.1f} mrad off."
        )

    def document(self) -> dict[str, Any]:
        """Return the report as plain data: contents of `servo.json`."""
        return {
            "robot": self.fit.robot.name,
            "units": self.fit.units,
            "drives_for_simulation": {
                name: asdict(drive)
                for name, drive in zip(self.joint_names, self.fit.drives, strict=True)
            },
            "drive_units": DRIVE_UNITS,
            "parameters": self.parameter_rows(),
            "not_determined": self.undetermined,
            "confounded": [
                {**asdict(pair), "joint": self.joint_names[pair.joint]}
                for pair in self.fit.confounded
            ],
            "current_gains": [
                {**asdict(x), "joint": self.joint_names[x.joint]} for x in self.fit.currents
            ],
            "training": list(self.training),
            "held_out": list(self.held_out),
            "command_lag": self.lag,
            "position_error_mrad": self.error_rows(),
            "tip_error_mm": {
                name: 1e3 * self.tip_error(values) for name, values in self.compared().items()
            },
            "mujoco_approximations": list(self.approximations),
            "notes": [*self.fit.notes, *self.notes],
        }

    def __repr__(self) -> str:
        return f"ServoReport of {self.fit.robot.name}. {self.headline}"

    def _repr_html_(self) -> str:
        """Return the page without drawings, for notebooks."""
        return notebook_frame(self.page(charts=False))

    def __str__(self) -> str:
        rows = self.error_rows()
        kinds = list(self.compared())
        table = text_table(
            ["joint", *kinds, "in ticks"],
            [
                [row["joint"], *(f"{row[k]:.1f}" for k in kinds), _number(row["ticks"], ".1f")]
                for row in rows
            ],
        )
        tip = ", ".join(f"{k} {1e3 * self.tip_error(v):.1f}" for k, v in self.compared().items())
        judged = f"{len(self.judged)} recording{'' if len(self.judged) == 1 else 's'}"
        lines = [
            f"{self.fit.robot.name}: {len(self.joint_names)} servos",
            self.headline,
            "",
            f"position error [mrad RMS], open loop over {judged}"
            f" ({'held out' if self.held_out else 'those of the fit'})",
            table,
            f"centre of mass of the last link [mm RMS]: {tip}",
            "",
            "drives: value ± half of the 95 % interval",
            self._drive_table(),
        ]
        if self.fit.units == "gain":
            lines.append(
                "only ratios to the gain are determined: torques are those of the file's masses"
            )
        lines += [f"current, {sentence}" for sentence in self.currents]
        lines += [f"not determined: {sentence}" for sentence in self.undetermined]
        lines += [f"confounded, {sentence}" for sentence in self.confounded]
        lines += [f"MuJoCo: {sentence}" for sentence in self.approximations]
        lines += [f"note: {note}" for note in (*self.fit.notes, *self.notes)]
        return "\n".join(lines)

    def _drive_table(self) -> str:
        names = list(dict.fromkeys(p.name for p in self.fit.parameters if p.is_determined))
        cells = {(p.joint, p.name): p for p in self.fit.parameters if p.is_determined}

        def cell(joint: int, name: str) -> str:
            p = cells.get((joint, name))
            return "" if p is None else f"{p.value:.3g} ± {0.5 * (p.high - p.low):.1g}"

        units = {p.name: p.unit for p in self.fit.parameters}
        return text_table(
            ["", *self.joint_names],
            [
                [f"{name} [{units[name]}]", *(cell(j, name) for j in range(len(self.joint_names)))]
                for name in names
            ],
        )

    def page(self, command: str | None = None, *, charts: bool = True) -> Page:
        """Return the report's page.

        **Arguments**

        - `command`: that made the report.
        - `charts`: whether it has drawings.
        """
        rows = self.error_rows()
        kinds = list(self.compared())
        columns = (
            Column("joint", numeric=False),
            *(Column(f"{kind} [mrad]", decimals=1) for kind in kinds),
            Column("simulation [encoder steps]", decimals=1),
        )
        errors = Table(
            columns,
            tuple((r["joint"], *(r[k] for k in kinds), r["ticks"]) for r in rows),
            name="errors",
        )
        tip = Table(
            (Column("", numeric=False), Column("centre of mass of the last link [mm]", decimals=1)),
            tuple((k, 1e3 * self.tip_error(v)) for k, v in self.compared().items()),
            name="tip",
        )
        parameters = Table(
            (
                *(Column(x, numeric=False) for x in ("joint", "parameter")),
                *(Column(x) for x in ("value", "low", "high")),
                Column("unit", numeric=False),
            ),
            tuple(
                tuple[Value, ...](
                    r[x] for x in ("joint", "parameter", "value", "low", "high", "unit")
                )
                for r in self.parameter_rows()
            ),
            name="parameters",
        )
        messages = [Message(f"Not determined: {s}.") for s in self.undetermined]
        messages += [Message(f"Confounded, {sentence}.") for sentence in self.confounded]
        messages += [Message(f"Current, {sentence}.", "plain") for sentence in self.currents]
        messages += [Message(note, "plain") for note in (*self.fit.notes, *self.notes)]
        sections = [
            Section(
                "Position errors",
                "Root mean square of simulated minus measured positions, open loop over whole"
                f" recordings. Before: the command {1e3 * self.lag:.0f} ms late. After: the"
                " simulation of the identified drives, and plain MuJoCo with the exported model.",
                (errors, tip),
            ),
            Section(
                "Drives",
                "Estimates with 95 % intervals."
                + (
                    " Only ratios to the gain are determined: torques are those of the file's"
                    " masses."
                    if self.fit.units == "gain"
                    else ""
                ),
                (parameters, Messages(tuple(messages), empty="Everything is determined.")),
            ),
            *(self._chart_sections() if charts else ()),
            *self._file_sections(command),
        ]
        return Page(
            f"Servos of {self.fit.robot.name}",
            f"{len(self.training)} recordings fitted, {len(self.held_out)} held out",
            self.headline,
            "good" if rows[-1]["simulation"] < rows[-1]["command"] else "bad",
            (),
            tuple(sections),
        )

    def _chart_sections(self) -> list[Section]:
        return [
            Section(
                "Positions",
                "Measured and simulated positions over time, and their difference.",
                tuple(
                    Details(name, (self._chart(name, recording),))
                    for name, recording in self.judged.items()
                ),
            )
        ]

    def _file_sections(self, command: str | None) -> list[Section]:
        sections: list[Section] = []
        if self.model is not None:
            sentences = tuple(Message(s, "plain") for s in self.approximations)
            everything = Messages(sentences, empty="The model has all that the drives have.")
            sections.append(
                Section(
                    "MuJoCo",
                    "Position servos with the drives above. ctrl is the command that the servos"
                    " get, qpos the reading of their encoders.",
                    (Link(_MODEL), everything),
                )
            )
        if command is not None:
            sections.append(Section("Repeat", "The command of this report.", (Code(command),)))
        return sections

    def _chart(self, name: str, recording: ServoRecording) -> PanelChart:
        time = recording.time - recording.time[0]

        def curve(label: str, values: Float[np.ndarray, " samples"], look: Any) -> Curve:
            x, y = envelope(time, values, _MOST_POINTS)
            return Curve(label, rounded(x, 6), rounded(y, 6), look)

        panels: list[Panel] = []
        for j, joint in enumerate(self.joint_names):
            measured, simulated = recording.position[:, j], self.simulated[name][:, j]
            curves = (
                curve("measured", measured, "measured"),
                curve("simulated", simulated, "predicted"),
            )
            panels.append(Panel(f"{joint} [rad]", curves))
            difference = curve("difference", 1e3 * (simulated - measured), "residual")
            panels.append(Panel(f"{joint}: difference [mrad]", (difference,), height=60))
        return PanelChart(tuple(panels), "time [s]", "")

    def save(self, folder: str | Path, *, command: str | None = None) -> tuple[Path, ...]:
        """Write the report into a folder: all files or, if writing fails, none.

        `index.html`, `servo.json`, `parameters.csv`, the MuJoCo model `servos.xml`, and
        `NAME.c` with its header, the commands for wanted motions.

        **Arguments**

        - `folder`: is made if it is missing.
        - `command`: that made the report, for the page.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file.
        - `OSError`: the folder cannot be written.
        """
        folder = Path(folder)
        robot = self.fit.robot
        with all_or_nothing(folder) as scratch:
            (scratch / _PAGE).write_text(render(self.page(command)), encoding="utf-8")
            write_json(scratch / _DOCUMENT, self.document())
            write_csv(scratch / _PARAMETERS, self.parameter_rows() or [{"joint": ""}])
            if self.model is not None:
                (scratch / _MODEL).write_text(self.model, encoding="utf-8")
            code = servo_feedforward(robot, self.fit.drives)
            (scratch / f"{code.name}.h").write_text(code.header, encoding="ascii")
            (scratch / f"{code.name}.c").write_text(code.source, encoding="ascii")
            names = sorted(path.name for path in scratch.iterdir())
        return tuple(folder / name for name in names)


def servo_report(
    fit: ServoFit,
    training: Mapping[str, ServoRecording],
    held_out: Mapping[str, ServoRecording] | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> ServoReport:
    """Simulate recordings with a fit's drives, here and in plain MuJoCo, and report the errors.

    **Arguments**

    - `fit`: of `identify_servo`.
    - `training`: the recordings that were fitted, by name.
    - `held_out`: others, by which the fit is judged.
    - `progress`: is called with a few words at the start of each step.

    **Returns** the report.

    >>> import dataclasses
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import LinkParameters
    >>> from jaxcslc.servo import ServoDrive, ServoFit, ServoRecording, servo_report, simulate
    >>> rod = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), 0.002 * np.eye(3))
    >>> arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    >>> drive = ServoDrive(12.0, 0.8, delay=0.02, armature=0.02)
    >>> time = np.arange(100) * 0.02
    >>> command = np.sin(3.0 * time)[:, None]
    >>> position = simulate(arm, [drive], time, command, [0.0])
    >>> recording = ServoRecording(time, position, command)
    >>> fit = ServoFit(arm, (drive,), (), np.zeros((0, 0)), "torque")
    >>> report = servo_report(fit, {"sine": recording})
    >>> bool(report.errors(report.simulated)[0] < 0.05), list(report.compared())
    (True, ['command', 'simulation'])
    """
    step = progress or (lambda words: None)
    everything = {**training, **(held_out or {})}
    judged = held_out or training
    step("simulating recordings")
    simulated = {name: fit.simulate(recording) for name, recording in judged.items()}
    source = fit.robot.source
    text, replayed = None, {}
    approximations: tuple[str, ...] = ()
    if source is not None and source.format != "toml":
        step("replaying commands in MuJoCo")
        with tempfile.TemporaryDirectory() as folder:
            written = write_servo_mjcf(
                fit.robot,
                fit.drives,
                Path(folder) / _MODEL,
                recordings=list(training.values()),
                table=fit.table,
            )
            text = written.path.read_text(encoding="utf-8")
            replayed = {
                name: replay_in_mujoco(written.path, recording)
                for name, recording in judged.items()
            }
            approximations = written.approximations
    named: dict[str, list[str]] = {}
    for name, recording in everything.items():
        for note in recording.notes:
            named.setdefault(note, []).append(name)
    notes = [
        note if len(names) == len(everything) else f"{', '.join(names)}: {note}"
        for note, names in named.items()
    ]
    return ServoReport(
        fit,
        dict(training),
        dict(held_out or {}),
        simulated,
        replayed,
        _lag(list(training.values())),
        text,
        approximations,
        tuple(notes),
    )


def _lag(recordings: Sequence[ServoRecording]) -> float:
    """Return the delay of the command that positions follow best [s], in whole samples."""
    interval = float(np.median(np.diff(recordings[0].time)))

    def error(samples: int) -> float:
        squares = 0.0
        for recording in recordings:
            rows = np.maximum(np.arange(recording.samples) - samples, 0)
            squares += float(np.sum((recording.command[rows] - recording.position) ** 2))
        return squares

    candidates = range(max(1, math.ceil(LONGEST_LAG / interval)) + 1)
    return interval * min(candidates, key=error)


def _tip(robot: Manipulator, q: Positions) -> Float[np.ndarray, "samples three"]:
    """Return positions of the last link's centre of mass in the base frame [m]."""
    assert robot.links is not None
    pose = np.asarray(link_poses(robot, q))[:, -1]
    centre = np.asarray(robot.links[-1].centre_of_gravity, float)
    return pose[:, :3, :3] @ centre + pose[:, :3, 3]


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""

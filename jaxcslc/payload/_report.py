"""Identification of a payload from recordings, and its report: text, CSV and JSON."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .._text_table import text_table
from ..identification import recording_named
from ..least_squares import Previous, Settings, settings_document
from ..manipulator import LinkParameters, Manipulator, seen_from
from ..network import CSLC, PAYLOAD
from ..recordings import Patterns, Recording
from ..report import ErrorTable, all_or_nothing, compare, write_csv, write_json
from ..selection import choose_settings
from ._fit import PayloadFit, fit_payload


@dataclasses.dataclass(frozen=True, eq=False)
class PayloadReport:
    """The result of `identify_payload`: mass, centre of gravity and inertia of a payload.

    `print` shows what `jaxcslc payload` prints; `save` writes what it writes.

    **Attributes**

    - `network`: with the payload's ten coefficients.
    - `settings`: of preparation and fit.
    - `fit`: the `PayloadFit`, with uncertainty and the nearest body that can exist.
    - `patterns`: of the loaded recording.
    - `errors`: torque errors over them, `"with"` and `"without"` the payload's coefficients.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.puma560()).with_payload()
    >>> k = np.ones(network.size)
    >>> recording = jc.examples.swing_recording(network, k, samples=500)
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> report.errors.names
    ('with', 'without')
    """

    network: CSLC
    settings: Settings
    fit: PayloadFit
    patterns: Patterns
    errors: ErrorTable

    @property
    def file_body(self) -> LinkParameters | None:
        """The possible body in the frame of the last joint's body in the robot's URDF or MJCF.

        None where there is no such body, or no such file.
        """
        return in_last_body_frame(self.network.robot, self.fit.possible)

    def save(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `payload.csv` and `payload.json` into a folder: both or, if writing fails, none.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file.
        - `OSError`: the folder cannot be written.
        """
        folder = Path(folder)
        with all_or_nothing(folder) as scratch:
            write_csv(scratch / "payload.csv", self.fit.rows())
            write_json(
                scratch / "payload.json",
                {
                    "robot": self.network.robot.name,
                    "settings": settings_document(self.settings),
                    **self.fit.document(),
                    **_fit_document(self.network.robot, self.file_body),
                    "torque_error_rms": dict(zip(self.errors.names, self.errors.rms, strict=True)),
                },
            )
        return folder / "payload.csv", folder / "payload.json"

    def __str__(self) -> str:
        names = ["value", "low", "high", "possible"]
        table = text_table(
            ["", "unit", *names],
            [
                [row["name"], row["unit"], *(_number(row[name]) for name in names)]
                for row in self.fit.rows()
            ],
            left=("unit",),
        )
        lines = [
            f"{self.network}\nsettings: {self.settings}\n\n{table}\n",
            "frame of the last link; I.. at the centre of gravity; low and high: 95 % intervals"
            f" for {self.fit.fit.errors} errors; possible: the nearest body that can exist",
            *_determination_lines(self.fit),
        ]
        if self.file_body is not None and self.network.robot.source is not None:
            name, body = self.network.robot.source.links[-1], self.file_body
            centre = ", ".join(f"{x:.4g}" for x in np.asarray(body.centre_of_gravity))
            tensor = np.asarray(body.inertia)
            moments = ", ".join(f"{tensor[pair]:.4g}" for pair in _PAIRS)
            lines.append(
                f"possible, in the file's frame of {name}: {float(body.mass):.4g} kg at"
                f" [{centre}] m; Ixx, Iyy, Izz, Ixy, Ixz, Iyz there {moments} kg m²"
                + ("; what the motion does not determine is a guess" if _open(self.fit) else "")
            )
        units = dict.fromkeys(self.network.output_units)
        loaded, unloaded = (", ".join(f"{x:.3g}" for x in row.tolist()) for row in self.errors.rms)
        lines.append(
            f"RMS torque error [{' or '.join(units)}] over the loaded recording, joint by joint:"
            f" {loaded}"
        )
        lines.append(f"  without the payload's part: {unloaded}")
        return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""


def _open(fit: PayloadFit) -> bool:
    """Return whether the motion leaves something of the body open."""
    return not np.isfinite(np.asarray(fit.physical_error)).all()


def _determination_lines(fit: PayloadFit) -> list[str]:
    """Return lines about what the motion does not determine of the payload.

    If something of the body is open, a line lists what is determined. Without the mass, the centre
    of gravity is open, but its first moments are not.
    """
    lines = [f"not determined: {sentence}" for sentence in fit.unidentifiable]
    if not _open(fit):
        return lines
    intervals = fit.confidence_interval()
    determined = [
        f"{name} {value:.4g} ({low:.4g} to {high:.4g}) {unit}"
        for name, unit, value, (low, high), known in zip(
            PAYLOAD, _UNITS, fit.parameters.tolist(), intervals, fit.determined, strict=True
        )
        if known and low <= high  # neither is a number of a covariance that is none
    ]
    return [
        *lines,
        f"determined: {', '.join(determined) or 'nothing by itself'}",
        "pIxx to pIyz: about the origin of the last link's frame; phx to phz: mass times centre of"
        " gravity; pm: mass",
    ]


_UNITS = (*["kg m²"] * 6, *["kg m"] * 3, "kg")  # of `PAYLOAD`
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def in_last_body_frame(robot: Manipulator, body: LinkParameters | None) -> LinkParameters | None:
    """Return a body of the last link's frame in the frame of that joint's body in the file.

    None of no body, and of robots that are read from no URDF or MJCF.
    """
    source = robot.source
    if body is None or source is None or source.format == "toml":
        return None
    return seen_from(body, np.linalg.inv(source.placements[-1]))


def _fit_document(robot: Manipulator, body: LinkParameters | None) -> dict[str, Any]:
    if body is None or robot.source is None:
        return {}
    return {
        "file_body": {
            "frame": robot.source.links[-1],
            "mass": float(body.mass),
            "centre_of_gravity": np.asarray(body.centre_of_gravity),
            "inertia": np.asarray(body.inertia),
        }
    }


def identify_payload(
    network: CSLC,
    loaded: Recording,
    unloaded: Recording | None = None,
    settings: Settings | None = None,
    *,
    previous: Previous | None = None,
    progress: Callable[[str], None] | None = None,
) -> PayloadReport:
    """Identify a payload from a recording of the arm that carries it.

    `jaxcslc payload` prints and saves the report that this function returns.

    **Arguments**

    - `network`: of the arm, with or without a payload's coefficients.
    - `loaded`: the recording with the payload.
    - `unloaded`: a recording without it: the arm's coefficients are then fitted to both recordings.
    - `settings`: of preparation and fit; by default those that `choose_settings` finds for the
      loaded recording.
    - `previous`: an identification of the arm, or its coefficients, which are fixed at them. Give
      one of `unloaded` and `previous`.
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `PayloadReport`.

    **Raises**

    - `ValueError`: both or none of `unloaded` and `previous`; a recording that cannot be used, with
      its name, loaded or unloaded; or as `fit_payload`.
    - `RuntimeError`: as `fit_payload`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot).with_payload()
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, payload=body)
    >>> k = np.asarray(k)
    >>> recording = jc.examples.swing_recording(network, k, samples=500)
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> round(float(report.fit.mass), 2)
    1.5
    """
    step = progress or (lambda words: None)
    network = network.with_payload() if network.payload is None else network
    with recording_named("loaded recording"):
        if settings is None:
            step("choosing settings")
            settings = choose_settings(network, loaded).settings
        settings = settings.for_network(network)
        step("preparing patterns")
        patterns = settings.patterns(loaded)
    arm = None
    if unloaded is not None:
        with recording_named("unloaded recording"):
            arm = settings.patterns(unloaded)
    step("fitting coefficients")
    fit = fit_payload(network, patterns, arm, previous=previous, solver=settings.solver)
    step("computing errors")
    k = np.asarray(fit.fit.k)
    without = k.copy()
    without[network.layout.payload] = 0.0
    vectors = {"with": k, "without": without}
    return PayloadReport(network, settings, fit, patterns, compare(network, patterns, vectors))

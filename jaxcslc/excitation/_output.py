"""A designed motion, and its files: CSV, JointTrajectory in YAML and JSON, C header, page."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._scratch import unfinished
from ..instruments import link_poses
from ..network import CSLC
from ..report import (
    Code,
    Column,
    Curve,
    Film,
    Message,
    Page,
    Panel,
    PanelChart,
    Section,
    Table,
    render,
)
from ._criteria import EXPLANATIONS
from ._families import AbstractFamily, Parameters
from ._feasibility import Use
from ._information import Prediction, time_grid
from ._limits import Limits
from ._noise import Noise


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """A motion to record, with what it uses of limits and what it is predicted to bring.

    **Attributes**

    - `network`: whose coefficients it is for.
    - `family`, `parameters`: of the motion.
    - `limits`, `use`: what joints must not exceed, and how much of it is used.
    - `noise`: of the recording chain.
    - `prediction`: standard errors after the motion.
    - `criterion`, `value`: what was minimised, and what was reached.
    - `wanted`: names of the coefficients that it is for.
    - `scale`: by which the motion was shrunk at the end to keep all limits.
    - `notes`: sentences on assumptions.
    """

    network: CSLC
    family: AbstractFamily
    parameters: Parameters
    limits: Limits
    use: Use
    noise: Noise
    prediction: Prediction
    criterion: str
    value: float
    wanted: tuple[str, ...]
    scale: float
    notes: tuple[str, ...] = ()

    def sampled(
        self, rate: float | None = None
    ) -> tuple[Float[np.ndarray, " samples"], tuple[Float[np.ndarray, "samples joints"], ...]]:
        """Times, and `q`, `qd`, `qdd` then; by default at the recording's rate [Hz]."""
        time, _ = time_grid(self.family.duration, 1.0 / (rate or self.noise.rate))
        motion = self.family.motion(np.asarray(self.parameters, float), time)
        return time, tuple(np.asarray(x) for x in motion)

    def seconds_for(self, relative: float) -> float:
        """Return how long to repeat this motion to reach a relative standard error [s].

        It must hold for all wanted coefficients; infinite where the motion does not determine one.
        """
        indices = [self.network.names.index(name) for name in self.wanted]
        if not self.prediction.determined[indices].all():
            return np.inf
        worst = float(np.max(self.prediction.relative_error[indices]))
        return self.family.duration * max(worst / relative, 1e-12) ** 2

    def __str__(self) -> str:
        lines = [
            f"{self.network.name}: {self.family.duration:g} s, {self.family.description}",
            f"{self.criterion} ({EXPLANATIONS[self.criterion]}): {self.value:.4g}",
            f"condition number {self.prediction.condition:.4g}, of columns of unit length"
            f" {self.prediction.scaled_condition:.4g}",
            *self._errors(),
            str(self.use),
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the wanted coefficients that neither the motion nor what is known determines."""
        open_ = ~self.prediction.determined
        return tuple(name for name in self.wanted if open_[self.network.names.index(name)])

    def _errors(self) -> list[str]:
        names = [name for name in self.wanted if name not in self.undetermined]
        indices = [self.network.names.index(name) for name in names]
        relative = 100 * self.prediction.relative_error[indices]
        lines: list[str] = []
        if names:
            lines.append(
                f"predicted standard errors over sizes: median {np.median(relative):.3g} %,"
                f" largest {np.max(relative):.3g} % ({names[int(np.argmax(relative))]})"
            )
        if self.undetermined:
            lines.append(f"not determined by this motion: {', '.join(self.undetermined)}")
        return lines


_PAGE_RATE = 50.0  # of curves [Hz]
_FILM_RATE, _FRAMES = 15.0, 400  # frames a second, and at most
_TIP = 0.12  # of the last joint's axis that is drawn [m]
_QUANTITIES = (("Position", "rad"), ("Velocity", "rad/s"), ("Acceleration", "rad/s²"))


def design_page(design: Design, command: str = "") -> str:
    """A page of a design: what it will bring, the motion against its limits, margins."""
    headline, left = _headline(design), design.undetermined
    sections = [_predicted(design), *_film(design), *_motion(design), _margins(design)]
    if command:
        sections.append(Section("Command", "", (Code(command),)))
    page = Page(
        f"Motion for {design.network.name}",
        design.family.description,
        headline,
        "good",
        (
            *([Message(f"Not determined: {', '.join(left)}.", "caution")] if left else []),
            *(Message(note, "plain") for note in design.notes),
        ),
        tuple(sections),
    )
    return render(page)


def _headline(design: Design) -> str:
    names = [name for name in design.wanted if name not in design.undetermined]
    spent = f"{design.family.duration:g} s of this motion determine"
    if not names:
        return f"{spent} none of the coefficients."
    indices = [design.network.names.index(name) for name in names]
    relative = 100 * design.prediction.relative_error[indices]
    worst = int(np.argmax(relative))
    return (
        f"{spent} {len(names)} coefficients to {np.median(relative):.2g} % of their size (median),"
        f" {names[worst]} to {relative[worst]:.2g} %."
    )


def _predicted(design: Design) -> Section:
    rows = tuple(
        (
            row["name"],
            row["unit"],
            row["prior"],
            196 * row["error_before"] / size,
            196 * row["relative"] if known else float("inf"),
        )
        for row, size, known in zip(
            design.prediction.rows(),
            design.prediction.size,
            design.prediction.determined.tolist(),
            strict=True,
        )
    )
    columns = (
        Column("coefficient", numeric=False),
        Column("unit", numeric=False),
        Column("prior value"),
        Column("interval before [%]", "half of a 95 % interval over the size", 3),
        Column("interval after [%]", "half of a 95 % interval over the size", 3),
    )
    lead = (
        f"Designed for: {design.criterion}, {EXPLANATIONS[design.criterion]}; reached"
        f" {design.value:.4g}. The condition number of the regressor is"
        f" {design.prediction.condition:.4g}, with columns of unit length"
        f" {design.prediction.scaled_condition:.4g}."
    )
    return Section("Predicted intervals", lead, (Table(columns, rows, name="predicted"),))


def _film(design: Design) -> list[Section]:
    robot, duration = design.network.robot, design.family.duration
    if any(
        length.value is None for joint in robot.joints for length in (joint.a, joint.b, joint.d)
    ):
        return []  # lengths that are symbols have no positions
    _, (q, _, _) = design.sampled(min(_FILM_RATE, _FRAMES / duration))
    q = np.asarray(design.network.positions_of_all_joints(q))
    n = robot.joint_count
    frames = np.zeros((len(q), n + 1, 2, 3))
    for frame, pose in zip(frames, q, strict=True):
        links = [np.asarray(link) for link in link_poses(robot, pose)]
        frame[:n, 1] = [link[:3, 3] for link in links]
        frame[:n, 0] = [np.zeros(3) if i < 0 else frame[i, 1] for i in robot.parents]
        frame[n] = links[-1][:3, 3] + [np.zeros(3), _TIP * links[-1][:3, 2]]
    caption = f"Lines from joint to joint; {duration:g} s, over and over"
    lead = "The arm in motion; at the end, with a dot, the axis of the last joint."
    return [Section("Film", lead, (Film(frames, duration, caption),))]


def _motion(design: Design) -> list[Section]:
    time, motion = design.sampled(_PAGE_RATE)
    limits, sections = design.limits, []
    names = design.network.output_names
    for order, ((title, unit), values) in enumerate(zip(_QUANTITIES, motion, strict=True)):
        middle, half = limits.symmetric(order)
        lead = f"The motion and its limits, joint by joint [{unit}; m of prismatic joints]."
        sections.append(
            Section(title, lead, (_chart(names, time, values, middle - half, middle + half),))
        )
    if np.any(design.prediction.k):
        k, states = jnp.asarray(design.prediction.k), [jnp.asarray(x) for x in motion]
        torque = np.asarray(design.network.torque(k, *states))
        high = limits.usable_torque
        lead = "Of the prior model, and the limits less their margin [N m or N]."
        sections.append(Section("Torque", lead, (_chart(names, time, torque, -high, high),)))
    return sections


def _chart(
    names: tuple[str, ...], time: np.ndarray, values: np.ndarray, low: np.ndarray, high: np.ndarray
) -> PanelChart:
    panels: list[Panel] = []
    ends = (float(time[0]), float(time[-1]))
    for joint, name in enumerate(names):
        curves = [Curve("motion", time.tolist(), values[:, joint].tolist(), "predicted")]
        for limit in (low[joint], high[joint]):
            if np.isfinite(limit):
                curves.append(Curve("limit", ends, (float(limit),) * 2, "residual"))
        panels.append(Panel(name, tuple(curves), height=90))
    return PanelChart(tuple(panels), "time [s]", "")


def _margins(design: Design) -> Section:
    rows = tuple(
        (
            row["limit"],
            design.network.output_names[row["joint"] - 1] if row["joint"] else "",
            100 * row["margin"] if row["joint"] else 1e3 * row["margin"],
            "%" if row["joint"] else "mm",
        )
        for row in design.use.margins()
    )
    columns = (
        Column("limit", numeric=False),
        Column("joint", numeric=False),
        Column("left", digits=3),
        Column("unit", numeric=False),
    )
    lead = (
        "What is left of each limit at the joint that uses most of it, at all times: what happens"
        " between samples is bounded and counted."
    )
    return Section("Margins", lead, (Table(columns, rows, name="margins-table"),))


def save_design(
    design: Design, path: str | Path, *, rate: float | None = None, command: str = ""
) -> tuple[Path, ...]:
    """Write a motion as `NAME.csv` and, beside it, in the forms that controllers read.

    - `NAME.csv`: columns `time`, `position_1`, ..., `velocity_1`, ..., `acceleration_1`, ..., or by
      the joints' names where they have some; SI units.
    - `NAME.yaml`, `NAME.json`: a message `trajectory_msgs/JointTrajectory` of ROS.
    - `NAME.h`: a C array of positions.
    - `NAME.html`: a page with the motion against its limits and the errors that it will bring.

    **Arguments**

    - `path`: of the CSV file; its folder exists.
    - `rate`: of the rows [Hz]; by default the recording's.
    - `command`: that the page shows.

    **Returns** the files.

    **Raises**

    - `ValueError`: a path that does not end in `.csv`.
    - `OSError`: files cannot be written.
    """
    paths = design_files(path)
    time, (q, qd, qdd) = design.sampled(rate)
    texts = (
        csv_text(design.network, time, q, qd, qdd),
        trajectory_yaml(design.network, time, q, qd, qdd),
        trajectory_json(design.network, time, q, qd, qdd),
        c_text(design.network, time, q),
        design_page(design, command),
    )
    for target, text in zip(paths, texts, strict=True):
        with unfinished(target) as file:
            file.write_text(text, encoding="utf-8")
    return paths


def design_files(path: str | Path) -> tuple[Path, ...]:
    """The files that `save_design` writes: CSV, YAML, JSON, C header and page.

    **Arguments**

    - `path`: of the CSV file.

    **Returns** the files.

    **Raises**

    - `ValueError`: a path that does not end in `.csv`.

    >>> from jaxcslc.excitation import design_files
    >>> [path.name for path in design_files("motion.csv")]
    ['motion.csv', 'motion.yaml', 'motion.json', 'motion.h', 'motion.html']
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise ValueError(f"{path}: expected a name that ends in .csv")
    return tuple(path.with_suffix(s) for s in (".csv", ".yaml", ".json", ".h", ".html"))


Samples = Float[np.ndarray, "samples joints"]
Time = Float[np.ndarray, " samples"]


def csv_text(network: CSLC, time: Time, q: Samples, qd: Samples, qdd: Samples) -> str:
    """A motion as a table."""
    names = network.output_labels
    header = ["time"]
    for quantity in ("position", "velocity", "acceleration"):
        header += [f"{quantity}_{name}" for name in names]
    lines = [",".join(header)]
    for row in np.column_stack([time, q, qd, qdd]):
        lines.append(",".join(f"{value:.10g}" for value in row))
    return "\n".join(lines) + "\n"


def trajectory_yaml(network: CSLC, time: Time, q: Samples, qd: Samples, qdd: Samples) -> str:
    """A motion as a `trajectory_msgs/JointTrajectory`."""
    lines = ["header: {frame_id: ''}", f"joint_names: {json.dumps(network.output_names)}"]
    lines.append("points:")
    for point in _points(time, q, qd, qdd):
        stamp = point["time_from_start"]
        lines += [
            f"- positions: {point['positions']}",
            f"  velocities: {point['velocities']}",
            f"  accelerations: {point['accelerations']}",
            f"  time_from_start: {{sec: {stamp['sec']}, nanosec: {stamp['nanosec']}}}",
        ]
    return "\n".join(lines) + "\n"


def trajectory_json(network: CSLC, time: Time, q: Samples, qd: Samples, qdd: Samples) -> str:
    """Write a motion as a `trajectory_msgs/JointTrajectory` in JSON, as bridges to ROS take it."""
    message = {
        "header": {"frame_id": ""},
        "joint_names": network.output_names,
        "points": _points(time, q, qd, qdd),
    }
    return json.dumps(message) + "\n"


def _points(time: Time, q: Samples, qd: Samples, qdd: Samples) -> list[dict[str, Any]]:
    """A `trajectory_msgs/JointTrajectoryPoint` a row."""
    points: list[dict[str, Any]] = []
    for instant, *states in zip(time, q, qd, qdd, strict=True):
        seconds = int(instant)
        nanoseconds = min(round(1e9 * (instant - seconds)), 999_999_999)
        rows = ([float(f"{value:.9g}") for value in state] for state in states)
        point: dict[str, Any] = dict(zip(_DERIVATIVES, rows, strict=True))
        point["time_from_start"] = {"sec": seconds, "nanosec": nanoseconds}
        points.append(point)
    return points


_DERIVATIVES = ("positions", "velocities", "accelerations")


def c_text(network: CSLC, time: Time, q: Samples) -> str:
    """Positions as an array in C."""
    name = re.sub(r"\W+", "_", network.robot.name).strip("_").lower() or "robot"
    rows = ",\n".join("    {" + ", ".join(f"{value:.9g}" for value in row) + "}" for row in q)
    samples, joints = q.shape
    return (
        f"/* {network.robot.name.replace('*/', '')}: joint positions [rad or m] every"
        f" {1e3 * (time[1] - time[0]):.6g} ms. */\n"
        f"#define {name.upper()}_MOTION_SAMPLES {samples}\n"
        f"#define {name.upper()}_MOTION_INTERVAL {time[1] - time[0]:.9g}\n"
        f"static const double {name}_motion[{samples}][{joints}] = {{\n{rows}\n}};\n"
    )

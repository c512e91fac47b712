"""A designed motion, and its files: CSV, JointTrajectory in YAML and JSON, C header, page."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._scratch import all_together
from .._text_table import csv_line, number_text
from ..codegen import comment_text, identifier
from ..manipulator import joint_lines, link_poses
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
    compared_with_value,
    render,
)
from ._criteria import EXPLANATIONS
from ._families import AbstractFamily, Parameters
from ._feasibility import Use
from ._information import Noise, Prediction, time_grid
from ._limits import Limits


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
    - `collisions`: sentences on the collisions that were looked for; empty if none were.
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
    collisions: tuple[str, ...] = ()

    def sampled(
        self, rate: float | None = None
    ) -> tuple[Float[np.ndarray, " samples"], tuple[Float[np.ndarray, "samples joints"], ...]]:
        """Return sample times, and `q`, `qd`, `qdd`; by default at the recording's rate [Hz]."""
        time, _ = time_grid(self.family.duration, 1.0 / (rate or self.noise.rate))
        motion = self.family.motion(np.asarray(self.parameters, float), time)
        return time, tuple(np.asarray(x) for x in motion)

    def relative_errors(self) -> dict[str, float]:
        """Return standard errors over values of the wanted coefficients that are determined.

        Where no value is known, its size takes its place.
        """
        return self._determined(self.prediction.relative_error)

    def _determined(self, errors: Float[np.ndarray, " coefficients"]) -> dict[str, float]:
        indices = {name: self.network.names.index(name) for name in self.wanted}
        determined = self.prediction.determined
        return {name: float(errors[i]) for name, i in indices.items() if determined[i]}

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the wanted coefficients that neither the motion nor what is known determines."""
        return tuple(name for name in self.wanted if name not in self.relative_errors())

    def seconds_for(self, relative: float) -> float:
        """Return how long to repeat this motion to reach standard errors over sizes [s].

        It must hold for all wanted coefficients; infinite where the motion does not determine one.
        """
        if self.undetermined:
            return np.inf
        worst = max(self._determined(self.prediction.sized_error).values())
        return self.family.duration * max(worst / relative, 1e-12) ** 2

    def __str__(self) -> str:
        lines = [
            f"{self.network.name}: {self.family.duration:g} s, {self.family.description}",
            f"{self.criterion} ({EXPLANATIONS[self.criterion]}): {self.value:.4g}",
            f"condition number {number_text(self.prediction.condition)}, of columns of unit length"
            f" {number_text(self.prediction.scaled_condition)}",
        ]
        if self.relative_errors():
            median, largest = _median_and_worst(self)
            lines.append(f"predicted standard errors: median {median}, largest {largest}")
            lines += [f"  {line}" for line in _without_value(self)]
        if self.undetermined:
            lines.append(f"not determined by this motion: {', '.join(self.undetermined)}")
        notes = (*(self.collisions or (_UNWATCHED,)), *self.notes)
        return "\n".join([*lines, str(self.use), *(f"note: {note}" for note in notes)])


_UNWATCHED = (
    "collisions were not looked for, neither with a floor nor between the robot's bodies: the"
    " limits have no surroundings"
)
_PAGE_RATE = 50.0  # of curves [Hz]
_FILM_RATE, _FRAMES = 15.0, 400  # frames a second, and at most
_TIP = 0.12  # of the last joint's axis that is drawn [m]
_QUANTITIES = (("Position", "rad"), ("Velocity", "rad/s"), ("Acceleration", "rad/s²"))


def design_page(design: Design, command: str = "") -> str:
    """Return a page with predicted intervals, the motion against its limits, and margins."""
    headline, left = _headline(design), design.undetermined
    sections = [_predicted(design), *_film(design), *_motion(design), _margins(design)]
    if command:
        sections.append(Section("Command", "", (Code(command),)))
    page = Page(
        f"Motion for {design.network.name}",
        design.family.description,
        headline,
        "good" if design.collisions else "caution",
        (
            *([Message(f"Not determined: {', '.join(left)}.", "caution")] if left else []),
            *([] if design.collisions else [Message(_sentence(_UNWATCHED), "caution")]),
            *(Message(_sentence(note), "plain") for note in (*design.collisions, *design.notes)),
        ),
        tuple(sections),
    )
    return render(page)


def _median_and_worst(design: Design) -> tuple[str, str]:
    """Return texts of the median of relative errors, and of the largest with its name."""
    errors = design.relative_errors()
    worst = max(errors, key=lambda name: errors[name])
    median = compared_with_value(float(np.median([*errors.values()])), 1.0)
    return median, f"{design.prediction.error_text(worst)} ({worst})"


def _without_value(design: Design) -> list[str]:
    """Return a sentence on coefficients whose errors cannot be compared with a value, if any."""
    names, k = design.prediction.names, design.prediction.k.tolist()
    unknown = [n for n, v in zip(names, k, strict=True) if v == 0.0 and n in design.wanted]
    if not unknown:
        return []
    shown = ", ".join(unknown[:4]) + (" and others" if len(unknown) > 4 else "")
    return [f"no value is known of {shown}: what makes 1 % of a joint's torque takes its place"]


def _sentence(note: str) -> str:
    return f"{note[0].upper()}{note[1:]}."


def _headline(design: Design) -> str:
    spent = f"{design.family.duration:g} s of this motion determine"
    if not (errors := design.relative_errors()):
        return f"{spent} none of the coefficients."
    median, largest = _median_and_worst(design)
    return (
        f"{spent} {len(errors)} coefficients. Predicted standard errors: median {median}, largest"
        f" {largest}."
    )


def _predicted(design: Design) -> Section:
    prediction = design.prediction
    after = np.where(prediction.determined, prediction.standard_error, np.inf)
    value = np.where(prediction.k == 0.0, np.nan, np.abs(prediction.k))
    errors = (prediction.before, after, 100 * prediction.before / value, 100 * after / value)
    values = (prediction.k.tolist(), *(error.tolist() for error in errors))
    rows = tuple(zip(prediction.names, prediction.units, *values, strict=True))
    percent = "standard error over value; none where no value is known"
    columns = (
        Column("coefficient", numeric=False),
        Column("unit", numeric=False),
        Column("prior value"),
        Column("std error before"),
        Column("std error after"),
        Column("before [%]", percent, 3),
        Column("after [%]", percent, 3),
    )
    lead = (
        f"Designed for: {design.criterion}, {EXPLANATIONS[design.criterion]}; reached"
        f" {design.value:.4g}. The condition number of the regressor is"
        f" {number_text(prediction.condition)}, with columns of unit length"
        f" {number_text(prediction.scaled_condition)}."
    )
    return Section("Predicted errors", lead, (Table(columns, rows, name="predicted"),))


def _film(design: Design) -> list[Section]:
    robot, duration = design.network.robot, design.family.duration
    if not robot.has_all_lengths:
        return []  # lengths that are symbols have no positions
    _, (q, _, _) = design.sampled(min(_FILM_RATE, _FRAMES / duration))
    q = np.asarray(design.network.positions_of_all_joints(q))
    last = np.asarray(link_poses(robot, q))[:, -1]
    tip = last[:, None, :3, 3] + np.array([[0.0], [_TIP]]) * last[:, None, :3, 2]
    frames = np.concatenate([joint_lines(robot, q), tip[:, None]], axis=1)
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


def save_design(design: Design, path: str | Path, *, command: str = "") -> tuple[Path, ...]:
    """Write a motion as `NAME.csv`, and next to it in the forms that controllers read.

    - `NAME.csv`: columns `time`, `position_1`, ..., `velocity_1`, ..., `acceleration_1`, ..., or by
      the joints' names where they have some; SI units.
    - `NAME.yaml`, `NAME.json`: a message `trajectory_msgs/JointTrajectory` of ROS.
    - `NAME.h`: a C array of positions.
    - `NAME.html`: a page with the motion against its limits and the errors that it will bring.

    **Arguments**

    - `path`: of the CSV file; its folder exists.
    - `command`: that the page shows.

    **Returns** the files.

    **Raises**

    - `ValueError`: a path that does not end in `.csv`.
    - `OSError`: files cannot be written.
    """
    paths = design_files(path)
    network, (time, motion) = design.network, design.sampled()
    points, names = trajectory_points(time, *motion), network.output_names
    message = {"header": {"frame_id": ""}, "joint_names": names, "points": points}
    texts = (
        csv_text(network, time, *motion),
        trajectory_yaml(names, points),
        json.dumps(message) + "\n",  # as bridges to ROS take it
        c_text(network, time, motion[0]),
        design_page(design, command),
    )
    with all_together(paths) as files:
        for file, text in zip(files, texts, strict=True):
            file.write_text(text, encoding="utf-8", errors="backslashreplace")
    return paths


def design_files(path: str | Path) -> tuple[Path, ...]:
    """Return the files that `save_design` writes: CSV, YAML, JSON, C header and page.

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
    """Return a motion as a table."""
    quantities = ("position", "velocity", "acceleration")
    names = [f"{quantity}_{name}" for quantity in quantities for name in network.output_labels]
    lines = [csv_line(["time", *names])]
    for row in np.column_stack([time, q, qd, qdd]):
        lines.append(",".join(f"{value:.10g}" for value in row))
    return "\n".join(lines) + "\n"


def trajectory_yaml(names: Sequence[str], points: Sequence[dict[str, Any]]) -> str:
    """Return a motion as a `trajectory_msgs/JointTrajectory`."""
    lines = ["header: {frame_id: ''}", f"joint_names: {json.dumps(names)}", "points:"]
    for point in points:
        stamp = point["time_from_start"]
        lines += [
            f"- positions: {point['positions']}",
            f"  velocities: {point['velocities']}",
            f"  accelerations: {point['accelerations']}",
            f"  time_from_start: {{sec: {stamp['sec']}, nanosec: {stamp['nanosec']}}}",
        ]
    return "\n".join(lines) + "\n"


def trajectory_points(time: Time, q: Samples, qd: Samples, qdd: Samples) -> list[dict[str, Any]]:
    """Return a `trajectory_msgs/JointTrajectoryPoint` per row."""
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
    """Return positions as an array in C."""
    name = identifier(network.robot.name)
    rows = ",\n".join("    {" + ", ".join(f"{value:.9g}" for value in row) + "}" for row in q)
    samples, joints = q.shape
    return (
        f"/* {comment_text(network.robot.name)}: joint positions [rad or m] every"
        f" {1e3 * (time[1] - time[0]):.6g} ms. */\n"
        f"#define {name.upper()}_MOTION_SAMPLES {samples}\n"
        f"#define {name.upper()}_MOTION_INTERVAL {time[1] - time[0]:.9g}\n"
        f"static const double {name}_motion[{samples}][{joints}] = {{\n{rows}\n}};\n"
    )

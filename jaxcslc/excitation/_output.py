import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .._scratch import unfinished
from ..network import CSLC
from ._page import design_page
from ._result import Design


def save_design(
    design: Design, path: str | Path, *, rate: float | None = None, command: str = ""
) -> tuple[Path, ...]:
    """Writes a motion as `NAME.csv` and, beside it, in the forms that controllers read.

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
    """The same in JSON, as bridges to ROS take it."""
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

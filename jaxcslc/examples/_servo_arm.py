"""An arm of position servos with two simulated logs, as `jaxcslc example so101` writes them.

Servos of an SO-101's kind: 12-bit encoders whose zeros are not the file's, 50 Hz, delay, stiction
and friction by load. The true links are heavier than the file's.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float


if TYPE_CHECKING:
    from ._arms import Example

SERVO_ARM = "so101"
_RATE, _DURATION = 50.0, 20.0  # Hz, s of a recording
_TICK = 2.0 * np.pi / 4096
_MASSES = 1.08  # true ones over the file's
_AT_REST = 50  # samples before a recording, in which the arm settles
_HELD = 1.5  # s, between the moves of the validation motion
# One per joint; of the order of Feetech's servos, not of one arm.
_DRIVES = {
    "gain": (10.2, 10.6, 10.4, 10.1, 9.8, 10.0),
    "damping": (0.72, 0.78, 0.75, 0.7, 0.68, 0.7),
    "delay": (0.042, 0.044, 0.043, 0.041, 0.042, 0.045),
    "offset": (0.03, -0.06, 0.05, 0.04, -0.02, 0.02),
    "armature": (0.018, 0.02, 0.019, 0.017, 0.016, 0.015),
    "coulomb": (0.06, 0.07, 0.065, 0.055, 0.05, 0.05),
    "static": (0.03, 0.03, 0.03, 0.025, 0.025, 0.025),
    "stribeck": (0.08, 0.08, 0.08, 0.08, 0.08, 0.08),
    "load_friction": (0.12, 0.15, 0.14, 0.12, 0.1, 0.1),
}


def write_servo_example(result: Example) -> None:
    """Write the robot file, the logs and the truth."""
    from ..manipulator import load_robot
    from ..servo import DRIVE_UNITS, ServoDrive, simulate

    with as_file(files("jaxcslc") / "examples" / "robots" / result.robot.name) as path:
        shutil.copyfile(path, result.robot)
    robot = load_robot(result.robot)
    links = tuple(
        dataclasses.replace(x, mass=_MASSES * x.mass, inertia=_MASSES * x.inertia)
        for x in robot.links or ()
    )
    true = dataclasses.replace(robot, links=links)
    joints = range(robot.joint_count)
    drives = [ServoDrive(**{name: values[i] for name, values in _DRIVES.items()}) for i in joints]
    time = np.arange(round(_DURATION * _RATE)) / _RATE
    rng = np.random.default_rng(3)
    for path, command in (
        (result.train, _sines(time, rng)),
        (result.validation, _moves(time, rng)),
    ):
        rest = np.tile(command[0], (_AT_REST, 1))
        whole = np.arange(_AT_REST + time.size) / _RATE
        settled = simulate(true, drives, whole, np.concatenate([rest, command]), command[0])
        position = _TICK * np.round(settled[_AT_REST:] / _TICK)
        names = [f"{kind}_{x}" for kind in ("command", "position") for x in robot.joint_names]
        table = np.column_stack([time, command, position])
        header = ",".join(["time", *names])
        np.savetxt(path, table, "%.6g", ",", header=header, comments="", encoding="utf-8")
    document = {
        "what": "truth of the simulated so101: train.csv and validation.csv",
        "masses": f"{_MASSES} times those of the robot file",
        "units": {name: DRIVE_UNITS[name] for name in _DRIVES},
        "drives": {
            joint: {name: values[i] for name, values in _DRIVES.items()}
            for i, joint in enumerate(robot.joint_names)
        },
    }
    result.truth.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def _sines(
    time: Float[np.ndarray, " samples"], rng: np.random.Generator
) -> Float[np.ndarray, "samples joints"]:
    """Return slow wide motion with fast motion on top, and steps in the last quarter."""
    size = np.array([0.55, 0.18, 0.06])[:, None]
    pace = rng.uniform([[0.6], [1.8], [6.0]], [[1.0], [2.8], [11.0]], (3, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    waves = np.sum(size * np.sin(time[:, None, None] * pace + phase), axis=1)
    rows = np.arange(time.size)
    held = rows - rows % round(_HELD * _RATE)
    command = waves[np.where(time > 0.75 * time[-1], held, rows)]
    return _within(command)


def _moves(
    time: Float[np.ndarray, " samples"], rng: np.random.Generator
) -> Float[np.ndarray, "samples joints"]:
    """Return motion from point to point with pauses."""
    points = rng.uniform(-0.7, 0.7, (int(time[-1] / (2.0 * _HELD)) + 2, 6))
    part, phase = np.divmod(time, 2.0 * _HELD)
    x = np.clip(phase / _HELD, 0.0, 1.0)[:, None]
    index = part.astype(int)
    blend = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return _within(points[index] + blend * (points[index + 1] - points[index]))


def _within(command: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, "samples joints"]:
    """Return the command, the jaw's moved within its range."""
    return command + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.8])

"""Checks of servo recordings before anything is identified: did the base move?

The regression that starts the search (`_start`) gives drives within seconds. They are good enough
to see in the torques that they leave whether the base moved (`_base`).
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..checks import Finding
from ..manipulator import Manipulator
from ._base import base_motion
from ._drive import ServoDrive
from ._fit import MASS_ERROR, known_rows, scaled, smoothed
from ._recording import ServoRecording
from ._search import NAMES
from ._start import Regression


def check_servos(
    robot: Manipulator,
    recording: ServoRecording,
    known: Mapping[str, float | Sequence[float]] | None = None,
) -> list[Finding]:
    """Return what looks wrong with a recording of servos: a base that moves.

    A base that moves is seen with five joints or more, all of them moving.

    **Arguments**

    - `robot`: the arm, with the masses of its links.
    - `recording`: of the robot's joints in its order.
    - `known`: drive parameters that are known, as of `identify_servo`.

    **Returns** the findings; none if nothing looks wrong.

    **Raises**

    - `RobotError`: a robot without masses.
    - `ValueError`: names that are no parameters.
    - `OSError`: no C compiler.

    >>> import dataclasses
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import LinkParameters
    >>> from jaxcslc.servo import ServoRecording, check_servos
    >>> rod = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), 0.002 * np.eye(3))
    >>> arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    >>> time = np.arange(0.0, 10.0, 0.02)
    >>> command = np.sin(time)[:, None]
    >>> check_servos(arm, ServoRecording(time, 0.95 * command, command))
    []
    """
    given = dict(known or {})
    rows = known_rows(robot, [recording], given)
    motion = smoothed(recording)
    has_gain = "gain" in given
    gains = rows[:, NAMES.index("gain")]
    unknown = np.full(robot.joint_count, np.nan)
    regression = Regression.of(robot, [recording], [None], [motion], gains if has_gain else unknown)
    free = np.append(np.full(robot.joint_count, "offset" not in given), has_gain)
    start = regression.start(rows[:, NAMES.index("offset")], free, MASS_ERROR)
    drives: list[ServoDrive] = []
    for offset, known_gain, found in zip(start.offsets, gains, start.found, strict=True):
        gain = math.exp(found["gain"]) if "gain" in found and not has_gain else float(known_gain)
        drives.append(
            ServoDrive(
                gain,
                damping=gain * found.get("damping", 0.0),
                delay=found.get("delay", 0.0),
                offset=float(offset),
                armature=gain * found.get("armature", 0.0),
                coulomb=gain * found.get("coulomb", 0.0),
                load_friction=found.get("load_friction", 0.0),
            )
        )
    moved = base_motion(scaled(robot, start.masses), drives, [recording], [motion])
    return [] if moved is None else [moved]

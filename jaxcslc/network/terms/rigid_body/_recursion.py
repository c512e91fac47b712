"""Newton and Euler's recursion over expressions."""

import math
from collections.abc import Sequence

from ....codegen import Expressions, Motion, Value
from ....derivation import Chain, NewtonEuler, link_frames
from ....manipulator import Joint


# An angle this close to a multiple of 90 degrees is meant to be it [rad].
_RIGHT_ANGLE = 1e-14


def newton_euler(
    motion: Motion,
    joints: Sequence[Joint],
    parents: Sequence[int],
    gravity: tuple[float, float, float],
) -> NewtonEuler:
    """The recursion of a robot over expressions of its motion.

    Unrolled, and without what right angles and zero lengths make trivial: a Panda's regressor of
    base parameters is 1,245 operations, a PUMA 560's 505.

    **Arguments**

    - `motion`: of the joints.
    - `joints`: a row of modified Denavit-Hartenberg parameters each, all lengths in numbers.
    - `parents`: the index of the link that carries each link, -1 for the base.
    - `gravity`: in the base frame [m/s²].

    >>> import jaxcslc as jc
    >>> robot, motion = jc.puma560(), Motion(6)
    >>> arm = newton_euler(motion, robot.joints, robot.parents, robot.gravity)
    >>> point_mass = 5, (0, 0, 0, 0, 0, 0, 0, 0, 0, 1)  # at the origin of the last frame
    >>> rows = arm.columns([point_mass], motion.qd, motion.qdd)
    >>> [motion.graph.cost(motion.values(row)) for row in rows]
    [159, 136, 131, 0, 0, 0]
    """
    a, d, b = ([float(getattr(joint, letter).value or 0.0) for joint in joints] for letter in "adb")
    frames = link_frames(
        Chain.from_joints(joints, parents).in_numbers(float),
        rotations=[
            _rotation(motion.graph, joint, q) for joint, q in zip(joints, motion.q, strict=True)
        ],
        a=a,
        d=[
            offset + q if joint.kind == "P" else offset
            for offset, joint, q in zip(d, joints, motion.q, strict=True)
        ],
        b=b,
    )
    return NewtonEuler(frames, gravity)


def _rotation(graph: Expressions, joint: Joint, q: Value) -> tuple[Value, Value]:
    """Cosine and sine of a joint's angle about z; multiples of 90 degrees are exact."""
    quarters = round(joint.theta / (math.pi / 2))
    remainder = joint.theta - quarters * (math.pi / 2)
    if abs(remainder) < _RIGHT_ANGLE:
        remainder = 0.0
    if joint.kind == "P":
        c, s = graph.constant(math.cos(remainder)), graph.constant(math.sin(remainder))
    else:
        c, s = graph.apply("cos", q + remainder), graph.apply("sin", q + remainder)
    for _ in range(quarters % 4):
        c, s = -s, c
    return c, s

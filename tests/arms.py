"""Arms that most tests use, and their networks, each derived once per process.

Lengths are numeric. `friction` are the terms of all joints; where none is named, those of the
robot. The PUMA 560 is the fixture `puma`.
"""

from functools import cache

import jaxcslc as jc


TREE = jc.Manipulator.from_modified_dh(
    [
        (0.3, 0.1, 0.2, 0.4),
        ("-pi/2", 0.2, 0.1, 0),
        (1.0, 0.1, 0.3, 0.7, 0.5, 0.2),
        ("pi/2", 0, 0.2, "pi/2"),
    ],
    kinds="RPRR",
    parents=[0, 1, 1, 3],
    gravity=(1.0, 2.0, -9.0),
    name="a tree",
)
"""Two branches, a prismatic joint, twists that are no right angles, gravity askew."""

MIXED = jc.Manipulator.from_modified_dh(
    [
        (0, 0, 0.2, 0.3),
        ("pi", 0.4, 0, 0),
        (0, -0.2, 0.1, 0),
        ("pi/2", 0.1, 0.3, "pi/2"),
        ("pi", 0.2, 0, 0.1),
    ],
    kinds="RRPRR",
    gravity=(1.0, 2.0, -9.0),
)
"""Consecutive parallel and antiparallel axes, a prismatic joint between two of them, offsets."""


@cache
def pendulum(*friction: str) -> jc.CSLC:
    """A link that swings about a horizontal axis."""
    return jc.derive(jc.examples.pendulum(*friction), lengths="numeric")


@cache
def turntable(*friction: str) -> jc.CSLC:
    """A link that turns about a vertical axis."""
    return jc.derive(jc.examples.turntable(*friction), lengths="numeric")


@cache
def planar_arm(*friction: str) -> jc.CSLC:
    """Two links of 0.5 m in a vertical plane."""
    return jc.derive(jc.examples.planar_arm(*friction), lengths="numeric")


@cache
def elbow(*friction: str) -> jc.CSLC:
    """Two links whose axes are perpendicular, 0.1 m apart."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("-pi/2", 0.1, 0, 0)], gravity=(0, -9.81, 0), name="elbow"
    )
    return jc.derive(robot.with_friction(*friction) if friction else robot, lengths="numeric")


@cache
def panda(*friction: str) -> jc.CSLC:
    """Franka's arm of seven joints."""
    robot = jc.panda().with_friction(*friction) if friction else jc.panda()
    return jc.derive(robot, lengths="numeric")


@cache
def tree(*friction: str) -> jc.CSLC:
    """The robot `TREE`."""
    return jc.derive(TREE.with_friction(*friction) if friction else TREE, lengths="numeric")


@cache
def coupled_arm(*friction: str) -> jc.CSLC:
    """The planar arm, its second motor on the first joint's shaft."""
    robot = jc.examples.planar_arm(*friction).with_coupling((1, 2, -1.0))
    return jc.derive(robot, lengths="numeric")

"""Networks of the arms that most tests use, each derived once per process.

They are of `jaxcslc.examples`' robots with numeric lengths. `friction` are the terms of all joints,
viscous and dry ones where none is named.
"""

from functools import cache

import jaxcslc as jc


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

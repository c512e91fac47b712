"""Arms of servos for the tests, as MuJoCo's XML and as robots."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

import jaxcslc as jc


def arm_xml(
    *,
    gain: float = 12.0,
    damping: float = 0.8,
    armature: float = 0.01,
    coulomb: float = 0.0,
    step: float = 0.0005,
) -> str:
    """Return three links about horizontal axes, each with a position servo of MuJoCo's."""
    joint = f'armature="{armature}" frictionloss="{coulomb}" damping="0"'
    names = ("shoulder", "elbow", "wrist")
    opened = "".join(
        f'<body name="{name} link" pos="{0.0 if i == 0 else 0.12} 0 0">'
        f'<joint name="{name}" type="hinge" axis="0 -1 0" {joint}/>'
        f'<inertial mass="{0.3 - 0.08 * i}" pos="0.06 0.01 0.005" diaginertia="2e-4 4e-4 5e-4"/>'
        for i, name in enumerate(names)
    )
    actuators = "".join(
        f'<position name="{name} servo" joint="{name}" kp="{gain}" kv="{damping}"/>'
        for name in names
    )
    return (
        f'<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>{opened}'
        + "</body>" * len(names)
        + f"</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def arm(folder: Path) -> jc.Manipulator:
    """Return the arm of `arm_xml` as `load_robot` reads it."""
    path = folder / "arm.xml"
    path.write_text(arm_xml())
    return jc.load_robot(path)


def held_sines(
    time: Float[np.ndarray, " samples"], joints: int, size: float = 0.4
) -> Float[np.ndarray, "samples joints"]:
    """Return commands that begin at zero, of two sines per joint."""
    rates = 1.5 + 0.7 * np.arange(joints)
    return size * (
        np.sin(time[:, None] * rates)
        + 0.4 * np.sin(2.6 * rates * time[:, None] + 1.0 * rates)
        - 0.4 * np.sin(1.0 * rates)
    )

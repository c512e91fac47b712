"""Three arms of the study: a PUMA 560, a geared 7-joint arm and a 6-joint one.

The PUMA 560 is that of `sim`. The others are URDF files written here.
"""

import dataclasses
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import jaxcslc as jc


@dataclasses.dataclass(frozen=True)
class ArmJoint:
    """A revolute joint of a URDF and the link that it moves.

    - `origin`, `angles`: of the joint in the frame before [m, rad].
    - `mass`, `centre`, `radius`: of the link, a ball for its inertia [kg, m].
    - `motor`: inertia of the motor, seen at the joint [kg m²].
    - `limits`: lower, upper, speed, torque [rad, rad/s, N m].
    - `friction`: viscous and dry [N m s/rad, N m].
    """

    origin: tuple[float, float, float]
    angles: tuple[float, float, float]
    mass: float
    centre: tuple[float, float, float]
    radius: float
    motor: float
    limits: tuple[float, float, float, float]
    friction: tuple[float, float]


_R = np.pi / 2
GEARED = (
    ArmJoint(
        (0, 0, 0.333),
        (0, 0, 0),
        4.5,
        (0.0, -0.03, -0.07),
        0.11,
        0.6,
        (-2.8, 2.8, 2.2, 87),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0, 0),
        (-_R, 0, 0),
        4.2,
        (-0.003, -0.07, 0.03),
        0.11,
        0.6,
        (-1.7, 1.7, 2.2, 87),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, -0.316, 0),
        (_R, 0, 0),
        3.4,
        (0.04, 0.025, -0.04),
        0.1,
        0.5,
        (-2.8, 2.8, 2.2, 87),
        (2.0, 1.8),
    ),
    ArmJoint(
        (0.0825, 0, 0),
        (_R, 0, 0),
        3.2,
        (-0.04, 0.04, 0.025),
        0.1,
        0.5,
        (-3.0, 0.0, 2.2, 87),
        (2.0, 1.8),
    ),
    ArmJoint(
        (-0.0825, 0.384, 0),
        (-_R, 0, 0),
        3.0,
        (0.0, 0.04, -0.11),
        0.1,
        0.25,
        (-2.8, 2.8, 2.6, 12),
        (1.0, 1.0),
    ),
    ArmJoint(
        (0, 0, 0),
        (_R, 0, 0),
        1.8,
        (0.055, 0.008, -0.01),
        0.07,
        0.25,
        (0.0, 3.7, 2.6, 12),
        (0.9, 0.9),
    ),
    ArmJoint(
        (0.088, 0, 0),
        (_R, 0, 0),
        1.2,
        (0.012, 0.008, 0.085),
        0.06,
        0.2,
        (-2.8, 2.8, 2.6, 12),
        (0.7, 0.6),
    ),
)
"""A geared 7-joint arm, with the lengths of a Franka Panda."""

SIX = (
    ArmJoint(
        (0, 0, 0.1625),
        (0, 0, 0),
        3.8,
        (0.0, -0.02, 0.0),
        0.08,
        0.9,
        (-6.2, 6.2, 3.1, 150),
        (8.0, 7.0),
    ),
    ArmJoint(
        (0, 0, 0), (_R, 0, 0), 8.4, (-0.21, 0.0, 0.11), 0.12, 0.9, (-6.2, 6.2, 3.1, 150), (8.0, 8.0)
    ),
    ArmJoint(
        (-0.425, 0, 0),
        (0, 0, 0),
        2.3,
        (-0.27, 0.0, 0.01),
        0.09,
        0.5,
        (-3.1, 3.1, 3.1, 150),
        (5.0, 5.0),
    ),
    ArmJoint(
        (-0.3922, 0, 0.1333),
        (0, 0, 0),
        1.2,
        (0.0, -0.015, 0.02),
        0.06,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.5, 1.6),
    ),
    ArmJoint(
        (0, -0.0997, 0),
        (_R, 0, 0),
        1.2,
        (0.0, 0.015, 0.02),
        0.06,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.5, 1.5),
    ),
    ArmJoint(
        (0, 0.0996, 0),
        (_R, np.pi, np.pi),
        0.4,
        (0.0, 0.01, -0.03),
        0.05,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.2, 1.2),
    ),
)
"""A 6-joint arm, with the lengths of a Universal Robots UR5e."""


SEVEN = (
    ArmJoint(
        (0, 0, 0.1575),
        (0, 0, 0),
        4.0,
        (0.0, -0.03, 0.12),
        0.1,
        0.7,
        (-2.9, 2.9, 1.7, 170),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0, 0.2025),
        (_R, 0, np.pi),
        4.0,
        (0.0, 0.06, 0.04),
        0.1,
        0.7,
        (-2.0, 2.0, 1.7, 170),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0.2045, 0),
        (_R, 0, np.pi),
        3.0,
        (0.0, 0.03, 0.13),
        0.09,
        0.5,
        (-2.9, 2.9, 1.7, 110),
        (2.0, 2.0),
    ),
    ArmJoint(
        (0, 0, 0.2155),
        (_R, 0, 0),
        2.7,
        (0.0, 0.067, 0.034),
        0.09,
        0.5,
        (-2.0, 2.0, 2.2, 110),
        (2.0, 2.0),
    ),
    ArmJoint(
        (0, 0.1845, 0),
        (-_R, np.pi, 0),
        1.7,
        (0.0, 0.02, 0.076),
        0.08,
        0.3,
        (-2.9, 2.9, 2.2, 110),
        (1.0, 1.0),
    ),
    ArmJoint(
        (0, 0, 0.2155),
        (_R, 0, 0),
        1.8,
        (0.0, 0.0, 0.0),
        0.07,
        0.2,
        (-2.0, 2.0, 3.1, 40),
        (0.8, 0.8),
    ),
    ArmJoint(
        (0, 0.081, 0),
        (-_R, np.pi, 0),
        0.3,
        (0.0, 0.0, 0.02),
        0.04,
        0.2,
        (-3.0, 3.0, 3.1, 40),
        (0.5, 0.5),
    ),
)
"""Another 7-joint arm, with the lengths of a KUKA iiwa: the wrong robot for the geared one."""

URDFS = {"geared": GEARED, "six": SIX, "seven": SEVEN}


def urdf(name: str, joints: tuple[ArmJoint, ...]) -> str:
    """The arm as a URDF."""
    lines = [f'<robot name="{name}">', '  <link name="base"/>']
    for number, joint in enumerate(joints, 1):
        moment = 0.4 * joint.mass * joint.radius**2
        lower, upper, speed, torque = joint.limits
        lines += [
            f'  <link name="link_{number}"><inertial>',
            f'    <origin xyz="{_text(joint.centre)}"/><mass value="{joint.mass}"/>',
            f'    <inertia ixx="{moment:.6g}" iyy="{moment:.6g}" izz="{moment:.6g}"'
            ' ixy="0" ixz="0" iyz="0"/>',
            "  </inertial></link>",
            f'  <joint name="joint_{number}" type="revolute">',
            f'    <origin xyz="{_text(joint.origin)}" rpy="{_text(joint.angles)}"/>',
            f'    <parent link="{"base" if number == 1 else f"link_{number - 1}"}"/>'
            f'<child link="link_{number}"/><axis xyz="0 0 1"/>',
            f'    <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="{torque}"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.12g}" for value in values)


@cache
def robot(arm: str) -> jc.Manipulator:
    """The arm as its file describes it."""
    if arm == "PUMA 560":
        return jc.puma560()
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{arm}.urdf"
        path.write_text(urdf(arm, URDFS[arm]), encoding="utf-8")
        return jc.load_robot(path)


@cache
def network(arm: str) -> jc.CSLC:
    return jc.derive(robot(arm), lengths="numeric")


ARMS = ("PUMA 560", "geared", "six")

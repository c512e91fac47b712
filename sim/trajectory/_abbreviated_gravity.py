"""The gravity compensation of the thesis's comparison trajectory."""

import math
from dataclasses import dataclass
from typing import ClassVar

from jaxcslc.control import AbstractPositionTorque
from jaxcslc.manipulator import Manipulator, RobotError
from sim.trajectory._arrays import Array, namespace


_PUMA_TWISTS = (0, -90, 0, 90, -90, 90)  # degrees


# No `eqx.Module`: on NumPy arrays, a call of one of its methods costs more than the torque.
@dataclass(frozen=True, eq=False)
class AbbreviatedGravity(AbstractPositionTorque):
    """The PUMA 560's gravity compensation of 7.4: joints 2 and 3 without the wrist's terms.

    τ₂ = A c₂ + B s₂ + C c₂₃ + D s₂₃ and τ₃ = C c₂₃ + D s₂₃: the gravity term of Appendix B.3
    without k₂ᴳ, the one coefficient that makes it depend on the wrist; zero for the other joints.
    The thesis does not print it: this reading of "abbreviated" is a reconstruction.

    **Attributes**

    - `upper_arm`: A and B, factors of c₂ and s₂ [N m].
    - `forearm`: C and D, factors of c₂₃ and s₂₃ [N m].

    >>> import numpy as np, jaxcslc as jc, sim
    >>> sim.AbbreviatedGravity.of(jc.puma560()).torque(np.zeros(6)).round(2)
    array([  0.  , -36.99,   0.25,   0.  ,   0.  ,   0.  ])
    """

    upper_arm: tuple[float, float]
    forearm: tuple[float, float]
    array_generic: ClassVar[bool] = True

    @classmethod
    def of(cls, robot: Manipulator) -> "AbbreviatedGravity":
        """The compensation for a PUMA's links; the wrist's masses count at the wrist's centre.

        **Raises**

        - `RobotError`: the robot is no PUMA, or has no link parameters.
        """
        links = robot.links
        twists = tuple(round(math.degrees(joint.alpha), 6) for joint in robot.joints)
        if links is None or robot.kinds != "RRRRRR" or twists != _PUMA_TWISTS:
            raise RobotError(
                f"robot {robot.name!r}: this gravity compensation is the PUMA 560's; expected six"
                " revolute joints with twists 0, -90, 0, 90, -90, 90 degrees and link parameters"
            )
        if not robot.gravity[0] == 0 == robot.gravity[1]:
            raise RobotError(
                f"robot {robot.name!r}: gravity is {robot.gravity}; expected it along the z axis"
            )
        length = robot.length_values()
        a2, a3, d4 = length["a2"], length["a3"], length["d4"]
        mass = [float(link.mass) for link in links]
        x2, y2, _ = (float(value) for value in links[1].centre_of_gravity)
        x3, y3, _ = (float(value) for value in links[2].centre_of_gravity)
        z4 = float(links[3].centre_of_gravity[2])
        g = robot.gravity[2]
        wrist = mass[4] + mass[5]
        return cls(
            upper_arm=(
                g * (mass[1] * x2 + (mass[2] + mass[3] + wrist) * a2),
                -g * mass[1] * y2,
            ),
            forearm=(
                g * (mass[2] * x3 + (mass[3] + wrist) * a3),
                -g * (mass[2] * y3 - mass[3] * (d4 + z4) - wrist * d4),
            ),
        )

    def torque(self, q: Array) -> Array:
        """As `AbstractPositionTorque.torque`, for six joints."""
        xp = namespace(q)
        q2, q23 = q[..., 1], q[..., 1] + q[..., 2]
        forearm = self.forearm[0] * xp.cos(q23) + self.forearm[1] * xp.sin(q23)
        upper_arm = self.upper_arm[0] * xp.cos(q2) + self.upper_arm[1] * xp.sin(q2) + forearm
        zero = xp.zeros_like(q2)
        return xp.stack([zero, upper_arm, forearm, zero, zero, zero], axis=-1)

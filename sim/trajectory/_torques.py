"""Torques of controllers beside feedback: abbreviated gravity, repulsion, sinusoidal excitation."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, no_type_check

import numpy as np
from jaxtyping import Float, Int

from jaxcslc.control import AbstractController, AbstractPositionTorque, Reference
from jaxcslc.manipulator import Manipulator, RobotError
from sim.trajectory._kinematics import Hand
from sim.trajectory._paths import Array, namespace, spread


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

        **Raises** `RobotError`: the robot is no PUMA, or has no link parameters.
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
        """Return what `AbstractPositionTorque.torque` declares, for six joints."""
        xp = namespace(q)
        q2, q23 = q[..., 1], q[..., 1] + q[..., 2]
        forearm = self.forearm[0] * xp.cos(q23) + self.forearm[1] * xp.sin(q23)
        upper_arm = self.upper_arm[0] * xp.cos(q2) + self.upper_arm[1] * xp.sin(q2) + forearm
        zero = xp.zeros_like(q2)
        return xp.stack([zero, upper_arm, forearm, zero, zero, zero], axis=-1)


# Widths beyond its bound over which a repulsion still grows: at most by a factor e.
_DEEPEST = 1.0


@dataclass(frozen=True, eq=False)
class Repulsion(AbstractPositionTorque):
    """Repulsive torque from the ends of each joint's range.

    >>> import numpy as np
    >>> from sim import Repulsion
    >>> repulsion = Repulsion(np.array([[-1.0, 1.0]]), strength=np.array([50.0]))
    >>> [float(repulsion.torque(np.array([q])).round(3)[0]) for q in (-1.0, -0.5, 0.0)]
    [50.0, 0.002, 0.0]
    """

    position_range: Float[np.ndarray, "joints 2"]
    """Lowest and highest position of each joint [rad or m]."""

    strength: Float[np.ndarray, " joints"]
    """Torque at either end [N m or N]; beyond it, it grows no more than threefold."""

    width: float = 0.05
    """[rad or m]."""

    array_generic: ClassVar[bool] = True

    def torque(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch joints"]:
        """Return what the abstract method declares."""
        xp = namespace(q)
        low = spread(self.position_range[:, 0], q)
        high = spread(self.position_range[:, 1], q)
        above = xp.exp(xp.minimum((low - q) / self.width, _DEEPEST))
        below = xp.exp(xp.minimum((q - high) / self.width, _DEEPEST))
        return spread(self.strength, q) * (above - below)


@dataclass(frozen=True, eq=False)
class HandRepulsion(AbstractPositionTorque):
    """Repulsion of the hand from the floor and from the arm's trunk.

    The torque is Jᵀ F of a force F on the hand, which is minus the gradient of a
    potential: `strength` times `width` times exp(−clearance / width), one for the floor and one for
    the trunk, a cylinder about axis 1 that stands on the floor. The z axis of frame 0 points up.

    >>> import numpy as np
    >>> import jaxcslc
    >>> from sim import Hand, HandRepulsion
    >>> repulsion = HandRepulsion(
    ...     Hand.of(jaxcslc.puma560()), floor=-0.6718, trunk_radius=0.25, trunk_top=0.2
    ... )
    >>> reaching_down = np.array([0.0, 0.85, 1.5, 0.0, 0.0, 0.0])
    >>> repulsion.clearance(reaching_down).round(2)
    array([0.06, 0.38])
    >>> repulsion.torque(reaching_down).round(2)
    array([ 0.  , -8.94, -4.74,  0.  ,  0.  ,  0.  ])
    """

    hand: Hand
    """The repelled point."""

    floor: float
    """Its height in frame 0 [m]."""

    trunk_radius: float
    """[m]."""

    trunk_top: float
    """Its height in frame 0 [m]."""

    strength: float = 100.0
    """Force at the floor and at the trunk [N]; inside, it grows no more than threefold."""

    width: float = 0.03
    """[m]."""

    array_generic: ClassVar[bool] = True

    def clearance(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch 2"]:
        """Return the hand's distances from the floor and from the trunk [m], at joint positions
        [rad or m]; negative inside.

        The distance from the trunk is the larger of that beside it and that above it, with the
        edge rounded off over `width`: up to log 2 widths more.
        """
        return self._clearance(self.hand.locate(q)[0])

    def potential(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch"]:
        """Return the force's potential [J], at joint positions [rad or m]."""
        xp = namespace(q)
        depth = -self.clearance(q) / self.width
        beyond = xp.exp(xp.clip(depth, None, _DEEPEST)) * (
            1.0 + xp.clip(depth - _DEEPEST, 0.0, None)
        )
        return self.strength * self.width * xp.sum(beyond, axis=-1)

    def torque(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch joints"]:
        """Return what the abstract method declares."""
        xp = namespace(q)
        point, jacobian = self.hand.locate(q)
        clearance = self._clearance(point)
        size = self.strength * xp.exp(xp.minimum(-clearance / self.width, _DEEPEST))
        floor, trunk = size[..., 0], size[..., 1]
        x, y, z = point[..., 0], point[..., 1], point[..., 2]
        radius = xp.hypot(x, y)
        # Shares of the trunk's side and of its top; on axis 1 itself the side has no direction.
        above = xp.exp((z - self.trunk_top) / self.width - clearance[..., 1] / self.width)
        outwards = trunk * (1.0 - above) / xp.where(radius > 0, radius, 1.0)
        force = xp.stack([outwards * x, outwards * y, floor + trunk * above], axis=-1)
        return xp.sum(jacobian * force[..., None], axis=-2)

    @no_type_check
    def _clearance(self, point: Array) -> Array:
        xp = namespace(point)
        beside = xp.hypot(point[..., 0], point[..., 1]) - self.trunk_radius
        above = point[..., 2] - self.trunk_top
        trunk = self.width * xp.logaddexp(beside / self.width, above / self.width)
        return xp.stack([point[..., 2] - self.floor, trunk], axis=-1)


Joints = Float[Array | np.ndarray, "*batch joints"]


class SinusoidalTorque(AbstractController):
    """Open-loop excitation: a sinusoidal torque at each joint, with gravity compensated (7.4.1).

    The controller of the thesis's training trajectory. There is no feedback: the machine decides
    on the motion, which is roughly sinusoidal where the inertia of each joint outweighs the
    coupling. The reference is ignored. Samples are equally spaced. The state counts them,
    (*batch, 1).

    **Attributes**

    - `amplitude`: (n,) [N m or N].
    - `period`: (n,) [s].
    - `phase`: (n,) [rad]. At 3π/2 a joint that starts at rest swings to one side and back.
    - `gravity`: gravity compensation, or None.
    - `repulsion`: torques that keep the arm away from obstacles, such as `Repulsion`.

    >>> import numpy as np
    >>> import sim
    >>> from jaxcslc.control import Reference
    >>> controller = sim.SinusoidalTorque(np.array([2.0]), np.array([0.8]), np.array([1.5 * np.pi]))
    >>> q = np.zeros(1)
    >>> torque, state = controller.step(controller.begin(q), Reference.at_rest(q), q, 0.002)
    >>> torque.tolist(), state.tolist()
    ([-2.0], [1])
    """

    amplitude: Float[Array | np.ndarray, " joints"]
    period: Float[Array | np.ndarray, " joints"]
    phase: Float[Array | np.ndarray, " joints"]
    gravity: AbstractPositionTorque | None = None
    repulsion: tuple[AbstractPositionTorque, ...] = ()

    @property
    def array_generic(self) -> bool:
        """True unless gravity compensation or repulsion need JAX."""
        parts = self.repulsion if self.gravity is None else (self.gravity, *self.repulsion)
        return all(part.array_generic for part in parts)

    def begin(self, q: Joints) -> Int[Array | np.ndarray, "*batch 1"]:
        """Return zero samples."""
        xp = namespace(q)
        return xp.zeros((*q.shape[:-1], 1), int)

    def step(
        self,
        state: Int[Array | np.ndarray, "*batch 1"],
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, Any]:
        """Compute the torque command, as `AbstractController.step` describes."""
        del reference, qd  # open loop
        xp = namespace(q)
        time = state.astype(q.dtype) * xp.asarray(interval, dtype=q.dtype)
        angle = 2 * np.pi * time / spread(self.period, q)
        torque = spread(self.amplitude, q) * xp.sin(angle + spread(self.phase, q))
        if self.gravity is not None:
            torque = torque + self.gravity.torque(q)
        for repulsion in self.repulsion:
            torque = torque + repulsion.torque(q)
        return torque, state + 1

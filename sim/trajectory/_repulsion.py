from dataclasses import dataclass
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from jaxcslc.control import AbstractPositionTorque
from sim.trajectory._arrays import Array, namespace, spread
from sim.trajectory._kinematics import Hand


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
        """As the abstract method."""
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
        """How far the hand is from the floor and from the trunk [m], at joint positions
        [rad or m]; negative inside.

        The distance from the trunk is the larger of that beside it and that above it, with the
        edge rounded off over `width`: up to log 2 widths more.
        """
        return self._clearance(self.hand.locate(q)[0])

    def potential(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch"]:
        """Of the force [J], at joint positions [rad or m]."""
        xp = namespace(q)
        depth = -self.clearance(q) / self.width
        beyond = xp.exp(xp.clip(depth, None, _DEEPEST)) * (
            1.0 + xp.clip(depth - _DEEPEST, 0.0, None)
        )
        return self.strength * self.width * xp.sum(beyond, axis=-1)

    def torque(self, q: Float[Array, "*batch joints"]) -> Float[Array, "*batch joints"]:
        """As the abstract method."""
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

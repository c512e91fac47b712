from dataclasses import dataclass
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float

from jaxcslc.control import AbstractPositionTorque

from ._arrays import Array, namespace, spread
from ._kinematics import Hand


# How many widths beyond its bound a repulsion goes on growing: it ends threefold, not infinite.
_DEEPEST = 1.0


@dataclass(frozen=True, eq=False)
class Repulsion(AbstractPositionTorque):
    """Away from the ends of each joint's range.

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
        above = xp.exp(xp.clip((low - q) / self.width, None, _DEEPEST))
        below = xp.exp(xp.clip((q - high) / self.width, None, _DEEPEST))
        return spread(self.strength, q) * (above - below)


@dataclass(frozen=True, eq=False)
class HandRepulsion(AbstractPositionTorque):
    """Keeps the hand off the floor and off the arm's own trunk.

    A force on the hand, and so the torques that it takes to exert it there, Jᵀ F. It is minus the
    gradient of a potential: `strength` times `width` times exp(−clearance / width), one for the
    floor and one for the trunk, a cylinder about axis 1 that stands on the floor. The z axis of
    frame 0 points up.

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
    """The point that is kept off."""

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
        place, jacobian = self.hand.locate(q)
        clearance = self._clearance(place)
        size = self.strength * xp.exp(xp.clip(-clearance / self.width, None, _DEEPEST))
        floor, trunk = size[..., 0], size[..., 1]
        x, y, z = place[..., 0], place[..., 1], place[..., 2]
        radius = xp.hypot(x, y)
        # Shares of the trunk's side and of its top; on axis 1 itself the side has no direction.
        above = xp.exp((z - self.trunk_top) / self.width - clearance[..., 1] / self.width)
        outwards = trunk * (1.0 - above) / xp.where(radius > 0, radius, 1.0)
        force = xp.stack([outwards * x, outwards * y, floor + trunk * above], axis=-1)
        return xp.sum(jacobian * force[..., None], axis=-2)

    @no_type_check
    def _clearance(self, place: Array) -> Array:
        xp = namespace(place)
        beside = xp.hypot(place[..., 0], place[..., 1]) - self.trunk_radius
        above = place[..., 2] - self.trunk_top
        trunk = self.width * xp.logaddexp(beside / self.width, above / self.width)
        return xp.stack([place[..., 2] - self.floor, trunk], axis=-1)

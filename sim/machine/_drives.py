from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ._machine import Machine


@dataclass(frozen=True, eq=False)
class Drives:
    """What the motors make of a demand: linear at first, then less, then no more (7.2.3).

    Up to its limit of linearity a motor gives what is demanded. Beyond, it gives progressively
    less, as in Fig. 7.2-1, and approaches its greatest torque; the curve is
    L + (S − L) (1 − exp(−(u − L) / (S − L))) for a demand of u, smooth where it leaves the line.
    The thesis gives no formula. Without a limit of linearity the greatest torque cuts off.

    ```python
    >>> import numpy as np
    >>> from sim import Drives
    >>> drives = Drives(linear=np.array([10.0]), most=np.array([20.0]))
    >>> [float(drives.torque(np.array([u])).round(2)[0]) for u in (8.0, -8.0, 20.0, 200.0)]
    [8.0, -8.0, 16.32, 20.0]

    ```
    """

    linear: Float[Any, "*batch joints"]
    """L, the limit of linearity [N m or N]; infinite for none."""

    most: Float[Any, "*batch joints"]
    """S, the greatest torque [N m or N]."""

    @classmethod
    def of(cls, machine: Machine) -> "Drives":
        """The drives of a machine."""
        return cls(np.array(machine.linear_torque), np.array(machine.maximum_torque))

    def torque(self, demand: Float[Any, "*batch joints"]) -> Float[Any, "*batch joints"]:
        """The torque given when `demand` is demanded [N m or N]; NumPy or JAX arrays."""
        xp = demand.__array_namespace__()
        size = xp.abs(demand)
        # Where the curve has no end, any finite room will do.
        bends = (self.linear < self.most) & xp.isfinite(self.most)
        linear = xp.where(bends, self.linear, xp.zeros_like(size))
        room = xp.where(bends, self.most - linear, xp.ones_like(size))
        curve = linear - room * xp.expm1(-xp.maximum(size - linear, xp.zeros_like(size)) / room)
        given = xp.where(bends & (size > linear), curve, size)
        return xp.sign(demand) * xp.minimum(given, self.most + xp.zeros_like(given))

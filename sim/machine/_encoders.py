from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ._machine import Machine


@dataclass(frozen=True, eq=False)
class Encoders:
    """Incremental encoders, one a joint, on its rotor (7.1, 7.2.5).

    An encoder counts the lines that have passed since it was set to zero, so a reading is a whole
    number of counts. Where between two lines the rotor stood at that moment is its phase, which
    differs every time the machine is switched on.

    ```python
    >>> import numpy as np
    >>> import sim
    >>> encoders = sim.Encoders(np.array([0.1, 0.0]), phase=np.array([0.5, 0.5]))
    >>> encoders.read(np.array([1.23, 1.23]))
    array([1.2 , 1.23])

    ```
    """

    resolution: Float[Any, "*batch joints"]
    """What one count means at the joint [rad or m]; zero reads the position as it is."""

    phase: Float[Any, "*batch joints"]
    """In counts, from 0 to 1. A half makes a reading the nearest whole count; with any other, it
    is at most `max(phase, 1 - phase)` counts from the position."""

    @classmethod
    def of(cls, machine: Machine, phase: Float[np.ndarray, "*batch joints"]) -> "Encoders":
        """The encoders of a machine."""
        return cls(np.array(machine.encoder_resolution), phase)

    def read(self, q: Float[Any, "*batch joints"]) -> Float[Any, "*batch joints"]:
        """Readings of rotor positions, `resolution * floor(q / resolution + phase)` [rad or m];
        NumPy or JAX arrays."""
        xp = q.__array_namespace__()
        exact = self.resolution == 0
        count = xp.where(exact, 1.0, self.resolution)
        return xp.where(exact, q, count * xp.floor(q / count + self.phase))

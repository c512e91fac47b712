from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._machine import Machine


@dataclass(frozen=True, eq=False)
class Encoders:
    """Incremental encoders, one a joint (7.1, 7.2.5).

    An encoder counts the lines that have passed since it was set to zero, so a reading is a whole
    number of counts. Where between two lines the joint stood at that moment is its phase, which
    differs every time the machine is switched on.

    ```python
    >>> import numpy as np
    >>> import sim
    >>> encoders = sim.Encoders(np.array([0.1, 0.0]), phase=np.array([0.5, 0.5]))
    >>> encoders.read(np.array([1.23, 1.23]))
    array([1.2 , 1.23])

    ```
    """

    resolution: Float[np.ndarray, " joints"]
    """What one count means at the joint [rad or m]; zero reads the position as it is."""

    phase: Float[np.ndarray, "*batch joints"]
    """In counts, from 0 to 1. A half makes a reading the nearest whole count; with any other, it
    is at most `max(phase, 1 - phase)` counts from the position."""

    @classmethod
    def of(cls, machine: Machine, phase: Float[np.ndarray, "*batch joints"]) -> "Encoders":
        """The encoders of a machine."""
        return cls(np.array(machine.encoder_resolution), phase)

    def read(self, q: Float[np.ndarray, "*batch joints"]) -> Float[np.ndarray, "*batch joints"]:
        """Readings of joint positions, `resolution * floor(q / resolution + phase)` [rad or m]."""
        exact = self.resolution == 0
        count = np.where(exact, 1.0, self.resolution)
        return np.where(exact, q, count * np.floor(q / count + self.phase))

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ._machine import Machine


@dataclass(frozen=True, eq=False)
class Transmission:
    """How rotors and links hang together (2.5.3), and where a plant keeps their motion.

    A plant's degrees of freedom are the links, one a joint, and after them the rotors of the
    joints whose transmission gives way. Every array here may have leading batch axes: machines
    whose same joints give way can be simulated together.

    ```python
    >>> import dataclasses
    >>> import sim
    >>> soft = (float("inf"), 5e4, *(float("inf"),) * 4)
    >>> transmission = sim.Transmission.of(dataclasses.replace(sim.puma560(), stiffness=soft))
    >>> transmission.rotor, transmission.freedoms
    (array([0, 6, 2, 3, 4, 5]), 7)

    ```
    """

    flexible: Bool[np.ndarray, " joints"]
    """Which joints have a rotor and a link that move apart."""

    backlash: Float[np.ndarray, "*batch joints"]
    """b [rad or m]."""

    @classmethod
    def of(cls, machine: Machine) -> "Transmission":
        """The transmission of a machine."""
        return cls(np.array(machine.flexible), np.array(machine.backlash))

    @property
    def freedoms(self) -> int:
        """How many degrees of freedom there are."""
        return int(self.flexible.size + np.count_nonzero(self.flexible))

    @property
    def rotor(self) -> Int[np.ndarray, " joints"]:
        """Which degree of freedom is each joint's rotor: its link's, where they are one body."""
        n = self.flexible.size
        return np.where(self.flexible, n + np.cumsum(self.flexible) - 1, np.arange(n))

    def spread(
        self,
        on_rotor: Float[np.ndarray, "*batch joints"],
        on_link: Float[np.ndarray, "*batch joints"],
    ) -> Float[np.ndarray, "*batch freedoms"]:
        """Values of each degree of freedom from those of rotors and links; added up where rotor
        and link are one body."""
        links = np.where(self.flexible, on_link, on_rotor + on_link)
        return np.concatenate([links, on_rotor[..., self.flexible]], axis=-1)

    def apart(
        self,
        rotor: Float[np.ndarray, "*batch joints"],
        link: Float[np.ndarray, "*batch joints"],
    ) -> Bool[np.ndarray, "*batch joints"]:
        """Whether the gears are apart: the joint is experiencing backlash (2.5.3)."""
        return np.abs(rotor - link) < self.backlash / 2

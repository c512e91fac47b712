"""Parameters of elastic gears."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class TransmissionParameters(NamedTuple):
    """What gears of f joints are.

    **Attributes**

    - `compliance`: (f,) one over stiffness [rad/(N m) or m/N].
    - `lag`: (f,) damping over stiffness [s].
    - `play`: (f,) how far a link moves while its rotor stands still [rad or m].
    - `rotor_inertia`: (f,) at the joint [kg m² or kg].
    """

    compliance: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]
    play: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]

    @classmethod
    def of(cls, values: Float[np.ndarray, " parameters"]) -> "TransmissionParameters":
        """Split (4 f,) values one after the other."""
        return cls(*values.reshape(4, -1))

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """(4 f,) one after the other."""
        return np.concatenate(self)

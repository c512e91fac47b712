"""Torque of equations of motion, with its derivatives."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._columns import JointColumns


# Steps of positions [rad or m] and velocities in forward differences. The error is this part of a
# second derivative; that of velocities counts by half an interval beside accelerations.
ANGLE, RATE = 1e-7, 1e-5


class Linearisation(NamedTuple):
    """The torque of every equation, and its derivatives.

    **Attributes**

    - `torque`: (equations, series): joints, and what else moves.
    - `by_position`: (equations, series, 3 series), by the positions at three samples.
    - `by_coefficient`: p + n columns: by `k`, then by the logarithms of slopes.
    - `by_turn`: (equations, n), by the moment at which the joint turns.
    """

    torque: Float[np.ndarray, "equations series"]
    by_position: Float[np.ndarray, "equations series positions"]
    by_coefficient: JointColumns
    by_turn: Float[np.ndarray, "equations joints"]

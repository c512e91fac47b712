from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._objective import Point


class SearchStart(NamedTuple):
    """Where a search starts.

    - `point`: all unknowns.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    """

    point: Point
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]

"""Torque along a motion, with the mean of friction before and after at rest."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int

from .._environment import array_namespace
from ..recordings import at_rest, directions_beside
from ._compiled import traced


Rows = Float[Array | np.ndarray, "samples joints"]

# Of a joint at rest, as a part of its greatest speed: only the sign of it counts.
_REST_SPEED = 1e-12


Selection: TypeAlias = slice | Int[np.ndarray, " some"]
"""Of samples."""


def friction_averaged_at_rest(
    torque: Callable[[Rows, Selection], Rows], qd: Rows, *, sample_by_sample: bool = True
) -> Rows:
    """Torque along a motion; at rest with the mean of the friction before and after.

    While a joint moves, its friction has the direction of its velocity. When it stops, what is left
    of that is anything up to all of it, and before it moves on, friction is that of the new
    direction. Between these, a measured velocity has the sign of its noise, or of a controller's
    creep. So a joint that turns back has none on average, one that goes on has all, and one that
    stands still at the beginning or at the end of a recording has half. Where recordings are
    joined, a rest at the beginning of one follows the motion at the end of the one before.

    `scripts/studies/real_robots/rests.py` compares this with other rules on real arms.

    **Arguments**

    - `torque`: torques [N m or N] as a function of the velocities of some samples, and of which
      these are: indices, or all of them as a slice.
    - `qd`: (samples, n) in order of time [rad/s or m/s].
    - `sample_by_sample`: whether some samples can be computed without the others.

    **Returns** torques (samples, n); those of `torque` itself where no joint is at rest
    (`jaxcslc.recordings.at_rest`).

    >>> import numpy as np
    >>> from jaxcslc.least_squares import friction_averaged_at_rest
    >>> qd = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])[:, None]
    >>> friction_averaged_at_rest(lambda qd, rows: 2.0 * np.sign(qd), qd)[:, 0].tolist()
    [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0]
    """
    everything = slice(None)
    measured, still = torque(qd, everything), at_rest(qd)
    if not traced(still) and not np.any(still):
        return measured
    xp = array_namespace(measured, qd)
    slow = _REST_SPEED * xp.max(xp.abs(qd), axis=0, keepdims=True)
    velocities = (
        xp.where(still, slow * direction, qd) for direction in directions_beside(qd, still)
    )
    some = xp.any(still, axis=1, keepdims=True)
    if xp is np and sample_by_sample:
        rows = np.flatnonzero(some)
        before, after = (torque(velocity[rows], rows) for velocity in velocities)
        averaged = np.array(measured)
        averaged[rows] = 0.5 * (before + after)
        return averaged
    before, after = (torque(velocity, everything) for velocity in velocities)
    return xp.where(some, 0.5 * (before + after), measured)

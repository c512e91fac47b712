from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int

from ..._environment import array_namespace
from ...motion import at_rest, direction_before
from ._compiled import traced


Rows = Float[Array | np.ndarray, "samples joints"]

# Of a joint at rest, as a part of its greatest speed: only the sign of it counts.
_REST_SPEED = 1e-12


Selection: TypeAlias = slice | Int[np.ndarray, " some"]
"""Of samples."""


def friction_halved_at_rest(
    torque: Callable[[Rows, Selection], Rows], qd: Rows, *, sample_by_sample: bool = True
) -> Rows:
    """Torque along a motion, with half the friction of joints that stand still.

    While a joint moves, its friction has the direction of its velocity. When it stops, what is left
    of it is anything from none to that of the direction the joint came from, and the velocity does
    not say: a measured one has the sign of its noise, or of a controller's creep. The middle is at
    most half the friction wrong. Before a first motion it is none; where recordings are joined, a
    rest at the beginning of one follows the motion at the end of the one before.

    On real arms with long rests this is nearer than the alternatives. Over all samples of motion
    that was not fitted, errors of joints 1 to 6 in percent of the torque
    (`scripts/studies/real_robots/rests.py`), with

    - half of it: TX40, a third to a half of whose motion is rest, 19 13 18 26 71 34; KR300, motion
      C, 21 17 11 37 20 23;
    - the sign of measured velocity: 20 14 22 33 109 66; 22 17 11 38 19 24;
    - none: 19 17 15 23 46 47; 22 18 11 41 21 25;
    - all of it: 20 11 28 40 136 27; 21 17 11 35 19 21.

    **Arguments**

    - `torque`: torques [N m or N] as a function of the velocities of some samples, and of which
      these are: indices, or all of them as a slice.
    - `qd`: (samples, n) in order of time [rad/s or m/s].
    - `sample_by_sample`: whether some samples can be computed without the others.

    **Returns** torques (samples, n); those of `torque` itself where no joint is at rest
    (`jaxcslc.motion.at_rest`).

    >>> import numpy as np
    >>> from jaxcslc.identification.solver import friction_halved_at_rest
    >>> qd = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])[:, None]
    >>> friction_halved_at_rest(lambda qd, rows: 2.0 * np.sign(qd), qd)[:, 0].tolist()
    [2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, -2.0]
    """
    everything = slice(None)
    measured, still = torque(qd, everything), at_rest(qd)
    if not traced(still) and not np.any(still):
        return measured
    xp = array_namespace(measured, qd)
    slow = _REST_SPEED * xp.max(xp.abs(qd), axis=0, keepdims=True) * direction_before(qd, still)
    velocities = (xp.where(still, velocity, qd) for velocity in (0.0, slow))
    some = xp.any(still, axis=1, keepdims=True)
    if xp is np and sample_by_sample:
        rows = np.flatnonzero(some)
        without, whole = (torque(velocity[rows], rows) for velocity in velocities)
        halved = np.array(measured)
        halved[rows] = 0.5 * (without + whole)
        return halved
    without, whole = (torque(velocity, everything) for velocity in velocities)
    return xp.where(some, 0.5 * (without + whole), measured)

import numpy as np
from jaxtyping import Float, Int

from ..torque import triangle_mean
from ._stretches import Stretches
from ._yielding_equations import YieldingEquations


Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]
# Below so many samples there are no differences of differences.
_FEWEST = 5
# Means are inverted in so many rounds: at even intervals, one leaves errors of fourth order.
_ROUNDS = 3


def truncation(
    equations: Stretches | YieldingEquations,
    k: Float[np.ndarray, " coefficients"],
    slopes: Float[np.ndarray, " joints"],
    q: Samples,
    time: Float[np.ndarray, " samples"],
    part: Int[np.ndarray, " samples"],
    turn: Rows,
    direction: Rows,
) -> Rows:
    """The triangle's mean of smooth torque less what equations have for it, (equations, n).

    Torque of an equation is of one instant, but for the mean of acceleration: what means of
    products leave out is of second order in the interval. Here all is of fourth order: velocity and
    acceleration at the instant, from differences of differences, and the mean of the torques of
    three instants as it is taken of recorded ones. It is as large as noise where torque is nearly
    exact and samples are few, and unlike noise it moves coefficients the same way all along.

    For positions as they are: a search takes it from one step to the next (deferred correction,
    Pereyra 1968), which leaves the band as narrow as it is. Not for held torques, whose steps make
    accelerations jump, and whose mean acceleration is exact.

    **Arguments**

    - `equations`; `k`, `slopes`, `q`, `turn` and `direction` as of its `torque`.
    - `time`: of the samples [s]; `part`: number of the recording of each.
    """
    result, shift = np.zeros((2, len(q) - 2, q.shape[1]))
    for number in range(int(part[-1]) + 1):
        samples = np.flatnonzero(part == number)
        if len(samples) < _FEWEST:
            continue
        rows = slice(int(samples[0]), int(samples[-1]) - 1)
        result[rows], shift[rows] = _of_recording(equations, k, q[samples], time[samples])
    changed, unchanged = (
        equations.friction(k, slopes, q, turn, direction, values) for values in (shift, 0.0 * shift)
    )
    return result + changed - unchanged


def _of_recording(
    equations: Stretches | YieldingEquations,
    k: Float[np.ndarray, " coefficients"],
    q: Samples,
    time: Float[np.ndarray, " samples"],
) -> tuple[Rows, Rows]:
    """That of all terms but friction, and what is missing in the mean velocity of friction."""
    h = np.diff(time)[:, None]
    before, after = h[:-1], h[1:]
    middle = time[1:-1]

    def mean(values: np.ndarray) -> np.ndarray:
        """Of a triangle about each instant; the first and the last change as their neighbours."""
        change = triangle_mean(middle, values) - values[1:-1]
        return values + np.concatenate([change[:1], change, change[-1:]])

    slope = np.diff(q, axis=0) / h
    parabola = (after * slope[:-1] + before * slope[1:]) / (before + after)
    mean_acceleration = 2.0 * np.diff(slope, axis=0) / (before + after)
    acceleration = mean_acceleration
    for _ in range(_ROUNDS):
        acceleration = acceleration + mean_acceleration - mean(acceleration)
    # A parabola's derivative errs by the third derivative times a sixth of both intervals.
    velocity = parabola - before * after / 6.0 * np.gradient(acceleration, middle, axis=0)
    torque = mean(equations.smooth(k, q[1:-1], velocity, acceleration))
    result = torque - equations.smooth(k, q[1:-1], parabola, mean_acceleration)
    # Friction is averaged over velocities on a line through the parabola's.
    line = parabola + (after - before) / 3.0 * mean_acceleration
    return result, mean(velocity) - line

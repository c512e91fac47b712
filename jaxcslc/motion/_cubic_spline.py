import numpy as np
import scipy
from jaxtyping import Float


class CubicSpline:
    """The interpolating cubic spline of signals, its third derivative continuous at the second knot
    and at the last but one ('not a knot').

    What `scipy.interpolate.CubicSpline` computes by default, whose import alone takes as long as
    twenty fits of a short recording.

    **Arguments**

    - `time`: ascending knots, four or more [s].
    - `values`: at the knots.

    **Raises** `ValueError` for fewer than four knots.

    >>> import numpy as np
    >>> time = np.linspace(0.0, 1.0, 11)
    >>> spline = CubicSpline(time, (time**3)[:, None])
    >>> spline(np.array([0.25]))[0, 0].round(9), spline(np.array([0.25]), 2)[0, 0].round(9)
    (np.float64(0.015625), np.float64(1.5))
    """

    def __init__(
        self, time: Float[np.ndarray, " knots"], values: Float[np.ndarray, "knots columns"]
    ) -> None:
        if len(time) < 4:
            raise ValueError(f"{len(time)} samples; expected 4 or more for a cubic spline")
        steps = np.diff(time)[:, None]
        rises = np.diff(values, axis=0) / steps
        slopes = _slopes(steps, rises)
        bend = (slopes[:-1] + slopes[1:] - 2.0 * rises) / steps
        self._time = time
        # Of each piece, from the value to the highest power.
        self._powers = (
            values[:-1],
            slopes[:-1],
            (rises - slopes[:-1]) / steps - bend,
            bend / steps,
        )

    def __call__(
        self, at: Float[np.ndarray, " samples"], derivative: int = 0
    ) -> Float[np.ndarray, "samples columns"]:
        """Values, or a derivative up to the second; beyond the ends those of the last pieces."""
        piece = np.clip(np.searchsorted(self._time, at, side="right") - 1, 0, len(self._time) - 2)
        d, c, b, a = (power[piece] for power in self._powers)
        x = (at - self._time[piece])[:, None]
        if derivative == 0:
            return ((a * x + b) * x + c) * x + d
        return (3.0 * a * x + 2.0 * b) * x + c if derivative == 1 else 6.0 * a * x + 2.0 * b


def _slopes(
    steps: Float[np.ndarray, "pieces 1"], rises: Float[np.ndarray, "pieces columns"]
) -> Float[np.ndarray, "knots columns"]:
    """Slopes at the knots (de Boor, A Practical Guide to Splines, chapter IV)."""
    first, last = steps[0] + steps[1], steps[-2] + steps[-1]
    bands = np.zeros((3, len(steps) + 1))
    bands[1, 1:-1] = 2.0 * (steps[:-1] + steps[1:])[:, 0]
    bands[0, 2:], bands[2, :-2] = steps[:-1, 0], steps[1:, 0]
    bands[1, [0, -1]] = steps[[1, -2], 0]
    bands[0, 1], bands[2, -2] = first[0], last[0]
    right = np.empty((len(steps) + 1, rises.shape[1]))
    right[1:-1] = 3.0 * (steps[1:] * rises[:-1] + steps[:-1] * rises[1:])
    right[0] = ((steps[0] + 2.0 * first) * steps[1] * rises[0] + steps[0] ** 2 * rises[1]) / first
    right[-1] = (
        steps[-1] ** 2 * rises[-2] + (2.0 * last + steps[-1]) * steps[-2] * rises[-1]
    ) / last
    return scipy.linalg.solve_banded((1, 1), bands, right)

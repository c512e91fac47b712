"""Smoothing by filters: central differences, Butterworth, and Savitzky and Golay.

Each is an `AbstractSmoothing`; see `_smoothing`. The thesis's own method is in `_splines`.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from ._clock import uniform_interval
from ._low_pass import zero_phase
from ._smoothing import AbstractSmoothing, Derivatives, register_smoothing


@register_smoothing("central_differences")
class CentralDifferences(AbstractSmoothing):
    """Plain differences of neighbouring samples (thesis, Eqns 7.2-1 and 7.2-2).

    No smoothing at all: of positions in steps of d, the accelerations are in steps of
    d / (4 interval²). Here to be compared with, and for positions without noise.

    >>> import numpy as np
    >>> from jaxcslc.recordings import CentralDifferences
    >>> time = np.arange(7.0)
    >>> q, qd, qdd = CentralDifferences().smooth(time, (time**2)[:, None])
    >>> qd[3, 0], qdd[3, 0]
    (np.float64(6.0), np.float64(2.0))
    """

    def smooth(
        self, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
    ) -> Derivatives:
        interval = uniform_interval(time)
        velocity = np.gradient(position, interval, axis=0, edge_order=2)
        return position, velocity, np.gradient(velocity, interval, axis=0, edge_order=2)

    def low_pass(
        self, time: Float[np.ndarray, " samples"], signal: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, "samples joints"]:
        del time
        return signal

    def reach(self, interval: float, joints: int) -> int:
        del interval, joints
        return 2

    @property
    def description(self) -> str:
        return "central differences"


@register_smoothing("butterworth")
class Butterworth(AbstractSmoothing):
    """The field's usual way: a zero-phase Butterworth filter, then central differences.

    The filter runs over the record forwards and backwards, so it delays nothing and its
    magnitude counts twice: at the cut-off it passes half, not 0.71.

    Time must be uniform; see `resample`.

    **Attributes**

    - `cutoff`: of the filter [Hz].
    - `order`: of one of its two passes.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Butterworth
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = Butterworth(cutoff=20.0).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[100:-100])) < 0.5)
    True
    """

    cutoff: float
    order: int = 4

    def __check_init__(self):
        if not self.cutoff > 0.0:
            raise ValueError(f"cut-off is {self.cutoff} Hz; expected more than 0")
        if self.order < 1:
            raise ValueError(f"filter order is {self.order}; expected 1 or more")

    def smooth(
        self, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
    ) -> Derivatives:
        return CentralDifferences().smooth(time, self.low_pass(time, position))

    def low_pass(
        self, time: Float[np.ndarray, " samples"], signal: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, "samples joints"]:
        return zero_phase(signal, uniform_interval(time), cutoff=self.cutoff, order=self.order)

    def reach(self, interval: float, joints: int) -> int:
        del joints
        return int(np.ceil(0.5 / (self.cutoff * interval)))

    @property
    def description(self) -> str:
        order = "" if self.order == 4 else f" of order {self.order}"
        return f"Butterworth{order} at {self.cutoff:g} Hz"


@register_smoothing("savitzky_golay")
class SavitzkyGolay(AbstractSmoothing):
    """Derivatives of polynomials fitted to the samples around each (Savitzky and Golay, 1964).

    A polynomial is fitted by least squares to a window that moves along the record; its value and
    derivatives in the middle are those of the sample there. Within half a window of an end of the
    record, they are those of the polynomial of the last whole window. As the window is symmetric,
    nothing is delayed.

    Its acceleration is that of the same polynomial: even orders and the odd ones above them give
    the same position in the middle, odd orders and the even ones below them the same velocity.

    Time must be uniform; see `resample`.

    **Attributes**

    - `window`: how many samples a polynomial is fitted to, an odd number.
    - `order`: of the polynomials, 2 or more and less than `window`.

    >>> import numpy as np
    >>> from jaxcslc.recordings import SavitzkyGolay
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = SavitzkyGolay(window=41).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[20:-20])) < 0.5)
    True
    """

    window: int
    order: int = 3

    def __check_init__(self):
        if self.window < 3 or self.window % 2 == 0:
            raise ValueError(f"window is {self.window} samples; expected an odd number from 3 on")
        if not 2 <= self.order < self.window:
            raise ValueError(
                f"polynomial order is {self.order}; expected at least 2, for there to be an "
                f"acceleration, and less than the window of {self.window} samples"
            )

    def smooth(
        self, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
    ) -> Derivatives:
        return (
            self._filter(time, position, 0),
            self._filter(time, position, 1),
            self._filter(time, position, 2),
        )

    def low_pass(
        self, time: Float[np.ndarray, " samples"], signal: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, "samples joints"]:
        return self._filter(time, signal, 0)

    def reach(self, interval: float, joints: int) -> int:
        del interval, joints
        return self.window // 2

    @property
    def description(self) -> str:
        return f"Savitzky-Golay of {self.window} samples and order {self.order}"

    def _filter(
        self,
        time: Float[np.ndarray, " samples"],
        signal: Float[np.ndarray, "samples joints"],
        derivative: int,
    ) -> Float[np.ndarray, "samples joints"]:
        interval = uniform_interval(time)
        if time.size < self.window:
            raise ValueError(
                f"{time.size} samples; expected {self.window} or more for a window of as many"
            )
        half = self.window // 2
        weights = _polynomial_weights(self.window, self.order, derivative) / interval**derivative
        filtered = np.empty(signal.shape)
        for smoothed, column in zip(filtered.T, signal.T, strict=True):
            smoothed[half:-half] = np.correlate(column, weights[half], mode="valid")
        filtered[:half] = weights[:half] @ signal[: self.window]
        filtered[-half:] = weights[-half:] @ signal[-self.window :]
        return filtered


@lru_cache(maxsize=64)
def _polynomial_weights(
    window: int, order: int, derivative: int
) -> Float[np.ndarray, "window window"]:
    """Return the weights of a window's samples for a derivative of the polynomial fitted to them.

    Row i gives the derivative at sample i; the interval between samples is 1.
    """
    from numpy.polynomial import legendre

    half = window // 2
    x = np.arange(-half, half + 1) / half
    basis, transform = np.linalg.qr(legendre.legvander(x, order))
    slopes = legendre.legder(np.eye(order + 1), derivative) / half**derivative
    values = legendre.legvander(x, len(slopes) - 1) @ slopes
    weights = values @ np.linalg.solve(transform, basis.T)
    weights.setflags(write=False)
    return weights

import numpy as np
from jaxtyping import Float

from ._resampling import uniform_interval
from ._smoothing import AbstractSmoothing, Derivatives


MEMORY = 5.0
"""After so many periods of its cut-off, less than 1e-5 is left of what a filter of fourth order
has seen: its slowest poles fade by exp(-0.38 · 2π) in each."""


class CentralDifferences(AbstractSmoothing):
    """Plain differences of neighbouring samples (thesis, Eqns 7.2-1 and 7.2-2).

    No smoothing at all: of positions in steps of d, the accelerations are in steps of
    d / (4 interval²). Here to be compared with, and for positions without noise.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import CentralDifferences
    >>> time = np.arange(7.0)
    >>> q, qd, qdd = CentralDifferences().smooth(time, (time**2)[:, None])
    >>> qd[3, 0], qdd[3, 0]
    (np.float64(6.0), np.float64(2.0))

    ```
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


class Butterworth(AbstractSmoothing):
    """The field's usual way: a zero-phase Butterworth filter, then central differences.

    The filter runs over the record forwards and backwards, so it delays nothing and its
    magnitude counts twice: at the cut-off it passes half, not 0.71.

    Time must be uniform; see `resample`.

    **Attributes:**

    - `cutoff`: of the filter [Hz].
    - `order`: of one of its two passes.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import Butterworth
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = Butterworth(cutoff=20.0).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[100:-100])) < 0.5)
    True

    ```
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


def zero_phase(
    signal: Float[np.ndarray, " samples *columns"],
    interval: float,
    *,
    cutoff: float,
    order: int = 4,
) -> Float[np.ndarray, " samples *columns"]:
    """Runs a Butterworth low-pass filter over a signal forwards and backwards.

    **Arguments:**

    - `signal`: sampled along its first axis, shape `(samples, ...)`.
    - `interval`: between samples [s].
    - `cutoff`: where the two passes together leave half of the amplitude [Hz].
    - `order`: of one pass.

    **Returns:**

    The filtered signal, of the same shape. A linear function of the signal.

    **Raises:**

    - `ValueError`: a cut-off that is not between 0 and half the sampling rate, or fewer samples
        than the filter needs to start from.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import zero_phase
    >>> bool(np.allclose(zero_phase(np.ones((100, 2)), 0.01, cutoff=5.0), 1.0))
    True

    ```
    """
    if not 0.0 < cutoff < 0.5 / interval:
        raise ValueError(
            f"cut-off is {cutoff} Hz; expected more than 0 and less than half the sampling rate "
            f"of {1.0 / interval:.6g} Hz"
        )
    from scipy.signal import butter, sosfiltfilt  # takes a second to import

    sections = butter(order, cutoff, fs=1.0 / interval, output="sos")
    fewest = 3 * (order + 1)
    if signal.shape[0] < fewest:
        raise ValueError(
            f"{signal.shape[0]} samples; expected {fewest} or more for a filter of order {order}"
        )
    # The record goes on by its own reflection in its end points for as long as the filter
    # remembers: scipy's default is a few samples, of which a slow filter leaves transients.
    padding = min(int(np.ceil(MEMORY / (cutoff * interval))), signal.shape[0] - 1)
    return sosfiltfilt(sections, signal, axis=0, padlen=padding)

import numpy as np
from jaxtyping import Float

from ._resampling import uniform_interval
from ._smoothing import AbstractSmoothing, Derivatives


class SavitzkyGolay(AbstractSmoothing):
    """Derivatives of polynomials fitted to the samples around each (Savitzky and Golay, 1964).

    A polynomial is fitted by least squares to a window that moves along the record; its value and
    derivatives in the middle are those of the sample there. Within half a window of an end of the
    record, they are those of the polynomial of the last whole window. As the window is symmetric,
    nothing is delayed.

    Its acceleration is that of the same polynomial: even orders and the odd ones above them give
    the same position in the middle, odd orders and the even ones below them the same velocity.

    Time must be uniform; see `resample`.

    **Attributes:**

    - `window`: how many samples a polynomial is fitted to, an odd number.
    - `order`: of the polynomials, 2 or more and less than `window`.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import SavitzkyGolay
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = SavitzkyGolay(window=41).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error[20:-20])) < 0.5)
    True

    ```
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
        from scipy.signal import savgol_filter  # takes a second to import

        return savgol_filter(
            signal, self.window, self.order, deriv=derivative, delta=interval, axis=0
        )

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from ._recording import Recording, without_stale_rows


UNIFORM_TO = 1e-3
"""Intervals that differ by less than this part of their mean count as equal: time stamps are
written with a finite number of digits, and a part in a thousand changes no derivative by more."""


def uniform_interval(time: Float[np.ndarray, " samples"]) -> float:
    """The interval of uniformly spaced times.

    **Arguments:**

    - `time`: instants of the samples, shape `(samples,)` [s].

    **Returns:**

    The interval [s].

    **Raises:**

    - `ValueError`: times that are not uniform; samples count from 1 in the message.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import uniform_interval
    >>> uniform_interval(np.array([0.0, 0.25, 0.5]))
    0.25

    ```
    """
    if time.size < 2:
        raise ValueError(f"{time.size} samples; expected two or more to tell an interval")
    interval = float((time[-1] - time[0]) / (time.size - 1))
    intervals = np.diff(time)
    worst = int(np.argmax(np.abs(intervals - interval)))
    if abs(intervals[worst] - interval) > UNIFORM_TO * interval:
        raise ValueError(
            f"time is not uniform: {intervals[worst]:.6g} s from sample {worst + 1} to the next, "
            f"{interval:.6g} s in the mean; expected equal intervals (resample the recording first)"
        )
    return interval


def resample(
    recording: Recording, interval: float | None = None, *, drop_stale: bool = True
) -> Recording:
    """Brings a recording to uniform time, as filters need it.

    Between samples, positions and torques follow the monotone piecewise cubic of Fritsch and
    Butland (SIAM J. Sci. Stat. Comput. 5, 1984): it adds no overshoot where quantised or noisy
    samples jump, as a spline would.

    **Arguments:**

    - `recording`: with any increasing times.
    - `interval`: of the result [s]; by default the median interval of the recording.
    - `drop_stale`: leave samples that repeat the values of the one before out of the
        interpolation; see `without_stale_rows`.

    **Returns:**

    The recording at uniform times from its first sample to its last.

    **Raises:**

    - `ValueError`: an interval that is not positive.
    - `RecordingError`: too few samples are left.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import Recording, resample
    >>> time = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5])
    >>> uniform = resample(Recording(time, 2 * time[:, None], time[:, None]))
    >>> uniform.time.round(3).tolist(), uniform.position[3].round(3).tolist()
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], [0.6])

    ```
    """
    if interval is None:
        interval = float(np.median(np.diff(recording.time)))
    if not interval > 0.0:
        raise ValueError(f"resampling interval is {interval} s; expected more than 0")
    fresh = without_stale_rows(recording) if drop_stale else recording
    start, end = fresh.time[0], fresh.time[-1]
    # The last sample is kept where it falls on the new grid but for rounding.
    time = start + interval * np.arange(int(np.floor((end - start) / interval + 1e-6)) + 1)
    at = np.minimum(time, end)

    def between(values: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, "new joints"]:
        return PchipInterpolator(fresh.time, values, axis=0)(at)

    return Recording(
        time,
        between(fresh.position),
        between(fresh.torque),
        None if fresh.velocity is None else between(fresh.velocity),
        None if fresh.acceleration is None else between(fresh.acceleration),
    )

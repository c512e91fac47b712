"""Times of samples: alignment of torques, uniform intervals, resampling, and restored clocks.

The alignment says which torque drove a sample (thesis, Section 7.4).
"""

import dataclasses
from typing import Literal, TypeAlias

import numpy as np
import scipy
from jaxtyping import Float, Int

from ._recording import Recording, RecordingError, Samples, Signals, without_stale_rows
from ._sampling import noise_level
from ._splines import AveragedSplines


TorqueAlignment: TypeAlias = Literal["sample", "previous", "mean"]
"""Which torque belongs to the motion at a sample; see `align_torque`."""


def align_torque(torque: Signals, alignment: TorqueAlignment) -> Signals:
    """Give every sample of a motion the torque that acted on it (thesis, Section 7.4).

    A drive that holds its demand applies `torque[n]` from sample n to sample n + 1. The
    acceleration jumps at the samples, and what a smoothed record of positions shows there lies
    between the accelerations on either side.

    **Arguments**

    - `torque`: demanded or measured torques, shape `(samples, joints)` [N m or N].
    - `alignment`: `"sample"` takes it as it is: right for torques measured at the instant of the
      sample. `"previous"` takes the demand one sample earlier, which drove the arm into the
      sampled configuration: the thesis's choice. `"mean"` takes the mean of the two intervals
      that meet at the sample: right for a held demand and derivatives that are smoothed
      symmetrically, the only one of the three without a delay of half an interval.

    **Returns** the aligned torques, shape `(samples, joints)`. The demand before the first sample
    is unknown; the first sample keeps its torque.

    **Raises** `ValueError`: an alignment that is none of the three.

    >>> import numpy as np
    >>> from jaxcslc.recordings import align_torque
    >>> torque = np.array([[1.0], [3.0], [7.0]])
    >>> align_torque(torque, "previous")[:, 0].tolist()
    [1.0, 1.0, 3.0]
    >>> align_torque(torque, "mean")[:, 0].tolist()
    [1.0, 2.0, 5.0]
    """
    previous = np.concatenate([torque[:1], torque[:-1]])
    if alignment == "sample":
        return torque
    if alignment == "previous":
        return previous
    if alignment == "mean":
        return 0.5 * (previous + torque)
    raise ValueError(
        f"torque alignment {alignment!r} is unknown; expected 'sample', 'previous' or 'mean'"
    )


_MOST_PERIODS = 1e9  # of a recording: eleven days at 1 kHz
# Part of its time that a recording's samples cover at least: a bound of what is filled in between
# them, so that one wrong time stamp cannot ask for all memory.
_LEAST_COVERED = 0.1

DETERMINED_TO = 0.1
"""An interval is determined by the motion if its standard deviation is below this part of a period:
rounding to whole periods is then wrong less than once in a million times."""


def resample(
    recording: Recording, interval: float | None = None, *, drop_stale: bool = True
) -> Recording:
    """Bring a recording to uniform time, as filters need it.

    Between samples, positions and torques follow the monotone piecewise cubic of Fritsch and
    Butland (SIAM J. Sci. Stat. Comput. 5, 1984): it adds no overshoot where quantised or noisy
    samples jump, as a spline would.

    **Arguments**

    - `recording`: with any increasing times.
    - `interval`: of the result [s]; by default the median interval of the recording.
    - `drop_stale`: leave samples that repeat the values of the one before out of the
        interpolation; see `without_stale_rows`.

    **Returns** the recording at uniform times from its first sample to its last.

    **Raises**

    - `ValueError`: an interval that is not positive.
    - `RecordingError`: too few samples are left, or gaps are nine tenths of the time: cut them
      off with `Recording.between`.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, resample
    >>> time = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5])
    >>> uniform = resample(Recording(time, 2 * time[:, None], time[:, None]))
    >>> uniform.time.round(3).tolist(), uniform.position[3].round(3).tolist()
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], [0.6])
    """
    if interval is None:
        interval = float(np.median(np.diff(recording.time)))
    if not interval > 0.0:
        raise ValueError(f"resampling interval is {interval} s; expected more than 0")
    fresh = without_stale_rows(recording) if drop_stale else recording
    start, end = fresh.time[0], fresh.time[-1]
    intervals = np.diff(fresh.time)
    covered = float(np.median(intervals)) * intervals.size / (end - start)
    if covered < _LEAST_COVERED:
        gap = int(np.argmax(intervals))
        raise RecordingError(
            f"samples cover {covered:.2g} of the time from {start:g} s to {end:g} s, with no sample"
            f" between {fresh.time[gap]:g} s and {fresh.time[gap + 1]:g} s; expected"
            f" {_LEAST_COVERED:g} or more: cut the recording at its gaps (`between`)"
        )
    # The last sample is kept where it falls on the new grid, up to rounding.
    time = start + interval * np.arange(int(np.floor((end - start) / interval + 1e-6)) + 1)
    at = np.minimum(time, end)

    def between(values: Signals) -> Float[np.ndarray, "new joints"]:
        return scipy.interpolate.PchipInterpolator(fresh.time, values, axis=0)(at)

    return fresh.at_times(time, between)


# Samples between knots of the splines that estimate velocities from stamped positions.
_SPACING = 25


def restore_clock(recording: Recording, period: float) -> Recording:
    r"""Give samples of an evenly running source the times at which they were taken.

    A controller samples to the microsecond; a recorder that listens to it stamps each message
    when it arrives, late by a varying delay, misses some and repeats others. At a velocity of
    1 rad/s a delay that varies by 0.2 ms moves a position by 0.2 mrad, which can be a hundred
    times the encoder's own noise.

    Where the arm moves, the positions determine the time that has passed between two samples: for
    small noise it is $\Delta q \cdot \dot q / |\dot q|^2$, all joints taken together and each
    weighted by its noise. Between samples of an even clock it is a whole number of periods. Where
    the arm is too slow, the stamps decide, and a wrong guess moves the positions by
    little more than their noise.

    **Arguments**

    - `recording`: stamped by its recorder, stale samples included.
    - `period`: of the source [s].

    **Returns** the recording at multiples of the period, counted from about its first stamp.
    Samples that repeat the one before are gone, lost ones leave gaps.

    **Raises**

    - `ValueError`: a period that is not positive.
    - `RecordingError`: a motion that shows no such clock, or one that does not keep pace with
        the stamps.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, restore_clock
    >>> rng = np.random.default_rng(0)
    >>> time = np.delete(np.arange(2000) * 0.001, [500, 501, 1200])
    >>> position = np.stack([np.sin(3 * time), np.cos(3 * time)], axis=1)
    >>> stamped = Recording(time + rng.uniform(0.0, 0.0005, time.size), position, position)
    >>> restored = restore_clock(stamped, period=0.001)
    >>> bool(np.allclose(np.diff(restored.time), np.diff(time)))
    True
    """
    if not 0.0 < period < np.inf:
        raise ValueError(f"period is {period} s; expected more than 0")
    length = float(recording.time[-1] - recording.time[0])
    if length > _MOST_PERIODS * period:
        raise ValueError(
            f"period is {period:g} s; expected more than {length / _MOST_PERIODS:.2g} s, for a"
            f" recording of {length:g} s"
        )
    fresh = without_stale_rows(recording)
    stamps, position = fresh.time, fresh.position
    noise = np.maximum(noise_level(position), np.finfo(np.float64).eps)

    time = stamps
    # The velocities come from the stamped times first and from the restored ones then.
    for _ in range(2):
        passed, deviation = _time_passed(time, position / noise)
        determined = deviation < DETERMINED_TO * period
        ticks = _ticks(stamps, np.where(determined, passed, np.nan), period)
        time = np.median(stamps - ticks * period) + ticks * period
        # Equal times, of samples that repeat positions but not torques, cannot be splined.
        new = np.append(True, np.diff(ticks) > 0)
        fresh = fresh.rows(new)
        time, stamps, position = time[new], fresh.time, fresh.position
    passed, deviation = _time_passed(time, position / noise)
    determined = deviation < DETERMINED_TO * period
    if np.mean(determined) < 0.5:
        raise RecordingError(
            f"the motion is too slow or too noisy to show a clock of {period:g} s: it determines "
            f"{np.mean(determined):.0%} of the intervals; expected half of them or more"
        )
    misfit = np.median(np.abs(passed - np.diff(time))[determined]) / period
    if misfit > DETERMINED_TO:
        raise RecordingError(
            f"the motion shows no clock of {period:g} s: half of its intervals are {misfit:.2g} "
            f"periods or more from whole numbers of them; expected less than {DETERMINED_TO}"
        )
    strayed = float(np.ptp(stamps - time))
    if strayed > 0.01 * (stamps[-1] - stamps[0]):
        raise RecordingError(
            f"a clock of {period:g} s strays from the time stamps by {strayed:.3g} s; "
            "expected less than 1 % of the recording"
        )
    return dataclasses.replace(fresh, time=time)


def _time_passed(
    time: Samples,
    scaled: Signals,
) -> tuple[Float[np.ndarray, " intervals"], Float[np.ndarray, " intervals"]]:
    """Return the time between samples as the motion determines it, and its standard deviation.

    - `scaled`: positions in units of their noise.
    """
    _, velocity, _ = AveragedSplines(_SPACING, sections=False).smooth(time, scaled)
    between = 0.5 * (velocity[1:] + velocity[:-1])
    squared = np.maximum(np.sum(between**2, axis=1), np.finfo(np.float64).tiny)
    passed = np.sum(np.diff(scaled, axis=0) * between, axis=1) / squared
    # Where the arm sets off or stops, smoothing makes a velocity of one that is not there yet.
    steady = squared > 0.25 * scipy.ndimage.maximum_filter1d(squared, 2 * _SPACING + 1)
    return passed, np.where(steady, np.sqrt(2.0 / squared), np.inf)


def _ticks(
    stamps: Samples,
    passed: Float[np.ndarray, " intervals"],
    period: float,
) -> Int[np.ndarray, " samples"]:
    """Number the samples in periods; intervals that are NaN follow the stamps."""
    ticks = np.zeros(stamps.size, dtype=np.int64)
    delay = stamps[0]
    for sample, interval in enumerate(passed, start=1):
        before = ticks[sample - 1]
        if np.isnan(interval):
            ticks[sample] = max(before + 1, round((stamps[sample] - delay) / period))
        else:
            ticks[sample] = before + max(0, round(interval / period))
        # The delay of the last fifty samples or so, against which a stamp alone is read.
        delay += 0.02 * (stamps[sample] - ticks[sample] * period - delay)
    return ticks

"""Sampling of a recording: interval, encoder resolution and noise, estimated from the recording."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ._recording import Recording, Samples, Signals


# An encoder counts as coarser, readings as noisier, from these ratios on. What `noise_level` sees
# of a motion itself makes the latter less certain.
_COARSER, _NOISIER = 1.5, 3.0
_ALIKE = 0.1  # sampling rates that differ by less than this part are alike
# Intervals that differ from their mean by less than this part of it count as regular.
_REGULAR = 0.01
_ORDER = 6  # of the differences that noise is seen in
_BINOMIAL = np.poly(np.ones(_ORDER))  # of even intervals
_THIRD = np.poly(np.ones(3))  # the same of third differences
# Median of a normal variable's absolute value, in standard deviations.
NORMAL_MEDIAN = 0.6744897501960817
# Third differences that see more than so many times as much as sixth ones have seen motion.
_MOTION = 1.5


# Steps of an encoder: equal to this part of the largest value; smallest ones that tell their size;
# how near to multiples of it, and how many of them, make a grid.
_EQUAL, _TELLING, _NEAR, _ON_GRID = 1e-9, 8.5, 0.05, 0.9

STEP_DEVIATIONS = np.sqrt(12.0)
"""Standard deviations of rounding to steps in one step."""

UNIFORM_TO = 1e-3
"""Intervals that differ by less than this part of their mean count as equal: time stamps are
written with a finite number of digits, and a part in a thousand changes no derivative by more."""


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Sampling of a recording: what settings that suit it depend on besides the motion.

    **Attributes**

    - `interval`: median interval between samples [s].
    - `irregularity`: greatest difference of an interval from the median, as part of it.
    - `resolution`: step of each joint's encoder [rad or m]; 0 where readings show no steps.
    - `noise`: standard deviation of each joint's readings about a smooth motion [rad or m].

    >>> import numpy as np, jaxcslc as jc
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(time)[:, None] / 1e-4)
    >>> fine = jc.recordings.Sampling.of(jc.Recording(time, position, position))
    >>> steps = 4e-4 * np.round(position / 4e-4)
    >>> jc.recordings.Sampling.of(jc.Recording(time, steps, position)).coarser_than(fine)
    ('joint 1: encoder steps of 0.0004, 4 times the 0.0001 that the settings were chosen for',)
    """

    interval: float
    irregularity: float
    resolution: tuple[float, ...]
    noise: tuple[float, ...]

    @classmethod
    def of(cls, recording: Recording) -> "Sampling":
        """Return the sampling of a recording, with or without steps and even intervals."""
        intervals = np.diff(recording.time)
        interval = float(np.median(intervals))
        return cls(
            interval=interval,
            irregularity=float(np.max(np.abs(intervals - interval)) / interval),
            resolution=tuple(encoder_resolution(recording.position).tolist()),
            noise=tuple(noise_level(recording.position).tolist()),
        )

    def coarser_than(self, other: "Sampling") -> tuple[str, ...]:
        """List what is coarser here than in the sampling that settings were chosen for.

        A sentence for each joint whose encoder is coarser or whose readings are noisier, and one
        for irregular time stamps.
        """
        sentences: list[str] = []
        # At another rate, differences of the motion itself would pass for noise.
        alike = abs(self.interval / other.interval - 1.0) < _ALIKE
        joints = zip(self.resolution, other.resolution, self.noise, other.noise, strict=True)
        for joint, (step, other_step, noise, other_noise) in enumerate(joints, 1):
            if other_step > 0.0 and step > _COARSER * other_step:
                kind, here, there = "encoder steps", step, other_step
            elif alike and noise > _NOISIER * other_noise > 0.0:
                kind, here, there = "position noise", noise, other_noise
            else:
                continue
            sentences.append(
                f"joint {joint}: {kind} of {here:.3g}, {here / there:.3g} times the {there:.3g}"
                " that the settings were chosen for"
            )
        if self.irregularity > max(_REGULAR, 2.0 * other.irregularity):
            sentences.append(
                f"irregular time stamps: intervals differ from their median by up to"
                f" {100 * self.irregularity:.3g} %, by {100 * other.irregularity:.3g} % where the"
                " settings were chosen"
            )
        return tuple(sentences)


def uniform_interval(time: Samples) -> float:
    """Return the interval of uniformly spaced times [s].

    **Raises** `ValueError`: times that are not uniform; samples count from 1 in the message.

    >>> import numpy as np
    >>> from jaxcslc.recordings import uniform_interval
    >>> uniform_interval(np.array([0.0, 0.25, 0.5]))
    0.25
    """
    if time.size < 2:
        raise ValueError(f"{time.size} samples; expected two or more for an interval")
    interval = float((time[-1] - time[0]) / (time.size - 1))
    intervals = np.diff(time)
    worst = int(np.argmax(np.abs(intervals - interval)))
    if abs(intervals[worst] - interval) > UNIFORM_TO * interval:
        raise ValueError(
            f"time is not uniform: {intervals[worst]:.6g} s from sample {worst + 1} to the next, "
            f"{interval:.6g} s in the mean; expected equal intervals (resample the recording first)"
        )
    return interval


def encoder_resolution(
    position: Signals,
) -> Float[np.ndarray, " joints"]:
    """Estimate the counts that recorded positions are made of, joint by joint.

    An encoder's readings are integer multiples of one step (thesis, Section 7.2.5). The smallest
    step between any two readings shows it, provided that the other small steps are multiples of
    it; otherwise the readings lie on no grid.

    **Arguments**

    - `position`: joint positions, shape `(samples, joints)` [rad or m].

    **Returns** the width of a count, shape `(joints,)` [rad or m]; 0 for a joint that shows no
    grid: a position that was not quantised, or that never changes.

    >>> import numpy as np
    >>> from jaxcslc.recordings import encoder_resolution
    >>> time = np.linspace(0.0, 3.0, 1000)
    >>> smooth = np.stack([np.sin(time), np.cos(time)], axis=1)
    >>> counts = np.array([1e-4, 2e-4])
    >>> encoder_resolution(counts * np.round(smooth / counts)).round(9).tolist()
    [0.0001, 0.0002]
    >>> encoder_resolution(smooth).tolist()
    [0.0, 0.0]
    """
    return np.array([_smallest_step(column) for column in position.T])


def noise_level(values: Signals) -> Float[np.ndarray, " joints"]:
    r"""Estimate how far recorded values scatter about a smooth motion, column by column.

    Third differences of a motion that is smooth on the scale of a few samples are all noise,
    $\sqrt{20}$ times that of the values. Their median absolute value disregards the few that
    straddle a jump. Where `sixth_differences` see much less, the third ones have seen motion, and
    the sixth ones count. Quantisation adds a step's $1/\sqrt{12}$, the least there can be.

    **Arguments**

    - `values`: as joint positions, shape `(samples, joints)`, four samples or more, at roughly
        even intervals.

    **Returns** the standard deviation of the noise, shape `(joints,)`, in the unit of the values.

    >>> import numpy as np
    >>> from jaxcslc.recordings import noise_level
    >>> time = np.linspace(0.0, 3.0, 1000)[:, None]
    >>> quantised = 1e-4 * np.round(np.sin(time) / 1e-4)
    >>> bool(1e-4 < noise_level(quantised)[0] * 12**0.5 < 1.2e-4)
    True
    """
    third = np.median(np.abs(np.diff(values, n=3, axis=0)), axis=0)
    scatter = third / (NORMAL_MEDIAN * np.linalg.norm(_THIRD))
    if len(differences := sixth_differences(values)):
        sixth = np.median(np.abs(differences), axis=0) / NORMAL_MEDIAN
        scatter = np.where(scatter > _MOTION * sixth, sixth, scatter)
    return np.maximum(scatter, encoder_resolution(values) / STEP_DEVIATIONS)


def sixth_differences(
    values: Signals,
    time: Samples | None = None,
) -> Float[np.ndarray, "differences joints"]:
    """Return divided differences of sixth order, scaled so that white noise keeps its variance.

    A polynomial of fifth order, and so next to all motion that is sampled well, is not in them:
    motion of a period of 20 samples is a thousandth of its amplitude.

    **Arguments**

    - `values`: shape `(samples, joints)`.
    - `time`: instants of the samples, shape `(samples,)`; None: even intervals.

    **Returns** the differences, shape `(samples - 6, joints)`, in the unit of the values.

    >>> import numpy as np
    >>> from jaxcslc.recordings import sixth_differences
    >>> time = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 50))
    >>> bool(np.abs(sixth_differences(time[:, None] ** [1, 5], time)).max() < 1e-12)
    True
    """
    if len(values) <= _ORDER:
        return np.zeros((0, values.shape[1]))
    if time is None:
        count = len(values) - _ORDER
        differences = np.zeros((count, values.shape[1]))
        for first, weight in enumerate(_BINOMIAL / np.linalg.norm(_BINOMIAL)):
            differences += weight * values[first : first + count]
        return differences
    points = np.lib.stride_tricks.sliding_window_view(time, _ORDER + 1)
    apart = (points[:, :, None] - points[:, None, :]) / np.median(np.diff(time))
    weights = 1.0 / np.prod(np.where(np.eye(_ORDER + 1, dtype=bool), 1.0, apart), axis=2)
    weights = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    windows = np.lib.stride_tricks.sliding_window_view(values, _ORDER + 1, axis=0)
    return np.einsum("sp,sjp->sj", weights, windows)


def _smallest_step(values: Samples) -> float:
    levels = np.unique(values)
    steps = np.diff(levels)
    # Equal counts may differ by rounding of their conversion to radians.
    steps = steps[steps > _EQUAL * np.max(np.abs(levels), initial=0.0)]
    if steps.size == 0:
        return 0.0
    smallest = np.min(steps)
    # Far larger steps would tell the count more exactly than it deserves: an error of the
    # smallest would grow to a whole count there.
    multiples = steps[steps < _TELLING * smallest] / smallest
    nearest = np.round(multiples)
    on_grid = np.abs(multiples - nearest) < _NEAR
    # Without a grid, a tenth of the steps would pass that test by chance.
    if multiples.size < 2 or np.mean(on_grid) < _ON_GRID:
        return 0.0
    return float(smallest * np.median(multiples[on_grid] / nearest[on_grid]))

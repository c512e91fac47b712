"""Recordings as the equations of motion need them: positions, and averaged torques."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from ..recordings import Recording


TorqueSampling = Literal["held", "sampled"]
"""Meaning of a recorded torque: held until the next sample, or the value at that instant."""


@dataclasses.dataclass(frozen=True)
class TorqueRecord:
    """Recorded torques of one recording or of several, as the equations of motion need them.

    The second difference of positions is the acceleration averaged with a triangle over the two
    intervals that meet at a sample; torque in the same equation is averaged alike.

    **Attributes**

    - `times`: (samples,) of each recording [s]; `torques`: (samples, n) of each.
    - `sampling`: what a recorded torque is.
    - `every`: equations are at every so many samples; torque between them counts.

    >>> import numpy as np
    >>> line = np.arange(5.0)[:, None]
    >>> record = TorqueRecord.of([Recording(np.arange(5.0), line, line)], "held")
    >>> record.averaged[:, 0].tolist(), record.rate[:, 0].tolist()
    ([0.5, 1.5, 2.5], [1.0, 1.0, 1.0])
    """

    times: tuple[Float[np.ndarray, " _"], ...]
    torques: tuple[Float[np.ndarray, "_ joints"], ...]
    sampling: TorqueSampling
    every: int = 1

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], sampling: TorqueSampling, every: int = 1
    ) -> "TorqueRecord":
        """Join recordings of the same joints."""
        return cls(
            tuple(np.asarray(recording.time, float) for recording in recordings),
            tuple(np.asarray(recording.torque, float) for recording in recordings),
            sampling,
            every,
        )

    @cached_property
    def averaged(self) -> Float[np.ndarray, "equations joints"]:
        """Torque of every equation; zeros where an equation spans two recordings."""
        return self._means(0)

    @property
    def rate(self) -> Float[np.ndarray, "equations joints"]:
        """The derivative of `averaged` by the time at which torques are taken [N m/s or N/s]."""
        return self._means(1)

    def _means(self, order: int) -> Float[np.ndarray, "equations joints"]:
        """Return means of the torque, or of its derivative of first order.

        They are zeros for the two equations that span two recordings.
        """
        between = np.zeros((2, self.torques[0].shape[1]))
        parts: list[np.ndarray] = []
        for time, torque in zip(self.times, self.torques, strict=True):
            knots = time[:: self.every]
            if self.sampling == "held":
                means = _held(time, torque, knots, _density if order else _remaining)
            elif self.every > 1:
                means = _integrated(time, torque, knots, 2 - order)
            else:
                means = triangle_mean(time, _spline(time, torque)(time, 1) if order else torque)
            parts += [between, means]
        return np.concatenate(parts[1:])


def _spline(
    time: Float[np.ndarray, " samples"], torque: Float[np.ndarray, "samples joints"]
) -> Any:
    return scipy.interpolate.CubicSpline(time, torque)


def _held(
    time: Float[np.ndarray, " samples"],
    torque: Float[np.ndarray, "samples joints"],
    knots: Float[np.ndarray, " knots"],
    weight: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
) -> Float[np.ndarray, "equations joints"]:
    """Return the triangle's mean of steps: each step counts by the part of the triangle after it.

    - `knots`: of equations; each is over two intervals between them.
    - `weight`: of a step, `_remaining`; or its derivative by the lag, `_density`.
    """
    start, middle, end = knots[:-2], knots[1:-1], knots[2:]
    first = np.maximum(np.searchsorted(time, start, side="right"), 1)
    last = np.searchsorted(time, end, side="left")  # the first step that is too late
    result = torque[first - 1] if weight is _remaining else np.zeros_like(torque[first])
    for number in range(max(int(np.max(last - first)), 0)):
        index = np.minimum(first + number, len(time) - 1)
        moment = time[index] - middle
        share = np.where(first + number < last, weight(moment, middle - start, end - middle), 0.0)
        result = result + share[:, None] * (torque[index] - torque[index - 1])
    return result


def _remaining(
    moment: Float[np.ndarray, " equations"],
    before: Float[np.ndarray, " equations"],
    after: Float[np.ndarray, " equations"],
) -> Float[np.ndarray, " equations"]:
    """Return the part of a triangle over two intervals that is after a moment."""
    early = 1.0 - np.square(np.maximum(moment + before, 0.0)) / (before * (before + after))
    late = np.square(np.maximum(after - moment, 0.0)) / (after * (before + after))
    return np.where(moment < 0.0, early, late)


def _density(
    moment: Float[np.ndarray, " equations"],
    before: Float[np.ndarray, " equations"],
    after: Float[np.ndarray, " equations"],
) -> Float[np.ndarray, " equations"]:
    """Return the height of a triangle over two intervals at a moment."""
    side = np.where(moment < 0.0, (moment + before) / before, (after - moment) / after)
    return 2.0 * np.maximum(side, 0.0) / (before + after)


def _integrated(
    time: Float[np.ndarray, " samples"],
    torque: Float[np.ndarray, "samples joints"],
    knots: Float[np.ndarray, " knots"],
    times: int,
) -> Float[np.ndarray, "equations joints"]:
    """Return the triangle's mean of a spline: the second difference of its integral's integral.

    - `times`: how often it is integrated; once for the derivative by the lag.
    """
    integral = _spline(time, torque).antiderivative(times)(knots)
    h = np.diff(knots)[:, None]
    slopes = np.diff(integral, axis=0) / h
    return 2.0 * np.diff(slopes, axis=0) / (h[:-1] + h[1:])


def triangle_mean(
    time: Float[np.ndarray, " samples"], torque: Float[np.ndarray, "samples joints"]
) -> Float[np.ndarray, "equations joints"]:
    """Return the mean of a parabola through three samples, from the triangle's mean and mean
    square.

    >>> import numpy as np
    >>> triangle_mean(np.arange(5.0), np.arange(5.0)[:, None])[:, 0].tolist()
    [1.0, 2.0, 3.0]
    """
    h = np.diff(time)[:, None]
    before, after = h[:-1], h[1:]
    rising, falling = np.diff(torque[1:], axis=0) / after, np.diff(torque[:-1], axis=0) / before
    bend = (rising - falling) / (before + after)
    slope = rising - bend * after
    mean, mean_square = (after - before) / 3.0, (before**3 + after**3) / (before + after) / 6.0
    return torque[1:-1] + slope * mean + bend * mean_square


@dataclasses.dataclass(frozen=True)
class Readings:
    """Recordings, one after the other, as the equations of motion need them.

    **Attributes**

    - `time`: (samples,) going on after each recording [s].
    - `position`: (samples, n) as recorded.
    - `torque`: as recorded.
    - `part`: (samples,) number of the recording that a sample belongs to.
    - `joined`: (equations,) those that span two recordings, and are none.

    >>> import numpy as np
    >>> line = np.arange(5.0)[:, None]
    >>> readings = Readings.of([Recording(np.arange(5.0), line, line)] * 2, "sampled")
    >>> readings.time.tolist(), readings.part.tolist()
    ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    >>> readings.joined.tolist()
    [False, False, False, True, True, False, False, False]
    """

    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    torque: TorqueRecord
    part: Int[np.ndarray, " samples"]
    joined: Bool[np.ndarray, " equations"]

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], torque_sampling: TorqueSampling, every: int = 1
    ) -> "Readings":
        """Join recordings of the same joints; positions at every so many samples."""
        times: list[np.ndarray] = []
        start = 0.0
        for recording in recordings:
            time = np.asarray(recording.time)[::every] - recording.time[0] + start
            times.append(time)
            start = float(time[-1] + np.mean(np.diff(time)))
        part = np.repeat(np.arange(len(recordings)), [len(time) for time in times])
        time = np.concatenate(times)
        return cls(
            time,
            np.concatenate([np.asarray(recording.position)[::every] for recording in recordings]),
            TorqueRecord.of(recordings, torque_sampling, every),
            part,
            part[2:] != part[:-2],
        )

    @property
    def recordings(self) -> int:
        """Number of recordings."""
        return int(self.part[-1]) + 1

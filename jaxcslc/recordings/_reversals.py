"""Velocity reversals of joints, to a fraction of a sample, and the minimisation that finds them.

`_splines` divides recordings at reversals (thesis, Section 7.3).
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._bounded_search import bounded_minima


# Columns of a fit that are this much shorter than others, once those before are taken off, are
# left to a decomposition that finds their rank.
_DEPENDENT = 1e-10
# Turns that are fitted at once: enough to make little of NumPy's calls, few enough for the cache.
_AT_ONCE = 128


class Reversal(NamedTuple):
    """Reversal of a joint's motion.

    **Attributes**

    - `time`: the instant of zero velocity, in general between two samples [s].
    - `position`: the joint's position there [rad or m].
    - `direction`: of the motion that follows, 1 or -1.

    >>> from jaxcslc.recordings import Reversal
    >>> Reversal(time=0.25, position=1.0, direction=-1).direction
    -1
    """

    time: float
    position: float
    direction: int


def find_reversals(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    *,
    tolerance: float,
    window: int,
) -> tuple[Reversal, ...]:
    r"""Find where a joint turns round, to a fraction of a sample.

    The sections between are those that the thesis smooths separately (Section 7.3). Taken
    literally, 'monotone between sample points' would break a record at every count that
    flickers, so a turn is one that the joint has come back from by more than a tolerance.

    The instant matters: an error of $\delta$ leaves a step of $\ddot q\,\delta$ in the velocity.
    It is the one for which two cubics that leave it with zero velocity, one to either side and
    each with an acceleration of its own, fit the samples around it best. The middle of the
    highest count is cruder: where friction makes the acceleration jump, the joint is longer on
    that count on one side than on the other. (On simulated PUMA 560 recordings, fitting the
    instant cut the acceleration error near reversals to between a half and a fifth.)

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: of one joint, shape `(samples,)` [rad or m].
    - `tolerance`: how far a joint must come back for a turn to be one [rad or m]; a few counts
        of the encoder, or a few standard deviations of the noise.
    - `window`: how many samples on either side the cubics are fitted to, at the most.

    **Returns**

    The reversals in order of time, their directions alternating.

    >>> import numpy as np
    >>> from jaxcslc.recordings import find_reversals
    >>> time = np.arange(1000) * 0.002
    >>> counts = 1e-4 * np.round(np.sin(np.pi * time) / 1e-4)
    >>> turns = find_reversals(time, counts, tolerance=3e-4, window=25)
    >>> [(round(turn.time, 3), turn.direction) for turn in turns]
    [(0.5, -1), (1.5, 1)]
    """
    (reversals,) = reversals_of_joints(time, position[:, None], [tolerance], [window])
    return reversals


def reversals_of_joints(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, "samples joints"],
    tolerances: Sequence[float],
    windows: Sequence[int],
) -> list[tuple[Reversal, ...]]:
    """Find reversals of all joints as `find_reversals` does, all instants at once.

    **Arguments**

    - `tolerances`, `windows`: of each joint.
    """
    columns = np.ascontiguousarray(position.T)
    turns = [_turns(*of) for of in zip(columns, tolerances, strict=True)]
    stretches = [
        _stretches(time, *of) for of in zip(columns, turns, tolerances, windows, strict=True)
    ]
    moving = [one for of_joint in stretches for one in of_joint if isinstance(one, _Stretch)]
    parts = (moving[start : start + _AT_ONCE] for start in range(0, len(moving), _AT_ONCE))
    fitted = itertools.chain.from_iterable(map(_fitted, parts))
    return [
        _reversals(
            time,
            [next(fitted) if isinstance(one, _Stretch) else one for one in of_joint],
            [direction for _, direction in joint_turns],
        )
        for of_joint, joint_turns in zip(stretches, turns, strict=True)
    ]


def _reversals(
    time: Float[np.ndarray, " samples"],
    extremes: Sequence[tuple[float, float]],
    directions: Sequence[int],
) -> tuple[Reversal, ...]:
    """Reversals within the record, of instants and positions in the order of turns."""
    reversals: list[Reversal] = []
    for (instant, extreme), direction in zip(extremes, directions, strict=True):
        if not time[0] < instant < time[-1]:
            continue
        if not reversals or instant > reversals[-1].time:
            reversals.append(Reversal(instant, extreme, direction))
        else:
            # Both turns were fitted to the same instant: there is nothing between them.
            reversals.pop()
    return tuple(reversals)


def _turns(position: Float[np.ndarray, " samples"], tolerance: float) -> list[tuple[int, int]]:
    """Extremes that the position retreats from by more than the tolerance, with what follows."""
    turns: list[tuple[int, int]] = []
    # Only where a run up or down ends, at the first of equal values, is there anything to see.
    changes = np.flatnonzero(np.concatenate([[True], np.diff(position) != 0.0]))
    rising = np.diff(position[changes]) > 0.0
    ends = changes[np.concatenate([[True], rising[1:] != rising[:-1], [True]])[: changes.size]]
    direction = highest = lowest = 0
    levels = position[ends].tolist()
    samples = ends.tolist()
    for at, value in enumerate(levels):
        if value > levels[highest]:
            highest = at
        if value < levels[lowest]:
            lowest = at
        if direction >= 0 and levels[highest] - value > tolerance:
            if direction > 0:
                turns.append((samples[highest], -1))
            direction, lowest = -1, at
        elif direction <= 0 and value - levels[lowest] > tolerance:
            if direction < 0:
                turns.append((samples[lowest], 1))
            direction, highest = 1, at
    return turns


class _Stretch(NamedTuple):
    """Samples around a turn.

    - `origin`: the time of the first [s]; `time`: since then.
    - `level`: the position of the turn; `position`: above it.
    - `low`, `high`: the turn is between these times since `origin`.
    """

    origin: float
    time: Float[np.ndarray, " near"]
    level: float
    position: Float[np.ndarray, " near"]
    low: float
    high: float


def _stretches(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    turns: Sequence[tuple[int, int]],
    tolerance: float,
    window: int,
) -> list[_Stretch | tuple[float, float]]:
    """Return the samples to which the turns of a joint are fitted; see `_stretch`."""
    # Cubics fitted across a neighbouring reversal would be fitted to another motion.
    borders = [0, *(sample for sample, _ in turns), time.size - 1]
    return [
        _stretch(time, position, turn, slice(start, end + 1), tolerance, window)
        for start, turn, end in zip(borders[:-2], borders[1:-1], borders[2:], strict=True)
    ]


def _stretch(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    turn: int,
    between: slice,
    tolerance: float,
    window: int,
) -> _Stretch | tuple[float, float]:
    """Return the samples to which a turn is fitted.

    If the joint is at rest there, return the turn's instant and position instead.

    - `between`: the samples that belong to neither of the turns beside it.
    """
    time, position, turn = time[between], position[between], turn - between.start
    extreme = float(position[turn])
    beyond = np.flatnonzero(np.abs(position - extreme) > tolerance)
    first = int(np.max(beyond[beyond < turn], initial=-1)) + 1
    last = int(np.min(beyond[beyond > turn], initial=time.size)) - 1
    if last - first > 2 * window:
        # At rest between the two motions: any instant of it will do.
        at_rest = position[first : last + 1]
        return float(0.5 * (time[first] + time[last])), float(np.median(at_rest))
    low, high = max(first - window, 0), min(last + window + 1, time.size)
    # The search's tolerance grows with its argument: counted from here, time stamps since 1970 are
    # as good as any.
    origin, near = float(time[low]), time[low:high] - time[low]
    bounds = (time[first] - origin, time[last] - origin) if first < last else (0.0, near[-1])
    return _Stretch(origin, near, extreme, position[low:high] - extreme, *map(float, bounds))


def _fitted(stretches: Sequence[_Stretch]) -> list[tuple[float, float]]:
    """Instant and position of the turn in each stretch: all are searched for at once."""
    size = np.array([stretch.time.size for stretch in stretches])
    rows = max(int(np.max(size)), 6)  # a triangle of six columns has as many
    time, position = np.zeros((2, len(stretches), rows))
    for row, level, stretch in zip(time, position, stretches, strict=True):
        row[: stretch.time.size], level[: stretch.time.size] = stretch.time, stretch.position
    taken = (np.arange(time.shape[1]) < size[:, None]).astype(float)
    scale = np.array([stretch.time[-1] for stretch in stretches])

    def columns(
        instant: Float[np.ndarray, " turns"], turns: Int[np.ndarray, " turns"]
    ) -> Float[np.ndarray, "turns near 6"]:
        """Return the columns of two cubics of zero velocity at the instant, and the positions.

        Columns of samples that a stretch does not have are zero.
        """
        ahead = taken[turns] * (time[turns] - instant[:, None]) / scale[turns, None]
        before, after = np.minimum(ahead, 0.0), np.maximum(ahead, 0.0)
        cubics = taken[turns], before**2, before**3, after**2, after**3
        return np.stack([*cubics, position[turns]], axis=2)

    def misfit(
        instant: Float[np.ndarray, " turns"], turns: Int[np.ndarray, " turns"]
    ) -> Float[np.ndarray, " turns"]:
        return _least_squares(columns(instant, turns))[1]

    instant = bounded_minima(
        misfit,
        np.array([stretch.low for stretch in stretches]),
        np.array([stretch.high for stretch in stretches]),
        1e-3 * scale / size,
    )
    above = _least_squares(columns(instant, np.arange(instant.size)))[0]
    return [
        (stretch.origin + float(at), stretch.level + float(height))
        for stretch, at, height in zip(stretches, instant, above, strict=True)
    ]


def _least_squares(
    columns: Float[np.ndarray, "fits rows 6"],
) -> tuple[Float[np.ndarray, " fits"], Float[np.ndarray, " fits"]]:
    """The first coefficient of the last column's fit by the others, and the squared residual."""
    triangle: Any = np.linalg.qr(columns, mode="r")  # the stub promises Q as well
    matrix, target = triangle[:, :5, :5], triangle[:, :5, 5:]
    diagonal = np.abs(np.diagonal(matrix, axis1=1, axis2=2))
    regular = np.min(diagonal, axis=1) > _DEPENDENT * np.max(diagonal, axis=1)
    first, squares = np.empty(len(columns)), triangle[:, 5, 5] ** 2
    first[regular] = np.linalg.solve(matrix[regular], target[regular])[:, 0, 0]
    for fit in np.flatnonzero(~regular):  # such as of an instant beside the last sample
        design, right = columns[fit, :, :5], columns[fit, :, 5]
        coefficients = np.linalg.lstsq(design, right, rcond=None)[0]
        first[fit], squares[fit] = coefficients[0], np.sum((design @ coefficients - right) ** 2)
    return first, squares

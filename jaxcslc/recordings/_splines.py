"""Averaged splines, the thesis's smoothing (Section 7.3), and the choice of their spacing.

Splines end at velocity reversals, where friction makes accelerations jump: `find_reversals` finds
these to a fraction of a sample.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from .._bounded_search import bounded_minima
from ._recording import Samples, Signals
from ._sampling import STEP_DEVIATIONS, noise_level
from ._smoothing import AbstractSmoothing, Derivatives, register_smoothing


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


# Turns that are fitted at once: enough to make little of NumPy's calls, few enough for the cache.
_AT_ONCE = 128


def find_reversals(
    time: Samples,
    position: Signals,
    *,
    tolerance: float | Sequence[float],
    window: int | Sequence[int],
) -> list[tuple[Reversal, ...]]:
    r"""Find where joints turn round, to a fraction of a sample.

    The sections between are those that the thesis smooths separately (Section 7.3). Taken
    literally, 'monotone between sample points' would break a record at every count that
    flickers, so a turn is one that the joint has come back from by more than a tolerance.

    The instant matters: an error of $\delta$ leaves a step of $\ddot q\,\delta$ in the velocity.
    It is the one for which two cubics that leave it with zero velocity, one to either side and
    each with an acceleration of its own, fit the samples around it best. The middle of the
    highest count is cruder: where friction makes the acceleration jump, the joint is longer on
    that count on one side than on the other.

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: shape `(samples, joints)` [rad or m].
    - `tolerance`: how far a joint must come back for a turn to be one, of all joints or of each
        [rad or m]; a few counts of the encoder, or a few standard deviations of the noise.
    - `window`: how many samples on either side the cubics are fitted to at most, of all joints or
        of each.

    **Returns**

    For each joint its reversals in order of time, their directions alternating.

    >>> import numpy as np
    >>> from jaxcslc.recordings import find_reversals
    >>> time = np.arange(1000) * 0.002
    >>> counts = 1e-4 * np.round(np.sin(np.pi * time[:, None]) / 1e-4)
    >>> (turns,) = find_reversals(time, counts, tolerance=3e-4, window=25)
    >>> [(round(turn.time, 3), turn.direction) for turn in turns]
    [(0.5, -1), (1.5, 1)]
    """
    joints = position.shape[1]
    tolerances, windows = np.broadcast_to(tolerance, joints), np.broadcast_to(window, joints)
    turns = [
        turn
        for joint, column in enumerate(np.ascontiguousarray(position.T))
        for turn in _turns(joint, time, column, float(tolerances[joint]), int(windows[joint]))
    ]
    moving = [i for i, turn in enumerate(turns) if turn.near is not None]
    for start in range(0, len(moving), _AT_ONCE):
        part = moving[start : start + _AT_ONCE]
        for i, turn in zip(part, _fitted([turns[i] for i in part]), strict=True):
            turns[i] = turn
    reversals: list[list[Reversal]] = [[] for _ in range(joints)]
    for turn in turns:
        found = reversals[turn.joint]
        if not time[0] < turn.time < time[-1]:
            continue
        if not found or turn.time > found[-1].time:
            found.append(Reversal(turn.time, turn.position, turn.direction))
        else:
            # Both turns were fitted to the same instant: there is nothing between them.
            found.pop()
    return [tuple(found) for found in reversals]


class _Turn(NamedTuple):
    """Turn of a joint, as its samples show it.

    - `direction`: of the motion that follows, 1 or -1.
    - `time`, `position`: about where it is; of a joint that rests between two motions, its rest.
    - `near`: times and positions of the samples to fit it to; None for a joint that rests.
    - `within`: the first and the last time at which it can be [s].
    """

    joint: int
    direction: int
    time: float
    position: float
    near: Float[np.ndarray, "2 near"] | None = None
    within: tuple[float, float] = (0.0, 0.0)


def _turns(
    joint: int,
    time: Samples,
    position: Samples,
    tolerance: float,
    window: int,
) -> list[_Turn]:
    """Return the turns of a joint, each fitted to samples between those beside it.

    Cubics fitted across a neighbouring turn would be fitted to another motion.
    """
    extremes = _extremes(position, tolerance)
    borders = [0, *(sample for sample, _ in extremes), time.size - 1]
    turns: list[_Turn] = []
    for start, (sample, direction), end in zip(borders[:-2], extremes, borders[2:], strict=True):
        t, q, turn = time[start : end + 1], position[start : end + 1], sample - start
        beyond = np.flatnonzero(np.abs(q - q[turn]) > tolerance)
        first = int(np.max(beyond[beyond < turn], initial=-1)) + 1
        last = int(np.min(beyond[beyond > turn], initial=t.size)) - 1
        if last - first > 2 * window:
            # At rest between the two motions: any instant of it will do.
            middle, rest = 0.5 * (t[first] + t[last]), np.median(q[first : last + 1])
            turns.append(_Turn(joint, direction, float(middle), float(rest)))
            continue
        low, high = max(first - window, 0), min(last + window + 1, t.size)
        within = (t[first], t[last]) if first < last else (t[low], t[high - 1])
        near = np.stack([t[low:high], q[low:high]])
        turns.append(_Turn(joint, direction, float(t[turn]), float(q[turn]), near, within))
    return turns


def _extremes(position: Samples, tolerance: float) -> list[tuple[int, int]]:
    """Return samples from which the position retreats by more than the tolerance, and directions
    of the motion that follows."""
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


# Columns of a fit that are this much shorter than others, once those before are taken off, are
# left to a decomposition that finds their rank.
_DEPENDENT = 1e-10
_COLUMNS = 6  # coefficients of two cubics that meet at rest, and the positions


def _fitted(turns: Sequence[_Turn]) -> list[_Turn]:
    """Return turns at the instants that fit their samples best: all are searched for at once."""
    near = [turn.near for turn in turns if turn.near is not None]
    size = np.array([samples.shape[1] for samples in near])
    rows = max(int(np.max(size)), _COLUMNS)  # as many as the triangle has
    # Counted from the first sample, time stamps since 1970 are as good as any: the search's
    # tolerance grows with its argument.
    origin = np.array([samples[0, 0] for samples in near])
    time, position = np.zeros((2, len(turns), rows))
    for row, turn in enumerate(turns):
        time[row, : size[row]] = near[row][0] - origin[row]
        position[row, : size[row]] = near[row][1] - turn.position
    taken = (np.arange(rows) < size[:, None]).astype(float)
    scale = time[np.arange(len(turns)), size - 1]

    def columns(
        instant: Float[np.ndarray, " turns"], turns: Int[np.ndarray, " turns"]
    ) -> Float[np.ndarray, "turns near 6"]:
        """Return the columns of two cubics of zero velocity at the instant, and the positions.

        Rows of samples that a turn does not have are zero.
        """
        ahead = taken[turns] * (time[turns] - instant[:, None]) / scale[turns, None]
        before, after = np.minimum(ahead, 0.0), np.maximum(ahead, 0.0)
        cubics = taken[turns], before**2, before**3, after**2, after**3
        return np.stack([*cubics, position[turns]], axis=2)

    low, high = np.array([turn.within for turn in turns]).T - origin
    instant = bounded_minima(
        lambda at, turns: _least_squares(columns(at, turns))[1], low, high, 1e-3 * scale / size
    )
    above = _least_squares(columns(instant, np.arange(instant.size)))[0]
    return [
        turn._replace(time=float(start + at), position=turn.position + float(height))
        for turn, start, at, height in zip(turns, origin, instant, above, strict=True)
    ]


def _least_squares(
    columns: Float[np.ndarray, "fits rows 6"],
) -> tuple[Float[np.ndarray, " fits"], Float[np.ndarray, " fits"]]:
    """Fit the last column by the others; return the first coefficient and the squared residual."""
    triangle: Any = np.linalg.qr(columns, mode="r")  # the stub promises Q as well
    matrix, target = triangle[:, :-1, :-1], triangle[:, :-1, -1:]
    diagonal = np.abs(np.diagonal(matrix, axis1=1, axis2=2))
    regular = np.min(diagonal, axis=1) > _DEPENDENT * np.max(diagonal, axis=1)
    first, squares = np.empty(len(columns)), triangle[:, -1, -1] ** 2
    first[regular] = np.linalg.solve(matrix[regular], target[regular])[:, 0, 0]
    for fit in np.flatnonzero(~regular):  # such as of an instant beside the last sample
        design, right = columns[fit, :, :-1], columns[fit, :, -1]
        coefficients = np.linalg.lstsq(design, right, rcond=None)[0]
        first[fit], squares[fit] = coefficients[0], np.sum((design @ coefficients - right) ** 2)
    return first, squares


@register_smoothing("averaged_splines")
class AveragedSplines(AbstractSmoothing):
    r"""Spline smoothing as in Section 7.3 of the thesis.

    Through every j-th sample runs an interpolating cubic spline; there are j of them, one for
    each sample to start from, and their average passes near all samples without having to pass
    through any. Velocities and accelerations are its derivatives.

    The average is a low-pass filter: motion of more than half a cycle in j samples does not
    show in a single spline, so the pass band ends near 1 / (2 j interval), and independent
    errors of the samples are averaged about j at a time.

    Friction makes a joint's acceleration jump where its velocity changes sign. With `sections`,
    the record of each joint is divided there and the sections are smoothed separately, so that
    jumps stay where they are and the velocities of a section share one sign. Every spline of a
    section ends at the reversal, with zero velocity.

    Times need not be uniform.

    **Attributes**

    - `spacing`: j, of all joints or of each [samples].
    - `sections`: divide the record at velocity reversals.
    - `tolerance`: how far a joint must come back for a reversal to be one, of all joints or of
        each [rad or m]. By default, estimated from the recording: three counts or six standard
        deviations of its noise, whichever is more.

    >>> import numpy as np
    >>> from jaxcslc.recordings import AveragedSplines
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> q, qd, qdd = AveragedSplines(spacing=17).smooth(time, position)
    >>> error = qdd[:, 0] + (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    >>> bool(np.max(np.abs(error)) < 0.2)
    True
    """

    spacing: int | tuple[int, ...] = 9
    sections: bool = True
    tolerance: float | tuple[float, ...] | None = None

    def __check_init__(self):
        spacings = (self.spacing,) if isinstance(self.spacing, int) else self.spacing
        if any(spacing < 1 for spacing in spacings):
            raise ValueError(f"spacing is {self.spacing}; expected 1 sample or more")

    def spacings(self, joints: int) -> tuple[int, ...]:
        """Return the spacing of each of so many joints.

        **Raises** `ValueError` for spacings of another number of joints.
        """
        spacings = (self.spacing,) * joints if isinstance(self.spacing, int) else self.spacing
        if len(spacings) != joints:
            raise ValueError(f"{len(spacings)} spacings for {joints} joints; expected one for each")
        return spacings

    def smooth(self, time: Samples, position: Signals) -> Derivatives:
        spacings = self.spacings(position.shape[1])
        windows = [3 * spacing // 2 for spacing in spacings]
        reversals: list[tuple[Reversal, ...]] = [()] * len(windows)
        if self.sections:
            at_least = [max(window, _COLUMNS) for window in windows]
            tolerance = self._tolerances(position)
            reversals = find_reversals(time, position, tolerance=tolerance, window=at_least)
        columns = np.ascontiguousarray(position.T)
        smoothed = [
            _smooth_joint(time, *of_joint)
            for of_joint in zip(columns, spacings, windows, reversals, strict=True)
        ]
        q, qd, qdd = np.stack(smoothed, axis=-1)
        return q, qd, qdd

    def low_pass(self, time: Samples, signal: Signals) -> Signals:
        # In one piece: only a position turns round where its velocity changes sign.
        return eqx.tree_at(lambda s: s.sections, self, False).smooth(time, signal)[0]

    def reach(self, interval: float, joints: int) -> int:
        del interval
        return max(self.spacings(joints))

    def settled(self, position: Signals) -> "AveragedSplines":
        return dataclasses.replace(self, tolerance=tuple(map(float, self._tolerances(position))))

    @property
    def description(self) -> str:
        return f"averaged splines of {self.spacing} samples"

    def _tolerances(self, position: Signals) -> list[float]:
        joints = position.shape[1]
        if self.tolerance is None:
            # Quantisation alone makes noise of 0.29 counts, of which ten are three counts.
            return list(6.0 * np.sqrt(3.0) * noise_level(position))
        return list(np.broadcast_to(np.asarray(self.tolerance, dtype=float), (joints,)))


def _smooth_joint(
    time: Samples, position: Samples, spacing: int, window: int, reversals: Sequence[Reversal]
) -> Float[np.ndarray, "3 samples"]:
    """Return position and derivatives of a joint that turns round at these instants.

    Sections end in nodes of known position and velocity. The splines of all sections through every
    `spacing`-th sample, one behind the other, are one piecewise cubic, whose second derivative
    jumps at these ends.
    """
    ends = [
        _open_end(time, position, window, first=True),
        *((turn.time, turn.position, 0.0) for turn in reversals),
        _open_end(time, position, window, first=False),
    ]
    instants, positions, velocities = np.array(ends).T
    samples = np.arange(time.size)
    borders = np.interp(instants, time, samples)
    section = np.clip(np.searchsorted(borders, samples, "right") - 1, 0, len(ends) - 2)
    # A knot close to an end would put the error of their difference, divided by a short interval,
    # into the velocity there.
    apart = np.minimum(samples - borders[section], borders[section + 1] - samples)
    average = np.zeros((3, time.size))
    for first in range(spacing):
        knots = samples[first::spacing]
        knots = knots[apart[knots] >= 0.5 * spacing]
        ending = np.zeros(knots.size + len(ends), bool)
        ending[np.searchsorted(knots, borders) + np.arange(len(ends))] = True
        # Nodes, one a column: time, position, slope, and the first sample from there on.
        nodes = np.zeros((4, ending.size))
        nodes[:, ending] = instants, positions, velocities, np.ceil(borders)
        nodes[:, ~ending] = time[knots], position[knots], np.zeros(knots.size), knots
        x, y, slopes, starts = nodes
        starts[-1] = time.size
        pieces = np.vstack([_cubics(x, y, slopes, ending), x[:-1]])
        *cubics, origin = np.repeat(pieces, np.diff(starts).astype(int), axis=1)
        _add_cubics(average, cubics, time - origin)
    average /= spacing
    if reversals:
        # Rounding noise of a joint that barely moves must not turn it round within a section.
        directions = np.array([-reversals[0].direction, *(turn.direction for turn in reversals)])
        average[1, directions[section] * average[1] < 0.0] = 0.0
    return average


def _cubics(
    x: Float[np.ndarray, " nodes"],
    y: Float[np.ndarray, " nodes"],
    slopes: Float[np.ndarray, " nodes"],
    given: Bool[np.ndarray, " nodes"],
) -> Float[np.ndarray, "4 pieces"]:
    """Return coefficients of cubics between nodes, the highest power first.

    Where no slope is given, the second derivative is continuous:
    `h1 m0 + 2 (h0 + h1) m1 + h0 m2 = 3 (h1 (y1 - y0)/h0 + h0 (y2 - y1)/h1)`.
    At an end without a slope the first two pieces are one cubic ('not a knot'):
    `h1 m0 + (h0 + h1) m1 = ((3 h0 + 2 h1) h1 (y1 - y0)/h0 + h0² (y2 - y1)/h1) / (h0 + h1)`.
    """
    steps = np.diff(x)
    rises, before, after = np.diff(y) / steps, steps[:-1], steps[1:]
    free = ~given[1:-1]
    below, above = np.append(after * free, 0.0), np.append(0.0, before * free)
    diagonal, right = np.ones(y.size), slopes.copy()
    diagonal[1:-1][free] = 2.0 * (before + after)[free]
    right[1:-1][free] = 3.0 * (after * rises[:-1] + before * rises[1:])[free]
    for end, inner, row in ((0, 1, above), (-1, -2, below)):
        if not given[end]:
            h, other = steps[end], steps[inner]
            diagonal[end], row[end] = other, h + other
            rise = (3.0 * h + 2.0 * other) * other * rises[end] + h**2 * rises[inner]
            right[end] = rise / (h + other)
    *_, m, _ = scipy.linalg.lapack.dgtsv(below, diagonal, above, right)
    bend = (m[:-1] + m[1:] - 2.0 * rises) / steps
    return np.stack([bend / steps, (rises - m[:-1]) / steps - bend, m[:-1], y[:-1]])


def spline_derivatives(time: Samples, values: Signals) -> tuple[Signals, Signals]:
    """Return first and second derivatives of the cubic splines through all samples, at these.

    Those of `scipy.interpolate.CubicSpline`, whose import takes 0.09 s of processor time.

    - `time`: instants of the samples, four or more, shape `(samples,)` [s].
    - `values`: shape `(samples, joints)`.

    >>> import numpy as np
    >>> time = np.linspace(0.0, 1.0, 6)
    >>> first, second = spline_derivatives(time, time[:, None] ** 3)
    >>> bool(np.allclose(first[:, 0], 3 * time**2)), bool(np.allclose(second[:, 0], 6 * time))
    (True, True)
    """
    nowhere, step = np.zeros(time.size, bool), time[-1] - time[-2]
    first, second = np.empty(values.shape), np.empty(values.shape)
    for joint, column in enumerate(values.T):
        a, b, c, _ = _cubics(time, column, np.zeros(time.size), nowhere)
        first[:, joint] = *c, (3.0 * a[-1] * step + 2.0 * b[-1]) * step + c[-1]
        second[:, joint] = *(2.0 * b), 6.0 * a[-1] * step + 2.0 * b[-1]
    return first, second


def _add_cubics(
    total: Float[np.ndarray, "3 samples"], cubics: Sequence[Samples], x: Samples
) -> None:
    """Add values and two derivatives of cubics to their sums."""
    a, b, c, d = cubics
    highest = a * x
    total[0] += ((highest + b) * x + c) * x + d
    highest *= 3.0
    highest += b
    total[2] += highest + highest
    total[1] += (highest + b) * x + c


def _open_end(
    time: Samples, position: Samples, window: int, *, first: bool
) -> tuple[float, float, float]:
    """Return time, position and velocity at an end of the record, of a cubic fitted next to it."""
    count = min(max(window, 4), time.size)
    near = slice(0, count) if first else slice(time.size - count, time.size)
    end = time[0 if first else -1]
    scale = time[near][-1] - time[near][0]
    design = np.vander((time[near] - end) / scale, min(4, count), increasing=True)
    coefficients, *_ = np.linalg.lstsq(design, position[near], rcond=None)
    return float(end), float(coefficients[0]), float(coefficients[1] / scale)


def left_out_error(
    time: Samples,
    position: Signals,
    smoothing: AveragedSplines,
) -> Float[np.ndarray, " joints"]:
    r"""Compute how well averaged splines predict each sample from all the others, joint by joint.

    Of the j splines, one runs through a sample and j - 1 do not. Their mean is the
    average with that sample left out, and it misses the sample by $j / (j - 1)$ times the
    residual: leave-one-out cross-validation for the price of one smoothing. It is exact except
    near the ends of a section, which know all samples around them.

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: joint positions, shape `(samples, joints)` [rad or m].
    - `smoothing`: with a spacing of 2 or more.

    **Returns** the root mean square of the errors, shape `(joints,)` [rad or m].

    **Raises** `ValueError`: a spacing of 1, of which no spline would be left.

    >>> import numpy as np
    >>> from jaxcslc.recordings import AveragedSplines, left_out_error
    >>> time = np.arange(1000) * 0.002
    >>> position = 1e-4 * np.round(np.sin(2 * np.pi * time) / 1e-4)[:, None]
    >>> error = left_out_error(time, position, AveragedSplines(17))
    >>> bool(0.9 < error[0] / (1e-4 / 12**0.5) < 1.1)
    True
    """
    spacings = np.array(smoothing.spacings(position.shape[1]), dtype=np.float64)
    if np.any(spacings < 2):
        raise ValueError(f"spacing is {smoothing.spacing}; expected 2 samples or more to hold out")
    q, _, _ = smoothing.smooth(time, position)
    residual = np.sqrt(np.mean((position - q) ** 2, axis=0))
    return residual * spacings / (spacings - 1.0)


_SPACINGS = (5, 7, 9, 11, 13, 15, 17, 21, 25, 29, 35, 41)  # samples, a fifth apart
_SLACK = 0.01  # of the noise's variance, twice


def choose_spacing(
    time: Samples,
    position: Signals,
    *,
    candidates: Sequence[int] = _SPACINGS,
    slack: float = _SLACK,
    sections: bool = True,
    resolution: float | Float[np.ndarray, " joints"] = 0.0,
) -> tuple[int, ...]:
    r"""Choose the spacing of averaged splines for each joint, from positions and resolution alone.

    This cross-validation error falls slowly with the spacing while noise is averaged, and rises
    steeply once the motion itself is smoothed away. Accelerations suffer more from noise than
    positions do, so what is best for them is the widest spacing that takes next to nothing from
    the motion.

    *Next to nothing* is measured by the encoder's resolution. With $e_j$ this error of
    spacing j and σ the deviation of the noise, at least a count's $1/\sqrt{12}$, the choice is the
    widest candidate with

    $e_j^2 \le \min_i e_i^2 + 2\,\text{slack}\,\sigma^2$,

    so what it takes from the motion beyond the best candidate is less than a seventh of σ for
    the default slack. `scripts/studies/smoothing/study.py` compares the choice with the best.

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: joint positions, shape `(samples, joints)` [rad or m].
    - `candidates`: spacings to choose from, each of 2 or more [samples].
    - `slack`: how much more of this error than the least the choice may have, as part of the
        noise.
    - `sections`: as of `AveragedSplines`.
    - `resolution`: of the encoders, where known, of all joints or of each [rad or m]: the noise
        is at least theirs. By default it is what `noise_level` sees in the readings, their
        counts included.

    **Returns** one spacing for each joint.

    **Raises** `ValueError`: no candidates, one below 2, or a negative resolution.

    >>> import numpy as np
    >>> from jaxcslc.recordings import choose_spacing
    >>> time = np.arange(1000) * 0.002
    >>> motion = np.stack([np.sin(2 * np.pi * time), np.sin(6 * np.pi * time)], axis=1)
    >>> slow, fast = choose_spacing(time, 1e-4 * np.round(motion / 1e-4))
    >>> slow > fast
    True
    """
    if not candidates:
        raise ValueError("no candidate spacings; expected one or more")
    if not np.all(np.asarray(resolution) >= 0.0):
        raise ValueError(f"encoder resolution is {resolution}; expected 0 or more")
    errors = np.stack(
        [
            left_out_error(time, position, AveragedSplines(spacing, sections))
            for spacing in candidates
        ]
    )
    noise = np.maximum(noise_level(position), np.asarray(resolution) / STEP_DEVIATIONS)
    good = errors**2 <= np.min(errors, axis=0) ** 2 + 2.0 * slack * noise**2
    return tuple(int(np.max(np.asarray(candidates)[column])) for column in good.T)

"""Findings about the clock and single samples of a recording, and outliers."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..recordings import Recording, encoder_resolution, stale_rows
from ._findings import Finding, finding


# A controller samples between these intervals [s]; what lies outside is in another unit. The ratio
# of both is ten thousand: a thousand for the unit, and what controllers of arms differ by.
_SHORTEST, _LONGEST = 2e-5, 0.2
_UNITS = {
    1e-3: ("milliseconds", "ms"),
    1e-6: ("microseconds", "us"),
    1e-9: ("nanoseconds", "ns"),
}
# A gap is longer than so many intervals (two periods of the highest cut-off), a lost row than so
# many: one and a half would be the bound between one period and two without jitter.
_GAP, _LOST = 10.0, 1.6
# Part of intervals from which lost rows are named: one in some seconds. (Heuristic.)
_MOST_LOST = 1e-3
# Standard deviation of intervals, as part of their median, from which smoothing suffers.
# (Heuristic.)
_JITTER = 0.05
OTHER_RATE = 1.2
"""Recordings, or halves of one, at rates that differ by more are not smoothed alike. (Heuristic: a
cut-off chosen for one is another part of the other's rate.)"""


def time_unit(recording: Recording) -> tuple[float, Finding | None]:
    """Return the seconds in the unit of a recording's time, and what is wrong if it is not 1.

    They follow from its sampling interval.

    >>> import numpy as np
    >>> from jaxcslc import Recording
    >>> time = 2.0 * np.arange(100)  # milliseconds
    >>> still = np.zeros((100, 1))
    >>> time_unit(Recording(time, still, still))[0]
    0.001
    """
    interval = float(np.median(np.diff(recording.time)))
    factor = next((f for f in _UNITS if _SHORTEST < f * interval < _LONGEST), 1.0)
    if interval < _LONGEST or factor == 1.0:
        return 1.0, None
    duration = float(recording.time[-1] - recording.time[0])
    speed = np.abs(np.gradient(recording.position, recording.time, axis=0))
    fastest = float(np.max(np.quantile(speed, 0.99, axis=0)))
    unit, symbol = _UNITS[factor]
    return factor, finding(
        "time unit",
        f"as seconds, samples are {interval:.4g} s apart, the recording lasts {duration:.3g} s and"
        f" no joint is faster than {fastest:.2g} rad/s or m/s",
        unit=unit,
        symbol=symbol,
        counter=" or counts rows" if interval == 1.0 else "",
    )


def clock_findings(recording: Recording) -> Iterator[Finding]:
    """Find faults in the times of a recording [s]: gaps, lost rows, jitter, two rates."""
    time = recording.time - recording.time[0]
    intervals = np.diff(time)
    interval = float(np.median(intervals))
    moments = np.round(time, 3)  # as they are printed: to the millisecond
    early, late = (float(np.median(half)) for half in np.array_split(intervals, 2))
    if not 1 / OTHER_RATE < late / early < OTHER_RATE:
        rates = f"{1 / early:.4g} samples a second in its first half, {1 / late:.4g} in its second"
        yield finding("rate: changes", rates)
        return
    gaps = np.flatnonzero(intervals > _GAP * interval)
    starts, ends = moments[[0, *(gaps + 1)]], moments[[*gaps, -1]]
    longest = int(np.argmax(ends - starts))
    for gap in gaps[np.argsort(-intervals[gaps])][:3]:
        yield finding(
            "gap: long",
            f"no samples from {moments[gap]:.12g} s to {moments[gap + 1]:.12g} s, where they are"
            f" {1e3 * interval:.4g} ms apart otherwise; filters need even times and are not used,"
            " and smoothing runs across the gap",
            start=starts[longest],
            end=ends[longest],
        )
    regular = intervals[intervals < _LOST * interval]
    spread = float(np.std(regular) / interval)
    lost = (intervals > _LOST * interval) & (intervals <= _GAP * interval)
    period = float(f"{np.mean(regular):.3g}")  # to the three digits that clocks are set by
    if spread > _JITTER:
        yield finding(
            "jitter",
            f"intervals between samples vary by {100 * spread:.2g} % (standard deviation) about"
            f" {1e3 * interval:.4g} ms; filters need even times and are not used",
            period=period,
        )
    elif np.mean(lost) > _MOST_LOST:
        yield finding(
            "gap: rows",
            f"{int(np.sum(lost))} of {lost.size} intervals are of two or more periods of"
            f" {1e3 * interval:.4g} ms; filters need even times and are not used",
            period=period,
        )


# Part of rows, or of a joint's samples, from which on something is said. (Heuristic: fewer change
# less than a standard error.)
_STALE, _CLIPPED, _OUTLYING = 2e-3, 5e-3, 5e-5
REPEATED = 0.3
"""Part of the rows that repeat positions, or torques, of a slower source; it is 0.5 at half
the rate. (Heuristic: less is loss of single rows.)"""
# However few, outliers that hold this part of a joint's variance are named. (Heuristic.)
_WEIGHTY = 0.05
_MOTIONLESS = 3.0  # counts: noise about the edge of one makes two
_FIXED = 0.01  # rad or m that a joint may move by that is taken as fixed: half of `_ZERO`'s
_MOVING_ROWS, _LEVELS = 100, 50  # fewest rows in motion, and levels of a torque, that say something


def sample_findings(
    recording: Recording, names: Sequence[str], *, fixable: bool = False
) -> Iterator[Finding]:
    """Find faults in single samples.

    Faults are stale and repeated rows, clipping, and joints at rest. Others are joints that move
    though taken as fixed, and joints that do not follow others as the file says.

    - `names`: of the joints.
    - `fixable`: whether joints of the robot's file can be left out.
    """
    yield from _repetition(recording)
    for name, extent in recording.fixed_motion:
        if extent > _FIXED:
            moved = f"it moves by {extent:.3g} rad or m, and is taken as fixed at zero"
            yield finding("fixed joint", moved, name)
    for name, error in recording.following_error:
        if error > _FIXED:
            off = (
                f"it is up to {error:.3g} rad or m off the law by which the robot's file has it"
                " follow another"
            )
            yield finding("mimic joint", off, name)
    still = motionless(recording)
    constant = np.ptp(recording.torque, axis=0) == 0.0
    if still.any():  # one finding for all: their remedy is one option
        joints = np.array(names)[still]
        extent = float(np.max(np.ptp(recording.position[:, still], axis=0)))
        same = "; no torque of theirs changes" if constant[still].all() else ""
        yield finding(
            "motionless joint: fixable" if fixable else "motionless joint",
            f"positions stay within {extent:.2g} rad or m{same}",
            ", ".join(joints),
            listed=",".join(joints),
        )
    for joint in np.flatnonzero(constant & ~still).tolist():
        torque = f"every torque is {recording.torque[0, joint]:.4g}"
        yield finding("constant torque", torque, names[joint], joint=names[joint])
    clipped = clipping(recording.torque)
    for joint in np.flatnonzero(clipped.mean(axis=0) > _CLIPPED).tolist():
        cut = clipped[:, joint]
        limits = (f"{value:.4g}" for value in np.unique(recording.torque[cut, joint]))
        yield finding(
            "clipping",
            f"{100 * np.mean(cut):.2g} % of its torques are exactly {' and '.join(limits)}, and"
            " none is beyond",
            names[joint],
        )


@dataclasses.dataclass(frozen=True)
class Outliers:
    """Single samples that lie far from their neighbours, by quantity.

    - `marked`: True for an outlier, shape `(samples, joints)`.
    - `medians`: of the samples around each, shape `(samples, joints)`.
    """

    marked: Mapping[str, Bool[np.ndarray, "samples joints"]]
    medians: Mapping[str, Float[np.ndarray, "samples joints"]]

    @classmethod
    def of(cls, recording: Recording) -> "Outliers":
        """Mark the outliers of a recording's positions and torques.

        Beside a gap nothing is one: motion goes on there unseen, and its neighbours do not tell.
        """
        intervals = np.diff(recording.time)
        gaps = np.flatnonzero(intervals > _GAP * np.median(intervals))
        beside = np.zeros(recording.samples, bool)
        for reach in range(_WINDOW // 2):
            beside[np.maximum(gaps - reach, 0)] = True
            beside[np.minimum(gaps + 1 + reach, recording.samples - 1)] = True
        marked, medians = {}, {}
        for quantity, least in LEAST_DISTANCE.items():
            values = getattr(recording, quantity)
            medians[quantity] = _local_median(values)
            marked[quantity] = mark_outliers(values, least, medians[quantity]) & ~beside[:, None]
        return cls(marked, medians)

    def findings(self, recording: Recording, names: Sequence[str]) -> Iterator[Finding]:
        """Return a finding for each quantity with outliers, of all joints together."""
        for quantity, hit in self.marked.items():
            values = getattr(recording, quantity)
            distance = np.abs(values - self.medians[quantity])
            outlying = np.where(hit, distance**2, 0.0).sum(axis=0)
            weighty = outlying > _WEIGHTY * np.var(values, axis=0) * len(values)
            if hit.mean() <= _OUTLYING and not weighty.any():
                continue
            yield finding(
                f"outliers: {quantity}",
                f"{int(hit.sum())} {quantity} values ({100 * hit.mean():.2g} %) lie up to"
                f" {float(np.max(distance[hit])):.3g} from the values beside them",
                ", ".join(np.array(names)[hit.any(axis=0)]),
            )

    def mended(self, recording: Recording) -> Recording:
        """Return the recording with medians instead of outliers."""
        changed = {
            quantity: np.where(hit, self.medians[quantity], getattr(recording, quantity))
            for quantity, hit in self.marked.items()
        }
        return dataclasses.replace(recording, **changed)


# An outlier is so many standard deviations from the median of so many samples around it: of normal
# noise, none in any recording; noise of other kinds has longer tails.
_FAR, _WINDOW = 12.0, 7
_DEVIATION = 1.4826  # standard deviation of a normal variable, in median absolute values
# Its distance from the mean of its two neighbours is at least this part of that: one in a pair of
# outliers has half.
_ALONE = 0.45
LEAST_DISTANCE = {"position": 0.02, "torque": 0.6}
"""Outliers are further away than this part of the range. Dry friction makes torques jump by half of
theirs, back and forth within a few samples where a joint hesitates. (Heuristic for positions.)"""
# The range is between these quantiles, so that outliers are not in it.
_RANGE = (0.02, 0.98)
# Distances from medians that are taken for steps: half of this quantile.
_STEPS = 0.95


def mark_outliers(
    values: Float[np.ndarray, "samples joints"],
    least: float,
    medians: Float[np.ndarray, "samples joints"] | None = None,
) -> Bool[np.ndarray, "samples joints"]:
    """Mark single samples that lie far from their neighbours.

    A sample is compared with the median of the seven around it, which steps and slopes leave
    where they are, in units of what such differences usually are (1.48 times their median).

    - `least`: distance of an outlier as part of the range of the values, see `LEAST_DISTANCE`.
    - `medians`: of the samples around each, where they are known already.

    >>> import numpy as np
    >>> wave = np.sin(np.arange(200) / 20)[:, None]
    >>> wave[50] += 3.0
    >>> np.flatnonzero(mark_outliers(wave, least=0.5)).tolist()
    [50]
    """
    distance = np.abs(values - (_local_median(values) if medians is None else medians))
    # The peak of a fast motion lies far from the median around it, too, but near its neighbours.
    # At the ends, where only one side tells, nothing counts as an outlier.
    beside = np.pad(values, ((1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    alone = np.abs(values - 0.5 * (beside[:-2] + beside[2:])) > _ALONE * distance
    usual = _DEVIATION * np.median(distance, axis=0)
    # Values of a coarse grid differ from their neighbours' median by nothing, or by steps.
    extent = np.ptp(np.quantile(values, _RANGE, axis=0), axis=0)
    steps = np.maximum(usual, np.quantile(distance, _STEPS, axis=0) / 2.0)
    counts = np.maximum(np.maximum(steps, encoder_resolution(values) / 3.0), 1e-12)
    return alone & (distance > np.maximum(_FAR * counts, least * extent))


def without_outliers(recording: Recording) -> Recording:
    """Replace single samples that lie far from their neighbours by the median around them.

    A position or a torque is an outlier if it is twelve times as far from the median of the seven
    samples around it as such values usually are. Recorded velocities and accelerations stay.

    **Arguments**

    - `recording`: as recorded.

    **Returns** the recording without outliers of position and torque.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.checks import without_outliers
    >>> wave = np.sin(np.arange(200) / 20)[:, None]
    >>> spoilt = wave.copy()
    >>> spoilt[50] += 3.0
    >>> mended = without_outliers(jc.Recording(np.arange(200) * 0.01, wave, spoilt))
    >>> bool(np.max(np.abs(mended.torque - wave)) < 0.05)
    True
    """
    return Outliers.of(recording).mended(recording)


# A limit holds four times as many torques as the levels next to it together, and more than four, of
# more levels than a coarse sensor has at rest.
_HELD, _LEVELS_OF_CLIPPED = 4, 8


def clipping(torque: Float[np.ndarray, "samples joints"]) -> Bool[np.ndarray, "samples joints"]:
    """Mark the torques that a limit holds: many equal ones at the end of a joint's range.

    A smooth peak of rounded values stays on its highest level, too, but only 2.4 times as long as
    on the level below.

    >>> import numpy as np
    >>> wave = np.sin(np.arange(1000) / 20)[:, None]
    >>> int(clipping(wave).sum()), int(clipping(np.clip(wave, -0.9, 2.0)).sum())
    (0, 144)
    """
    clipped = np.zeros(torque.shape, bool)
    for joint, column in enumerate(torque.T):
        levels, counts = np.unique(column, return_counts=True)
        for end, below in ((0, slice(1, 4)), (-1, slice(-4, -1))):
            if levels.size > _LEVELS_OF_CLIPPED and counts[end] > _HELD * max(
                1, int(np.sum(counts[below]))
            ):
                clipped[:, joint] |= column == levels[end]
    return clipped


def motionless(recording: Recording) -> Bool[np.ndarray, " joints"]:
    """Mark each joint that does not leave three counts of its encoder."""
    extent = np.ptp(recording.position, axis=0)
    return extent <= np.maximum(_MOTIONLESS * encoder_resolution(recording.position), 1e-9)


def _repetition(recording: Recording) -> Iterator[Finding]:
    """Find rows, or quantities, that repeat while joints move."""
    moving = _moving(recording)
    if moving.sum() < _MOVING_ROWS:
        return
    stale = stale_rows(recording)
    part = float(np.mean(stale[moving]))
    if part > _STALE:
        text = f"{100 * part:.2g} % of the rows during motion repeat all values of the row before"
        yield finding("stale rows", text)
        moving &= ~stale
    repeats = {quantity: repeats_row_before(getattr(recording, quantity)) for quantity in _BOTH}
    for quantity, other in (_BOTH, _BOTH[::-1]):
        part = float(np.mean((repeats[quantity] & ~repeats[other])[moving]))
        # Repetitions of a torque of few levels are rounding.
        levels = [np.unique(column).size for column in recording.torque.T]
        if part > REPEATED and (quantity == "position" or np.median(levels) >= _LEVELS):
            every = round(1.0 / (1.0 - part))
            yield finding(
                "rate: repeats",
                f"{quantity} values change in every {every}. row only, where the others change in"
                " every row",
                quantity=quantity,
                every=every,
            )


_BOTH = ("position", "torque")


def repeats_row_before(values: Float[np.ndarray, "samples joints"]) -> Bool[np.ndarray, " samples"]:
    """Mark rows whose values all repeat those of the row before."""
    return np.append(False, np.all(values[1:] == values[:-1], axis=1))


# Rows over which motion is looked at, encoder steps per row, and part of the greatest speed. The
# values are of joints whose every reading is a new one. (Heuristic.)
_AHEAD, _SEVERAL_STEPS, _SLOW = 8, 2.0, 0.1


def _moving(recording: Recording) -> Bool[np.ndarray, " samples"]:
    """Mark rows around which some joint moves by several counts from row to row."""
    position, reach = recording.position, _AHEAD
    ahead = np.zeros(position.shape)
    ahead[reach:-reach] = np.abs(position[2 * reach :] - position[: -2 * reach]) / (2 * reach)
    fastest = np.quantile(ahead, _RANGE[1], axis=0)
    steps = _SEVERAL_STEPS * np.maximum(encoder_resolution(position), 1e-12)
    return np.any((ahead > _SLOW * fastest) & (ahead > steps), axis=1)


def _local_median(values: Float[np.ndarray, "samples joints"]) -> np.ndarray:
    """Compute the median over windows of samples, the signals mirrored at their ends."""
    columns = (scipy.ndimage.median_filter(x, _WINDOW, mode="mirror") for x in values.T)
    return np.stack(list(columns), axis=1)

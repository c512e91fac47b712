"""Findings about the clock and single samples of a recording, and outliers."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..recordings import Recording, encoder_resolution, stale_rows


@dataclasses.dataclass(frozen=True)
class Finding:
    """Fault that a recording seems to have.

    **Attributes**

    - `kind`: what it is about, such as `"time unit"`, `"sign"` or `"torque lag"`.
    - `joint`: name of the joint, or of several; empty where it is about all of them.
    - `evidence`: a sentence with numbers.
    - `cause`: the likeliest one.
    - `remedy`: what to do about it, with the option of the command if there is one.
    - `recording`: name of the recording; empty where there is one.

    >>> from jaxcslc.checks import Finding
    >>> print(Finding("gap", "", "no sample for 3 s from 8.2 s on", "lost rows", "record again"))
    gap: no sample for 3 s from 8.2 s on. Likely cause: lost rows. Remedy: record again
    """

    kind: str
    joint: str
    evidence: str
    cause: str
    remedy: str
    recording: str = ""

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.recording, self.kind, self.joint) if part)
        return f"{where}: {self.evidence}. Likely cause: {self.cause}. Remedy: {self.remedy}"


# A controller samples between these intervals; what lies outside is in another unit [s].
_SHORTEST, _LONGEST = 2e-5, 0.2
_UNITS = {
    1e-3: ("milliseconds", "ms"),
    1e-6: ("microseconds", "us"),
    1e-9: ("nanoseconds", "ns"),
}
# A gap is longer than so many intervals, a lost row than so many.
GAP, _LOST = 10.0, 1.6
_MOST_LOST = 1e-3
# Standard deviation of intervals, as part of their median, from which smoothing suffers.
_JITTER = 0.05
_OTHER_RATE = 1.2


def time_unit(recording: Recording) -> tuple[float, Finding | None]:
    """Seconds in the unit of a recording's time, by its sampling interval; 1 if it is plausible.

    **Arguments**

    - `recording`: with positions of revolute or prismatic joints.

    **Returns** the factor, and what is wrong if it is not 1.

    >>> import numpy as np
    >>> from jaxcslc import Recording
    >>> time = 2.0 * np.arange(100)  # milliseconds
    >>> still = np.zeros((100, 1))
    >>> time_unit(Recording(time, still, still))[0]
    0.001
    """
    interval = float(np.median(np.diff(recording.time)))
    if interval < _LONGEST:
        return 1.0, None
    factor = next((f for f in _UNITS if _SHORTEST < f * interval < _LONGEST), 1.0)
    if factor == 1.0:
        return 1.0, None
    duration = float(recording.time[-1] - recording.time[0])
    unit, symbol = _UNITS[factor]
    counter = " or counts rows" if interval == 1.0 else ""
    return factor, Finding(
        "time unit",
        "",
        f"as seconds, samples are {interval:.4g} s apart, the recording lasts {duration:.3g} s and"
        f" no joint is faster than {_top_speed(recording):.2g} rad/s or m/s",
        f"time is in {unit}{counter}",
        f'[time] unit = "{symbol}" in the mapping of --columns',
    )


def clock_findings(recording: Recording) -> Iterator[Finding]:
    """Find faults in the times of a recording [s]: gaps, lost rows, jitter, two rates.

    **Arguments**

    - `recording`: with time in seconds.

    **Returns** the findings.
    """
    time = recording.time - recording.time[0]
    intervals = np.diff(time)
    interval = float(np.median(intervals))
    early, late = (float(np.median(part)) for part in np.array_split(intervals, 2))
    if not 1 / _OTHER_RATE < late / early < _OTHER_RATE:
        yield Finding(
            "rate",
            "",
            f"{1 / early:.4g} samples a second in its first half, {1 / late:.4g} in its second",
            "the recorder changed its rate, or two recordings were joined",
            "cut it where the rate changes, with --between START,END",
        )
        return
    gaps = np.flatnonzero(intervals > GAP * interval)
    for gap in gaps[np.argsort(-intervals[gaps])][:3]:
        spent = f"{time[gap]:.4g} s to {time[gap + 1]:.4g} s"
        start, end = max(
            ((0.0, time[gap]), (time[gap + 1], time[-1])), key=lambda part: part[1] - part[0]
        )
        yield Finding(
            "gap",
            "",
            f"no samples from {spent}, where they are {1e3 * interval:.4g} ms apart otherwise;"
            " filters need even times and are not used, and smoothing runs across the gap",
            "the recorder stopped or rows were deleted",
            f"--between {start:.4g},{end:.4g} takes the longer part alone",
        )
    regular = intervals[intervals < _LOST * interval]
    spread = float(np.std(regular) / interval)
    lost = (intervals > _LOST * interval) & (intervals <= GAP * interval)
    if spread > _JITTER:
        yield Finding(
            "jitter",
            "",
            f"intervals between samples vary by {100 * spread:.2g} % (standard deviation) about"
            f" {1e3 * interval:.4g} ms; filters need even times and are not used",
            "rows were stamped when they arrived, not when they were measured",
            f"--period {_rounded(time):.6g} restores the times of an even clock",
        )
    elif np.mean(lost) > _MOST_LOST:
        yield Finding(
            "gap",
            "",
            f"{int(np.sum(lost))} of {lost.size} intervals are of two or more periods of"
            f" {1e3 * interval:.4g} ms; filters need even times and are not used",
            "rows were lost",
            f"--period {_rounded(time):.6g} puts the rows on an even clock, or record again",
        )


def _rounded(time: Float[np.ndarray, " samples"]) -> float:
    """The period, to the three digits that clocks are set by."""
    intervals = np.diff(time)
    regular = intervals[intervals < _LOST * np.median(intervals)]
    return float(f"{np.mean(regular):.3g}")


def _top_speed(recording: Recording) -> float:
    speed = np.abs(np.gradient(recording.position, recording.time, axis=0))
    return float(np.max(np.quantile(speed, 0.99, axis=0)))


# Part of rows, or of a joint's samples, from which on something is said.
_STALE, _REPEATED, _CLIPPED, _OUTLYING = 2e-3, 0.3, 5e-3, 5e-5
# An outlier is so many standard deviations from the median of its neighbours.
_FAR, _WINDOW = 12.0, 7
# Its distance from the mean of its two neighbours is at least this part of that: one in a pair of
# outliers has half.
_ALONE = 0.45
_MOTIONLESS = 3.0  # counts
_FIXED = 0.01  # rad or m that a joint may move by that is taken as fixed
LEAST_DISTANCE = {"position": 0.02, "torque": 0.6}
"""Outliers are further away than this part of the range. Dry friction makes torques jump by half of
theirs, back and forth within a few samples where a joint hesitates."""


def sample_findings(
    recording: Recording, names: Sequence[str], *, fixable: bool = False
) -> Iterator[Finding]:
    """Find faults in single samples.

    Faults are stale and repeated rows, clipping, and joints at rest. Others are joints that move
    though taken as fixed, and joints that do not follow others as the file says.

    **Arguments**

    - `recording`: of n joints.
    - `names`: of the joints.
    - `fixable`: whether joints of the robot's file can be left out.

    **Returns** the findings.
    """
    yield from _repetition(recording)
    for name, extent in recording.fixed_motion:
        if extent > _FIXED:
            yield Finding(
                "fixed joint",
                name,
                f"it moves by {extent:.3g} rad or m, and is taken as fixed at zero",
                "--fix, --tip or --base leave out a joint that the motion needs",
                "leave it free, or record the others with this joint at rest",
            )
    for name, error in recording.following_error:
        if error > _FIXED:
            yield Finding(
                "mimic joint",
                name,
                f"it is up to {error:.3g} rad or m off the law by which the robot's file has it"
                " follow another",
                "the file's multiplier or offset is not the arm's, or the joints have play",
                "compare <mimic> (or the equality) in the robot's file with the arm, or fix both"
                " joints and record with them at rest",
            )
    still = motionless(recording)
    constant = np.ptp(recording.torque, axis=0) == 0.0
    if still.any():
        yield _motionless(recording, still, constant, names, fixable)
    for joint in np.flatnonzero(constant & ~still).tolist():
        yield Finding(
            "constant torque",
            names[joint],
            f"every torque is {recording.torque[0, joint]:.4g}",
            "its torque was not recorded",
            "record the torque of every joint",
        )
    clipped = clipping(recording.torque)
    for joint in np.flatnonzero(clipped.mean(axis=0) > _CLIPPED).tolist():
        column, cut = recording.torque[:, joint], clipped[:, joint]
        limits = " and ".join(f"{value:.4g}" for value in np.unique(column[cut]))
        yield Finding(
            "clipping",
            names[joint],
            f"{100 * np.mean(cut):.2g} % of its torques are exactly {limits}, and none is beyond",
            "the drive or the recorder limits the torque there: the motion had another one",
            "record a slower motion; --loss bisquare disregards what does not fit",
        )


def _motionless(
    recording: Recording,
    still: Bool[np.ndarray, " joints"],
    constant: Bool[np.ndarray, " joints"],
    names: Sequence[str],
    fixable: bool,
) -> Finding:
    """Make a single finding for all joints that do not move: their remedy is one option."""
    listed = [name for name, rests in zip(names, still, strict=True) if rests]
    extent = float(np.max(np.ptp(recording.position[:, still], axis=0)))
    same = "; no torque of theirs changes" if constant[still].all() else ""
    return Finding(
        "motionless joint",
        ", ".join(listed),
        f"positions stay within {extent:.2g} rad or m{same}",
        "locked joints, a gripper that stood still, or columns of something else",
        f"--fix {','.join(listed)} if the joints are not to be identified; else move them"
        if fixable
        else "move them, or expect their own coefficients to be undetermined",
    )


def outlier_findings(
    recording: Recording,
    outlying: dict[str, Bool[np.ndarray, "samples joints"]],
    names: Sequence[str],
) -> Iterator[Finding]:
    """A finding for each quantity with outliers, of all joints together.

    **Arguments**

    - `outlying`: by quantity, `"position"` and `"torque"`: as of `outliers`.
    - `names`: of the joints.
    """
    for quantity, hit in outlying.items():
        if hit.mean() <= _OUTLYING:
            continue
        joints = np.flatnonzero(hit.any(axis=0)).tolist()
        values = getattr(recording, quantity)
        largest = float(np.max(np.abs(values - _local_median(values))[hit]))
        yield Finding(
            "outliers",
            ", ".join(names[joint] for joint in joints),
            f"{int(hit.sum())} {quantity} values ({100 * hit.mean():.2g} %) lie up to {largest:.3g}"
            f" from the values beside them",
            "faults of transmission or of the sensor",
            "--loss huber bounds what they do to the fit"
            if quantity == "torque"
            else "--despike replaces them by the median of their neighbours",
        )


def outliers(
    values: Float[np.ndarray, "samples joints"], least: float
) -> Bool[np.ndarray, "samples joints"]:
    """Marks single samples that lie far from their neighbours.

    A sample is compared with the median of the seven around it, which steps and slopes leave
    where they are, in units of what such differences usually are (1.48 times their median).

    **Arguments**

    - `values`: shape `(samples, joints)`.
    - `least`: distance of an outlier as part of the range of the values, see `LEAST_DISTANCE`.

    **Returns** True for outliers, shape `(samples, joints)`.

    >>> import numpy as np
    >>> wave = np.sin(np.arange(200) / 20)[:, None]
    >>> wave[50] += 3.0
    >>> np.flatnonzero(outliers(wave, least=0.5)).tolist()
    [50]
    """
    distance = np.abs(values - _local_median(values))
    # The peak of a fast motion lies far from the median around it, too, but near its neighbours.
    # At the ends, where only one side tells, nothing counts as an outlier.
    beside = np.pad(values, ((1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    alone = np.abs(values - 0.5 * (beside[:-2] + beside[2:])) > _ALONE * distance
    usual = 1.4826 * np.median(distance, axis=0)
    # Values of a coarse grid differ from their neighbours' median by nothing, or by steps.
    extent = np.ptp(np.quantile(values, [0.02, 0.98], axis=0), axis=0)
    steps = np.maximum(usual, np.quantile(distance, 0.95, axis=0) / 2.0)
    counts = np.maximum(np.maximum(steps, encoder_resolution(values) / 3.0), 1e-12)
    return alone & (distance > np.maximum(_FAR * counts, least * extent))


def outliers_of(recording: Recording) -> dict[str, Bool[np.ndarray, "samples joints"]]:
    """The outliers of a recording's positions and torques, by quantity.

    Beside a gap nothing is one: motion goes on there unseen, and its neighbours do not tell.
    """
    intervals = np.diff(recording.time)
    gaps = np.flatnonzero(intervals > GAP * np.median(intervals))
    beside = np.zeros(recording.samples, bool)
    for reach in range(_WINDOW // 2):
        beside[np.maximum(gaps - reach, 0)] = True
        beside[np.minimum(gaps + 1 + reach, recording.samples - 1)] = True
    return {
        quantity: outliers(getattr(recording, quantity), least) & ~beside[:, None]
        for quantity, least in LEAST_DISTANCE.items()
    }


def without_outliers(recording: Recording) -> Recording:
    """Replaces single samples that lie far from their neighbours by the median around them.

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

    mended: dict[str, Float[np.ndarray, "samples joints"]] = {}
    for quantity, outlying in outliers_of(recording).items():
        values = getattr(recording, quantity)
        mended[quantity] = np.where(outlying, _local_median(values), values)
    return dataclasses.replace(recording, **mended)


def clipping(torque: Float[np.ndarray, "samples joints"]) -> Bool[np.ndarray, "samples joints"]:
    """Marks the torques that a limit holds: many equal ones at the end of a joint's range.

    A smooth peak of rounded values stays on its highest level, too, but only 2.4 times as long as
    on the level below.

    **Arguments**

    - `torque`: shape `(samples, joints)`.

    **Returns** True where a joint's torque is at a limit, shape `(samples, joints)`.

    >>> import numpy as np
    >>> wave = np.sin(np.arange(1000) / 20)[:, None]
    >>> int(clipping(wave).sum()), int(clipping(np.clip(wave, -0.9, 2.0)).sum())
    (0, 144)
    """
    clipped = np.zeros(torque.shape, bool)
    for joint, column in enumerate(torque.T):
        levels, counts = np.unique(column, return_counts=True)
        for end, below in ((0, slice(1, 4)), (-1, slice(-4, -1))):
            if levels.size > 8 and counts[end] > max(4, 4 * int(np.sum(counts[below]))):
                clipped[:, joint] |= column == levels[end]
    return clipped


def motionless(recording: Recording) -> Bool[np.ndarray, " joints"]:
    """True for each joint that does not leave three counts of its encoder."""
    extent = np.ptp(recording.position, axis=0)
    return extent <= np.maximum(_MOTIONLESS * encoder_resolution(recording.position), 1e-9)


def _repetition(recording: Recording) -> Iterator[Finding]:
    moving = _moving(recording)
    if moving.sum() < 100:
        return
    stale = stale_rows(recording)
    part = float(np.mean(stale[moving]))
    if part > _STALE:
        yield Finding(
            "stale rows",
            "",
            f"{100 * part:.2g} % of the rows during motion repeat all values of the row before",
            "the recorder polls faster than its source delivers, or messages were late",
            "--drop-stale leaves them out",
        )
        moving &= ~stale
    for quantity, other in (("position", "torque"), ("torque", "position")):
        repeated = _repeats(getattr(recording, quantity)) & ~_repeats(getattr(recording, other))
        part = float(np.mean(repeated[moving]))
        if part > _REPEATED and not (quantity == "torque" and _is_coarse(recording.torque)):
            every = round(1.0 / (1.0 - part))
            yield Finding(
                "rate",
                "",
                f"{quantity} values change in every {every}. row only, where the others change in"
                " every row",
                f"the source of {quantity} values is slower than the recorder",
                f"--every {every} keeps the rows with new values",
            )


def _repeats(values: Float[np.ndarray, "samples joints"]) -> Bool[np.ndarray, " samples"]:
    return np.append(False, np.all(values[1:] == values[:-1], axis=1))


def _is_coarse(values: Float[np.ndarray, "samples joints"]) -> bool:
    """Return whether values have so few levels that repetitions are rounding."""
    return bool(np.median([np.unique(column).size for column in values.T]) < 50)


def _moving(recording: Recording) -> Bool[np.ndarray, " samples"]:
    """Rows around which some joint moves by several counts from row to row."""
    position = recording.position
    reach = 8
    ahead = np.abs(np.roll(position, -reach, axis=0) - np.roll(position, reach, axis=0)) / (
        2 * reach
    )
    ahead[:reach] = ahead[-reach:] = 0.0
    fastest = np.quantile(ahead, 0.98, axis=0)
    steps = 2.0 * np.maximum(encoder_resolution(position), 1e-12)
    return np.any((ahead > 0.1 * fastest) & (ahead > steps), axis=1)


def _local_median(values: Float[np.ndarray, "samples joints"]) -> np.ndarray:
    """Compute the median over windows of samples, the signals mirrored at their ends."""
    half = _WINDOW // 2
    medians = np.empty(values.shape)
    for median, column in zip(medians.T, values.T, strict=True):  # windows of one in memory
        windows = np.lib.stride_tricks.sliding_window_view(
            np.pad(column, half, mode="reflect"), _WINDOW
        )
        median[:] = np.partition(windows, half, axis=1)[:, half]
    return medians

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...motion import Recording
from ._finding import Finding


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
    """What is wrong with the times of a recording in seconds: gaps, lost rows, jitter, two rates.

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

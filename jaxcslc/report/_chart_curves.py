"""Curves of charts, thinned to what a page can show."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float


# The largest power of ten that is a float exactly.
_EXACT_POWER = 22

CurveLook = Literal["measured", "predicted", "residual", "points", "fitted"]


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A line, or points, of a panel.

    **Attributes**

    - `name`: in the legend.
    - `x`, `y`: NaN breaks the line.
    - `look`: `"measured"`, a broad grey line; `"predicted"` and `"residual"`, thin ones; or
      `"points"` and `"fitted"`, grey and coloured points.

    >>> Curve("measured", (0.0, 1.0), (2.0, 3.0), "measured").look
    'measured'
    """

    name: str
    x: Sequence[float | None]
    y: Sequence[float | None]
    look: CurveLook


def envelope(
    x: Float[np.ndarray, " samples"], y: Float[np.ndarray, " samples"], most: int = 5000
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """A curve of fewer points that looks the same: its extremes in equal stretches.

    **Arguments**

    - `x`: ascending.
    - `y`: of each x; a stretch that is NaN throughout stays a gap.
    - `most`: points that are left at most, two a stretch, and one for each gap.

    **Returns** `x` and `y` of the minimum and maximum of each stretch, in ascending order of x.

    **Raises**

    - `ValueError`: fewer than two points.

    >>> import numpy as np
    >>> x = np.arange(100.0)
    >>> y = np.where(x == 37, 5.0, 0.0)
    >>> fewer_x, fewer_y = envelope(x, y, 10)
    >>> len(fewer_x) <= 10, float(fewer_y.max())
    (True, 5.0)
    """
    if most < 2:
        raise ValueError(f"most: expected at least 2 points, got {most}")
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    starts, lengths = edges[:-1], np.diff(edges)
    # All stretches as rows, of which some end with one sample less.
    index = starts[:, None] + np.arange(np.max(lengths))
    counted = np.arange(np.max(lengths)) < lengths[:, None]
    stretches = y[np.minimum(index, len(y) - 1)]
    counted &= np.isfinite(stretches)
    lowest = starts + np.argmin(np.where(counted, stretches, np.inf), axis=1)
    highest = starts + np.argmax(np.where(counted, stretches, -np.inf), axis=1)
    kept = np.unique(np.concatenate([lowest, highest]))
    return x[kept], y[kept]


def intervals(
    x: Float[np.ndarray, " samples"], mask: Bool[np.ndarray, " samples"], most: int = 400
) -> list[tuple[float, float]]:
    """The stretches of x where a mask is True, each from half a sample before to half after.

    **Arguments**

    - `x`: ascending.
    - `mask`: of each x.
    - `most`: stretches that are left at most: the narrowest gaps between them are closed first.

    **Returns** start and end of each.

    >>> import numpy as np
    >>> intervals(np.arange(6.0), np.array([False, True, True, False, False, True]))
    [(0.5, 2.5), (4.5, 5.0)]
    """
    if not np.any(mask):
        return []
    padded = np.concatenate([[False], mask, [False]]).astype(int)
    starts = np.flatnonzero(np.diff(padded) == 1)
    ends = np.flatnonzero(np.diff(padded) == -1)  # one past the last
    middles = np.concatenate([x[:1], 0.5 * (x[:-1] + x[1:]), x[-1:]])
    low, high = middles[starts], middles[ends]
    if len(low) > most:
        gaps = low[1:] - high[:-1]
        widest = np.sort(np.argsort(-gaps, kind="stable")[: most - 1])
        low, high = low[np.concatenate([[0], widest + 1])], high[np.append(widest, len(high) - 1)]
    return [(float(a), float(b)) for a, b in zip(low, high, strict=True)]


def plain(values: Sequence[float | None] | np.ndarray, digits: int = 5) -> list[float | None]:
    """Numbers to some significant digits, as they stand in a page; None for NaN.

    >>> plain([1.2345678, float("nan")])
    [1.2346, None]
    """
    x = np.asarray(values, float)
    finite = np.isfinite(x)
    # Python's own numbers: those of NumPy take three times as long to be written.
    rounded: list[float] = _significant(np.where(finite, x, 0.0), digits).tolist()
    if np.all(finite):
        return list(rounded)
    return [x if kept else None for x, kept in zip(rounded, finite.tolist(), strict=True)]


def _significant(x: Float[np.ndarray, "*shape"], digits: int) -> Float[np.ndarray, "*shape"]:
    """Numbers to some significant digits: those that the decimal numbers are read as.

    >>> _significant(np.array([1.2345678, 123456.0]), 5).tolist()
    [1.2346, 123460.0]
    """
    magnitude = np.floor(np.log10(np.abs(x), out=np.zeros_like(x), where=x != 0.0))
    # Powers of ten up to this are exact, so that quotients by them are the decimal numbers.
    power = np.clip(digits - 1 - magnitude, -_EXACT_POWER, _EXACT_POWER)
    up, down = 10.0 ** np.maximum(power, 0.0), 10.0 ** np.maximum(-power, 0.0)
    return np.rint(x * up / down) / up * down

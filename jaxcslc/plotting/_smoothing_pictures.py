from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ._look import COLOURS, MEASURED, STYLES, figure_of, legend_below, single_axes


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = ("o", "s", "^", "D", "v", "P")


def spline_subsets_picture(
    time: Float[np.ndarray, " samples"],
    quantised: Float[np.ndarray, " samples"],
    fine_time: Float[np.ndarray, " points"],
    splines: Sequence[Float[np.ndarray, " points"]],
    *,
    title: str | None = None,
    units: tuple[str, str] = ("ms", "counts"),
) -> "Figure":
    """Cubic splines through interleaved subsets of quantised data (Fig. 7.3-1).

    **Arguments**

    - `time`, `quantised`: (samples,) what was recorded.
    - `fine_time`: (points,) where the splines are drawn.
    - `splines`: j curves, (points,) each; the first passes through the samples 0, j, 2 j, ..., the
      second through 1, j + 1, ....
    - `units`: of time and position.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    step = len(splines)
    for i, curve in enumerate(splines):
        look: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)]}
        style = STYLES[i % len(STYLES)]
        dots: dict[str, Any] = {
            "marker": _MARKERS[i % len(_MARKERS)],
            "mec": "black",
            "mew": 0.5,
            "ms": 6,
        }
        axes.plot(fine_time, curve, ls=style, lw=1.5, **look)
        axes.plot(time[i::step], quantised[i::step], ls="", zorder=3, **look, **dots)
        label = f"samples {i + 1}, {i + 1 + step}, {i + 1 + 2 * step}, …"
        axes.plot([], [], ls=style, label=label, **look, **dots)
    _finish(axes, units)
    return figure_of(axes)


def averaged_spline_picture(
    time: Float[np.ndarray, " samples"],
    quantised: Float[np.ndarray, " samples"],
    fine_time: Float[np.ndarray, " points"],
    averaged: Float[np.ndarray, " points"],
    true: Float[np.ndarray, " points"] | None = None,
    *,
    title: str | None = None,
    units: tuple[str, str] = ("ms", "counts"),
) -> "Figure":
    """The average of the splines against quantised and, where known, true positions (Fig. 7.3-2).

    **Arguments**

    - `time`, `quantised`: (samples,) what was recorded.
    - `fine_time`, `averaged`, `true`: (points,) the curves.
    - `units`: of time and position.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    if true is not None:
        axes.plot(fine_time, true, color=MEASURED, lw=4.0, label="true position")
    axes.plot(fine_time, averaged, color=COLOURS[1], lw=1.6, label="averaged splines")
    axes.plot(
        time,
        quantised,
        "o",
        color=COLOURS[0],
        mec="black",
        mew=0.5,
        ms=5,
        label="quantised samples",
    )
    _finish(axes, units)
    return figure_of(axes)


def _finish(axes: "Axes", units: tuple[str, str]) -> None:
    axes.set_xlabel(f"time [{units[0]}]")
    axes.set_ylabel(f"position [{units[1]}]")
    axes.margins(x=0.01)
    legend_below(axes)

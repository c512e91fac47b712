"""Picture of the disturbance budget."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scripts.studies.figures import (
    COLOURS,
    QUIET,
    figure_of,
    legend_below,
    readable_decades,
    single_axes,
)


def budget_picture(
    disturbances: Sequence[str],
    without: Float[np.ndarray, "disturbances seeds"],
    with_measure: Float[np.ndarray, "disturbances seeds"],
    *,
    floor: float | None = None,
    quantiles: tuple[float, float] = (0.05, 0.95),
    title: str | None = None,
    quantity: str = "mean error cost ε [N m]",
) -> Figure:
    """Return what each disturbance costs, its counter-measure off and on, over many seeds.

    A dot is the mean over the seeds, a bar the range between two quantiles.

    **Arguments**

    - `disturbances`: names, drawn from the top down.
    - `without`, `with_measure`: (disturbances, seeds), positive; a row of NaN where there is no
      such case, as of a disturbance that nothing is done against, and single NaN where a run
      failed.
    - `floor`: what the true coefficients leave, marked by a line.
    - `quantiles`: lower and upper end of the bars.
    - `quantity`: of the values, with its unit.

    **Returns** a matplotlib figure; its horizontal axis is logarithmic.

    **Raises**

    - `ValueError`: if the numbers of rows differ from that of the names, or a value is not
      positive.
    """
    cases = (
        ("counter-measure off", np.asarray(without), COLOURS[0], "o", -0.14),
        ("counter-measure on", np.asarray(with_measure), COLOURS[1], "s", 0.14),
    )
    for name, values, *_ in cases:
        if len(values) != len(disturbances):
            raise ValueError(
                f"{name}: expected {len(disturbances)} rows, one a disturbance, got {len(values)}"
            )
        if np.any(values <= 0):
            raise ValueError(f"{name}: expected values above 0, got {np.nanmin(values)}")
    axes = single_axes(title, width=7.0, height=1.6 + 0.42 * len(disturbances))
    rows = np.arange(float(len(disturbances)))
    for row in rows[1::2]:  # bands that lead the eye from a name to its bars
        axes.axhspan(row - 0.5, row + 0.5, color="0.95", lw=0, zorder=0)
    for name, values, colour, marker, offset in cases:
        _bars(axes, values, rows + offset, quantiles, label=name, colour=colour, marker=marker)
    if floor is not None:
        axes.axvline(floor, color=QUIET, ls="--", lw=1.2, label="floor: true coefficients")
    axes.set_xscale("log")
    axes.set_yticks(rows, disturbances)
    axes.set_ylim(len(disturbances) - 0.5, -0.5)
    axes.grid(False, axis="y")
    axes.grid(alpha=0.15, axis="x", which="minor")
    axes.tick_params(axis="y", length=0)
    readable_decades(axes, ticks=(1.0,))  # of several decades: more labels would overlap
    low, high = (f"{100 * quantile:.3g} %" for quantile in quantiles)
    axes.set_xlabel(f"{quantity}: mean, and {low} to {high} of the seeds")
    legend_below(axes)
    return figure_of(axes)


def _bars(
    axes: Axes,
    values: Float[np.ndarray, "disturbances seeds"],
    height: Float[np.ndarray, " disturbances"],
    quantiles: tuple[float, float],
    *,
    label: str,
    colour: str,
    marker: str,
) -> None:
    some = ~np.all(np.isnan(values), axis=1)
    if not np.any(some):
        return
    drawn = values[some]
    low, high = (np.nanquantile(drawn, q, axis=1) for q in quantiles)
    axes.hlines(height[some], low, high, color=colour, lw=3.0, alpha=0.4)
    axes.plot(
        np.nanmean(drawn, axis=1), height[some], marker, color=colour, ms=6, ls="", label=label
    )

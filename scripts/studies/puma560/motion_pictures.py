"""Pictures of motion and its smoothing (Figs. 7.3-1, 7.3-2, 7.4-2 and 7.6-4)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scripts.studies.figures import (
    COLOURS,
    MEASURED,
    QUIET,
    STYLES,
    figure_of,
    legend_below,
    new_figure,
    single_axes,
)


_MARKERS = ("o", "s", "^", "D", "v", "P")
# Of models whose errors are compared: lines of one style, far apart in hue and in lightness.
_MODELS = ("#D55E00", "#56B4E9", "black")


def spline_subsets_picture(
    time: Float[np.ndarray, " samples"],
    quantised: Float[np.ndarray, " samples"],
    fine_time: Float[np.ndarray, " points"],
    splines: Sequence[Float[np.ndarray, " points"]],
    *,
    title: str | None = None,
    units: tuple[str, str] = ("ms", "counts"),
) -> Figure:
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
) -> Figure:
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


def _finish(axes: Axes, units: tuple[str, str]) -> None:
    axes.set_xlabel(f"time [{units[0]}]")
    axes.set_ylabel(f"position [{units[1]}]")
    axes.margins(x=0.01)
    legend_below(axes)


def motion_picture(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    velocity: Float[np.ndarray, " samples"],
    acceleration: Float[np.ndarray, " samples"],
    *,
    title: str | None = None,
    unit: str = "rad",
) -> Figure:
    """Position, velocity and acceleration of one joint, one above the other (Fig. 7.4-2).

    A grey line marks the mean position, zero velocity and zero acceleration: a training
    trajectory is meant to be the same on both sides of it, so that what depends on direction
    averages out (7.4.1).

    **Arguments**

    - `time`: (samples,) [s].
    - `position`, `velocity`, `acceleration`: (samples,).
    - `unit`: of the position, `"rad"` or `"m"`.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(6.0, 5.2)
    rows = np.atleast_1d(figure.subplots(3, 1, sharex=True))
    profiles = (
        ("position", position, unit, float(np.mean(position))),
        ("velocity", velocity, f"{unit}/s", 0.0),
        ("acceleration", acceleration, f"{unit}/s²", 0.0),
    )
    for axes, colour, (name, values, axis_unit, centre) in zip(
        rows, COLOURS, profiles, strict=False
    ):
        axes.axhline(centre, color=MEASURED, lw=1.0, zorder=0.5)
        axes.plot(time, values, color=colour, lw=1.5)
        axes.set_ylabel(f"{name}\n[{axis_unit}]")
        axes.grid(alpha=0.25)
        axes.margins(x=0.0)
    rows[-1].set_xlabel("time [s]")
    figure.align_ylabels(list(rows))
    if title:
        figure.suptitle(title)
    return figure


def reversal_picture(
    time: Float[np.ndarray, " samples"],
    measured: Float[np.ndarray, " samples"],
    predicted: Float[np.ndarray, " samples"],
    *,
    reversal: float,
    true_reversal: float | None = None,
    static: Float[np.ndarray, " samples"] | None = None,
    title: str | None = None,
    unit: str = "N m",
) -> Figure:
    """One joint's torque where it turns round (Fig. 7.6-4).

    Static friction, which the model does not have, shows as ramps of the error on both sides of
    the instant of zero velocity.

    **Arguments**

    - `time`: (samples,) of the stretch [s].
    - `measured`: (samples,) the torque that the drive was asked for: a line.
    - `predicted`: (samples,) by the network: dots.
    - `reversal`: when the estimated velocity is zero [s].
    - `true_reversal`: the same of a machine whose truth is known.
    - `static`: (samples,) its static friction beyond dry friction.

    **Returns** a matplotlib figure. Below the torques it shows their difference, which is what
    the thesis reads its thresholds from.
    """
    figure = new_figure(6.0, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    upper.plot(time, measured, color=COLOURS[1], lw=1.5, label="measured")
    upper.plot(time, predicted, ".", color=COLOURS[0], ms=4.5, label="predicted")
    lower.axhline(0.0, color=MEASURED, lw=1.0, zorder=0.5)
    lower.plot(time, measured - predicted, color=QUIET, lw=1.2, label="error")
    if static is not None:
        lower.plot(time, static, color=COLOURS[3], ls="--", lw=1.5, label="true static friction")
    for axes in (upper, lower):
        axes.axvline(reversal, color="black", lw=1.0, label="estimated zero of velocity")
        if true_reversal is not None:
            axes.axvline(
                true_reversal, color=COLOURS[2], ls="--", lw=1.2, label="true zero of velocity"
            )
        axes.grid(alpha=0.25)
        axes.margins(x=0.0)
    upper.set_ylabel(f"torque [{unit}]")
    lower.set_ylabel(f"error [{unit}]")
    lower.set_xlabel("time [s]")
    figure.align_ylabels([upper, lower])
    if title:
        figure.suptitle(title)
    if static is not None:  # the lower panel's are in the legend of both
        upper.plot([], [], color=QUIET, lw=1.2, label="error")
        upper.plot([], [], color=COLOURS[3], ls="--", lw=1.5, label="true static friction")
    legend_below(upper, columns=2 if true_reversal is not None else 3)
    return figure


def torque_picture(
    time: Float[np.ndarray, " samples"],
    measured: Float[Array | np.ndarray, "samples joints"],
    predicted: Mapping[str, Float[Array | np.ndarray, "samples joints"]],
    mask: Bool[Array | np.ndarray, "samples joints"],
    *,
    title: str,
) -> Figure:
    """Torque of every joint against time, with the errors of predictions below (Fig. 7.6-1).

    Predictions that are good lie on top of each other and of the measured torque. Their errors
    tell them apart.

    **Arguments**

    - `time`: (samples,) [s].
    - `measured`: (samples, n) [N m].
    - `predicted`: the same of each model, by name.
    - `mask`: (samples, n), the judged samples: predictions are drawn for these only.

    **Returns** a matplotlib figure; `figure.savefig(path)` draws it.
    """
    measured, shown = np.asarray(measured), np.asarray(mask)
    n = measured.shape[1]
    rows = -(-n // 2)
    figure = new_figure(11.0, 1.2 + 3.2 * rows)
    axes = figure.subplots(2 * rows, 2, sharex=True, height_ratios=(2, 1) * rows)
    # Down the columns, as in the thesis: joints 1 to 3 on the left of a six-jointed arm.
    for joint in range(n):
        row, column = joint % rows, joint // rows
        torques, errors = axes[2 * row, column], axes[2 * row + 1, column]
        torques.plot(time, measured[:, joint], color=MEASURED, lw=3.0, label="measured")
        for (name, torque), colour in zip(predicted.items(), _MODELS, strict=True):
            curve = np.where(shown[:, joint], np.asarray(torque)[:, joint], np.nan)
            torques.plot(time, curve, color=colour, lw=1.0, label=name)
            errors.plot(time, curve - measured[:, joint], color=colour, lw=0.8, label=name)
        torques.set_ylabel(f"joint {joint + 1} [N m]")
        errors.set_ylabel("error [N m]")
        for axis in (torques, errors):
            axis.grid(alpha=0.25)
            axis.margins(x=0.01)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels()
    figure.suptitle(title)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure

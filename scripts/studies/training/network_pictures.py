"""Pictures of three small problems (Figs. 3.3-4, 3.6-1 and 4.3-1)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from scripts.studies.figures import (
    COLOURS,
    MEASURED,
    QUIET,
    figure_of,
    legend_below,
    new_figure,
    single_axes,
)


# Outputs of a node: its sums over a grid of the plane, and its answers to patterns.
Decision = tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, " patterns"]]
# A fitted curve: the points, (points, 2), and the curve.
Fit = tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " curve"]]


def decision_picture(
    x1: Float[np.ndarray, " columns"],
    x2: Float[np.ndarray, " rows"],
    decisions: Mapping[str, Decision],
    patterns: Float[np.ndarray, "patterns 2"],
    targets: Float[np.ndarray, " patterns"],
    *,
    title: str | None = None,
) -> Figure:
    """The region of the input plane in which a hard limiter's output is one (Fig. 3.3-4).

    The region is shaded; on the line the sum of the weighted inputs is zero. Patterns with a wrong
    answer are ringed.

    **Arguments**

    - `x1`, `x2`: the grid.
    - `decisions`: by name, a panel for each: sums (rows, columns), and answers (patterns,).
    - `patterns`, `targets`: (patterns, 2) and (patterns,), zero or one.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(4.3 * len(decisions), 5.3)
    panels = figure.subplots(1, len(decisions), squeeze=False)[0]
    for axes, (name, (sums, answers)) in zip(panels, decisions.items(), strict=True):
        axes.contourf(x1, x2, sums >= 0, levels=[0.5, 1.5], colors=[COLOURS[5]], alpha=0.45)
        if sums.min() < 0 <= sums.max():
            axes.contour(x1, x2, sums, levels=[0.0], colors=[COLOURS[1]], linewidths=1.8)
        for target, face in ((1.0, "black"), (0.0, "white")):
            of = targets == target
            dots: dict[str, Any] = {"ls": "", "marker": "o", "ms": 9, "mec": "black", "mfc": face}
            axes.plot(*patterns[of].T, label=f"target {target:g}", zorder=3, **dots)
        wrong = answers != targets
        ring: dict[str, Any] = {
            "ls": "",
            "marker": "o",
            "ms": 19,
            "mew": 2.0,
            "mfc": "none",
            "mec": COLOURS[0],
        }
        axes.plot(*patterns[wrong].T, label="answered wrongly", zorder=3, **ring)
        axes.set_title(f"{name}\n{np.sum(~wrong)} of {len(targets)} right", fontsize="medium")
        axes.set_box_aspect(np.ptp(x2) / np.ptp(x1))  # equal units, in a box that layouts respect
        axes.set_xlabel("$x_1$")
    panels[0].set_ylabel("$x_2$")
    panels[0].plot([], [], color=COLOURS[1], lw=1.8, label="sum is zero")
    panels[0].fill([], [], color=COLOURS[5], alpha=0.45, label="output 1")
    legend_below(panels[0], columns=3)
    if title:
        figure.suptitle(title)
    return figure


def overtraining_picture(
    training: Float[np.ndarray, " epochs"],
    stop: Float[np.ndarray, " epochs"],
    *,
    title: str | None = None,
    error: str = "root mean square error",
) -> Figure:
    """Errors of the training set and of the stop set, epoch by epoch (Fig. 3.6-1).

    The vertical dashed line is at the lowest error of the stop set, where training should stop.

    **Arguments**

    - `training`, `stop`: (epochs,) before each epoch.
    - `error`: name of the errors, with their unit.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    epochs = np.arange(1, len(training) + 1)
    best = int(np.nanargmin(stop))
    axes.plot(epochs, training, color=COLOURS[1], lw=1.8, label="training set")
    axes.plot(epochs, stop, color=COLOURS[0], lw=1.8, ls="-.", label="stop set")
    axes.axvline(best + 1, color=QUIET, ls="--", lw=1.2, label=f"stop training: epoch {best + 1}")
    axes.plot(best + 1, stop[best], "o", color=COLOURS[0], mec="black", mew=0.5)
    axes.set_xscale("log")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.set_xlabel("epoch")
    axes.set_ylabel(error)
    legend_below(axes)
    return figure_of(axes)


def fitted_curves_picture(
    x: Float[np.ndarray, " curve"],
    true: Float[np.ndarray, " curve"],
    fits: Mapping[str, Fit],
    *,
    title: str | None = None,
    height: float = 4.0,
) -> Figure:
    """Curves fitted to a few points each, and the system that the points are from (Fig. 4.3-1).

    **Arguments**

    - `x`, `true`: (curve,) the system.
    - `fits`: by name, the points (points, 2) that a curve was fitted to and the curve (curve,).
      The first is drawn solid with circles, the second dotted with crosses.
    - `height`: half the range of the vertical axis, in half ranges of the points; curves beyond are
      cut off.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    axes.plot(x, true, color=MEASURED, lw=4.0, label="the system")
    looks = (("-", "o"), (":", "x"), ("--", "s"), ("-.", "^"))
    for i, (name, (points, curve)) in enumerate(fits.items()):
        style, marker = looks[i % len(looks)]
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(x, curve, color=colour, ls=style, lw=1.8)
        dots: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "ms": 7,
            "mew": 1.6,
            "mfc": "none",
        }
        axes.plot(*points.T, ls="", zorder=3, **dots)
        axes.plot([], [], ls=style, lw=1.8, label=name, **dots)
    values = np.concatenate([points for points, _ in fits.values()])[:, 1]
    middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
    axes.set_ylim(middle - height * half, middle + height * half)
    axes.margins(x=0.0)
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    legend_below(axes)
    return figure_of(axes)

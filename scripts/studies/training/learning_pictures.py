"""Pictures of learning rules side by side (Figs. 6.3-3 and 6.3-4), and of many trainings."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from scripts.studies.figures import COLOURS, QUIET, STYLES, new_figure, readable_decades


_BINS = 40  # of a histogram


class Learning(NamedTuple):
    """Epochs of one rule, and from a hand-over on those of others.

    - `first`: a name and its values, (epochs,), from the first epoch on; index `hand_over` is
      where the others begin.
    - `others`: names and their values, (epochs,), from the hand-over on.
    - `hand_over`: an epoch.
    - `levels`: names and values of horizontal lines: goals, and the best possible value.
    """

    first: tuple[str, Float[np.ndarray, " epochs"]]
    others: Mapping[str, Float[np.ndarray, " epochs"]]
    hand_over: int
    levels: Mapping[str, float]


def learning_picture(
    panels: Mapping[str, Learning],
    label: str,
    *,
    title: str | None = None,
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Rules that start from one state, side by side (Figs. 6.3-3 and 6.3-4).

    **Arguments**

    - `panels`: by title, side by side; lines of the same name look the same in all of them.
    - `label`: of the vertical axes, with its unit.
    - `limits`: of the vertical axes; by default, each panel's from its levels to a little above
      its hand-over, where the rules diverge.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(4.6 * max(len(panels), 1) + 0.6, 4.4)
    axes_of = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (name, learning) in zip(axes_of, panels.items(), strict=True):
        rule, values = learning.first
        axes.plot(values, color=COLOURS[1], ls=STYLES[0], lw=1.6, label=rule)
        for i, (other, epochs) in enumerate(learning.others.items()):
            x = learning.hand_over + np.arange(len(epochs))
            colour = COLOURS[2 * i % len(COLOURS)]
            axes.plot(
                x, epochs, color=colour, ls=STYLES[(i + 1) % len(STYLES)], lw=1.8, label=other
            )
        axes.axvline(
            learning.hand_over, color=QUIET, lw=1.0, ls=(0, (2, 2)), label="hand-over", zorder=0.5
        )
        for i, (level, height) in enumerate(learning.levels.items()):
            axes.axhline(
                height,
                color=QUIET,
                lw=1.0,
                ls=STYLES[(i + 2) % len(STYLES)],
                label=level,
                zorder=0.5,
            )
        axes.set_ylim(*(_limits(learning) if limits is None else limits))
        axes.set_xlim(left=0)
        axes.set_xlabel("epochs")
        axes.set_title(name, fontsize="medium")
        axes.grid(alpha=0.25)
    axes_of[0].set_ylabel(label)
    handles, labels = axes_of[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 5), frameon=False
    )
    if title:
        figure.suptitle(title)
    return figure


def _limits(learning: Learning) -> tuple[float, float]:
    hand_over = float(learning.first[1][min(learning.hand_over, len(learning.first[1]) - 1)])
    values = [hand_over, *learning.levels.values(), float(np.nanmin(learning.first[1]))]
    low, high = min(values), max(values)
    span = max(high - low, 1e-12)
    return low - 0.1 * span, high + 1.0 * span


def conditions_picture(rows: Sequence[Mapping[str, Any]], starts: int) -> Figure:
    """Epochs of backpropagation over those of PERAL, by the number of patterns.

    **Arguments**

    - `rows`: with condition, goal, rule and the ratio of median epochs.
    - `starts`: how many the medians are of, for the title.
    """
    goals = list(dict.fromkeys(row["goal"] for row in rows))
    figure = new_figure(3.4 * len(goals) + 0.6, 4.2)
    axes_of = figure.subplots(1, len(goals), squeeze=False, sharey=True)[0]
    series = list(dict.fromkeys((row["centred"], row["cost"]) for row in rows))
    for axes, goal in zip(axes_of, goals, strict=True):
        for i, (centred, cost) in enumerate(series):
            of_series = [
                row
                for row in rows
                if (row["goal"], row["centred"], row["cost"]) == (goal, centred, cost)
                and row["rule"] == "PERAL"
            ]
            x = [row["patterns"] * (1.0 + 0.05 * (i - 1.5)) for row in of_series]
            y = [row["backpropagation's median epochs over PERAL's"] for row in of_series]
            label = f"inputs {'centred' if centred else 'as they are'}, {cost}"
            axes.plot(
                x, np.clip(y, 0.02, 50.0), ls="", marker="os^D"[i % 4], ms=6,
                color=COLOURS[i % len(COLOURS)], label=label,
            )  # fmt: skip
        axes.axhline(1.0, color=QUIET, lw=1.0, zorder=0.5)
        axes.axhline(5.0, color=QUIET, lw=1.0, ls=STYLES[1], zorder=0.5, label="thesis, one start")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.015, 70.0)
        patterns = sorted({row["patterns"] for row in rows})
        axes.set_xlim(patterns[0] / 1.5, patterns[-1] * 1.5)
        axes.xaxis.set_major_locator(FixedLocator(patterns))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_xlabel("patterns")
        axes.set_title(goal, fontsize="medium")
        axes.grid(alpha=0.25)
    axes_of[0].set_ylabel("epochs of backpropagation / of PERAL\n(0.02: PERAL never arrives)")
    handles, labels = axes_of[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"Ultrasound scene, from the hand-over on: medians of {starts} starts")
    return figure


def training_curves_picture(
    curves: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]], solved: Mapping[str, float]
) -> Figure:
    """Costs of trainings epoch by epoch, a panel per machine and a line per route.

    **Arguments**

    - `curves`: by machine and route, the cost before every epoch and the rule that learnt.
    - `solved`: the direct solve's cost, by machine.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(10.0, 4.2)
    for axes, (machine, routes) in zip(
        figure.subplots(1, len(curves), squeeze=False)[0], curves.items(), strict=True
    ):
        for i, (route, (cost, rule)) in enumerate(routes.items()):
            epochs = np.arange(1, len(cost) + 1)
            axes.plot(epochs, cost, color=COLOURS[i], ls=STYLES[i], lw=1.6, label=route)
            peral = rule == 1
            if peral.any():
                label = "epochs of PERAL"
                axes.plot(epochs[peral], cost[peral], ".", color=COLOURS[2], ms=2.5, label=label)
        axes.axhline(solved[machine], color=QUIET, ls=":", lw=1.2, label="direct solve")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("epochs")
        axes.set_title(machine)
        axes.grid(alpha=0.25)
    figure.axes[0].set_ylabel("half the summed squared errors [(N m)²]")
    figure.axes[0].legend(frameon=False, loc="upper right")
    return figure


def errors_picture(
    errors: Mapping[str, Float[np.ndarray, " machines"]], ratio: Float[np.ndarray, " machines"]
) -> Figure:
    """Distributions of ε over machines, and how near the training comes to the direct solve.

    **Arguments**

    - `errors`: ε of each machine by method [N m].
    - `ratio`: of the trained network's ε to the solved one's.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(10.0, 4.2)
    left, right = figure.subplots(1, 2)
    for i, (name, values) in enumerate(errors.items()):
        left.ecdf(values, label=name, color=COLOURS[i], ls=STYLES[i % len(STYLES)], lw=1.8)
    left.set_xscale("log")
    readable_decades(left)
    left.set_xlabel("ε on the comparison recording [N m]")
    left.set_ylabel("share of machines below")
    left.set_title(f"{len(ratio)} machines", fontsize="medium")
    right.hist(ratio, bins=_BINS, color=COLOURS[0])
    right.axvline(1.0, color=QUIET, lw=1.0)
    right.set_xlabel("ε trained over ε solved")
    right.set_ylabel("machines")
    right.set_title("training beside the direct solve", fontsize="medium")
    for axes in (left, right):
        axes.grid(alpha=0.25)
    left.legend(frameon=False, loc="lower right")
    return figure

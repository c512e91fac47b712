"""Pictures of the study of classes."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from scripts.studies.figures import COLOURS, QUIET, new_figure, readable_decades
from scripts.studies.peral_classes.results import (
    BACKPROPAGATION,
    GOALS,
    median_of,
    seconds_by_switch,
)
from scripts.studies.peral_classes.tables import MIDDLE, Results


MARKERS = "os^Dv"


def pictures(results: Results) -> dict[str, Figure]:
    """Return each picture that has results, by name of its file: hard limiters have no slope,
    and PERAL does not train every class."""
    figures: dict[str, Figure] = {}
    if results.compared:
        figures["switch.png"] = switch_picture(results)
    if results.trained:
        figures["time.png"] = time_picture(results)
    return figures


def switch_picture(results: Results) -> Figure:
    """Time to a goal by the epoch of the switch to PERAL, over that of backpropagation alone.

    A panel for each class that PERAL trains, one at least; a line for each noise, which ends where
    most seeds no longer arrive.
    """
    names = list(dict.fromkeys(name for name, _ in results.compared))
    noises = list(dict.fromkeys(noise for _, noise in results.compared))
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = new_figure(3.4 * columns + 0.4, 2.7 * rows + 0.8)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, name in zip(panels, names, strict=False):
        for i, noise in enumerate(noises):
            if (name, noise) not in results.compared:
                continue
            row = results.rules[name, noise]
            alone, switched = seconds_by_switch(row, MIDDLE)
            with np.errstate(invalid="ignore"):
                ratio = np.where(np.isinf(alone)[:, None], np.nan, switched / alone[:, None])
            medians = np.array([median_of(column) for column in ratio.T])
            shown = np.where(np.isfinite(medians), medians, np.nan)
            axes.plot(
                np.maximum(row["switches"], 1), shown, color=COLOURS[i % len(COLOURS)],
                marker=MARKERS[i % len(MARKERS)], ms=4, lw=1.2, label=f"noise {noise:.0%}",
            )  # fmt: skip
        axes.axhline(1.0, color=QUIET, lw=1.0, zorder=0.5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        readable_decades(axes, (1.0,))
        plain = FuncFormatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_major_formatter(plain)
        axes.yaxis.set_minor_formatter(plain)
        axes.set_title(name, fontsize="medium")
        axes.grid(alpha=0.25)
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(names) - columns) : len(names)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("switch after [epochs] (1: at once)")
    for axes in panels[::columns]:
        axes.set_ylabel("time / without a switch")
    # Not every class has results for every noise.
    lines = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(lines.values()), list(lines), loc="outside lower center", ncols=len(lines),
        frameon=False,
    )  # fmt: skip
    figure.suptitle(f"Backpropagation, then PERAL: time to an excess error of {GOALS[MIDDLE]:.0%}")
    return figure


def time_picture(results: Results) -> Figure:
    """Time to a goal by method and class, of classes that are trained, at the middle noise."""
    noises = list(dict.fromkeys(noise for _, noise in results.trained))
    noise = noises[len(noises) // 2]
    cases = [case for case in results.trained if case[1] == noise]
    by_case = [results.seconds(case, MIDDLE) for case in cases]
    methods = list(dict.fromkeys(method for row in by_case for method in row))
    figure = new_figure(9.0, 0.52 * len(cases) + 2.2)
    axes = figure.subplots()
    for i, method in enumerate(methods):
        values = np.array([median_of(row.get(method, [np.nan])) for row in by_case])
        height = np.arange(len(cases)) + 0.07 * (i - (len(methods) - 1) / 2)
        arrived = np.isfinite(values)
        axes.plot(
            1e3 * values[arrived], height[arrived], ls="", color=COLOURS[i % len(COLOURS)],
            marker="os^DvPX*p"[i % 9], ms=7 if method == BACKPROPAGATION else 6, label=method,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yticks(range(len(cases)), [name for name, _ in cases])
    axes.invert_yaxis()
    axes.set_xlabel(f"time to an excess error of {GOALS[MIDDLE]:.0%} [ms]")
    axes.set_title(
        f"Medians over seeds, noise {noise:.0%}; no mark: half of the seeds never arrive"
    )
    axes.grid(alpha=0.25)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    return figure

"""Picture of the static friction study."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, new_figure


_MARKERS = ("o", "s", "^", "D", "v")
_WITHIN = 1.96  # standard errors of a 95 % interval
_SPREAD = 0.7  # of the distance between joints, for the points of one joint


def static_friction_picture(
    rows: Sequence[Mapping[str, Any]], methods: Sequence[str], joints: int, *, title: str
) -> Figure:
    """Torque errors of the methods, and their static friction beside the true one.

    On the left ε on the comparison recording, a point for each seed, and the floor that true
    coefficients without static friction leave. In the middle and on the right magnitudes and slopes
    over the true ones with their 95 % intervals, joint by joint.

    **Arguments**

    - `rows`: of the study.
    - `methods`: those to draw, from left to right.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(11.5, 4.4)
    left, middle, right = figure.subplots(1, 3)
    for i, method in enumerate(methods):
        epsilon = [row["epsilon"] for row in rows if row["method"] == method]
        left.plot(np.full(len(epsilon), i), epsilon, _MARKERS[i % len(_MARKERS)], ms=6,
                  color=COLOURS[i % len(COLOURS)], label=method)  # fmt: skip
    floor = float(np.mean([row["floor"] for row in rows]))
    left.axhline(floor, color=QUIET, ls="--", lw=1.2, label="floor: true, without static friction")
    left.set_xticks([])
    left.set_xlim(-0.7, len(methods) - 0.3)
    left.set_yscale("log")
    left.set_ylabel("ε [N m]")
    left.set_title("comparison trajectory", fontsize="medium")
    for axes, quantity in ((middle, "magnitude"), (right, "slope")):
        _ratios(axes, rows, methods, joints, quantity)
    for axes in (left, middle, right):
        axes.grid(alpha=0.25, axis="y")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(title)
    return figure


def _ratios(
    axes: Axes,
    rows: Sequence[Mapping[str, Any]],
    methods: Sequence[str],
    joints: int,
    quantity: str,
) -> None:
    """Estimates over the truth, the points of a joint side by side."""
    axes.axhline(1.0, color=QUIET, lw=1.0, zorder=0.5)
    for i, method in enumerate(methods):
        of_method = [row for row in rows if row["method"] == method]
        for number, row in enumerate(of_method):
            ratio, error = (
                np.array([row[f"{quantity} {joint} {name}"] for joint in range(1, joints + 1)])
                for name in ("over truth", "error")
            )
            lane = (i + (number + 0.5) / len(of_method)) / len(methods) - 0.5
            axes.errorbar(
                np.arange(1, joints + 1) + _SPREAD * lane, ratio,
                yerr=_WITHIN * np.where(np.isfinite(error), error, 0.0),
                color=COLOURS[i % len(COLOURS)], marker=_MARKERS[i % len(_MARKERS)],
                ms=4, ls="none", elinewidth=1.0,
            )  # fmt: skip
    axes.set_yscale("symlog", linthresh=2.0)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_xticks(range(1, joints + 1))
    axes.set_xlabel("joint")
    axes.set_title(f"{quantity} over truth, 95 % intervals", fontsize="medium")

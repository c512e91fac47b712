"""Pictures of the control study."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, MEASURED, QUIET, STYLES, new_figure, readable_decades


# Within the row of a controller, of height 1, its coefficient sets share this much.
_SHARE = 0.8


def control_error_picture(
    panels: Mapping[str, Mapping[str, Mapping[str, Float[np.ndarray, " seeds"]]]],
    *,
    columns: int,
    quantity: str,
    title: str | None = None,
) -> Figure:
    """Errors of controllers with several coefficient sets, on several motions.

    A panel for each motion, a row for each controller, and in it a lane for each coefficient set: a
    dot for every seed and a bar at their median, on one logarithmic axis for all panels. A
    controller without a model has the set `"none"`, drawn in grey.

    **Arguments**

    - `panels`: errors (seeds,) of each coefficient set of each controller of each motion.
    - `columns`: panels side by side.
    - `quantity`: of the errors, with its unit.

    **Returns** a matplotlib figure.
    """
    controllers = list(dict.fromkeys(name for panel in panels.values() for name in panel))
    sets = list(
        dict.fromkeys(name for panel in panels.values() for row in panel.values() for name in row)
    )
    coloured = [name for name in sets if name != "none"]
    lines = -(-len(panels) // columns)
    figure = new_figure(1.6 + 3.2 * columns, 1.0 + lines * (0.6 + 0.42 * len(controllers)))
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    drawn = set[str]()
    for axes, (name, panel) in zip(grid.flat, panels.items(), strict=False):
        for row, controller in enumerate(controllers):
            for coefficients, errors in panel.get(controller, {}).items():
                height, colour = float(row), QUIET
                label = None
                if coefficients in coloured:
                    lane = coloured.index(coefficients)
                    height += _SHARE * ((lane + 0.5) / len(coloured) - 0.5)
                    colour = COLOURS[lane % len(COLOURS)]
                    label = None if coefficients in drawn else coefficients
                    drawn.add(coefficients)
                axes.plot(
                    errors, np.full(errors.size, height), ".", color=colour, ms=3.5, alpha=0.5,
                    mew=0.0,
                )  # fmt: skip
                axes.plot(
                    [np.median(errors)], [height], "|", color=colour, ms=8, mew=2.0, label=label
                )
        axes.set_title(name, fontsize="medium")
        axes.set_xscale("log")
        axes.set_ylim(len(controllers) - 0.5, -0.5)
        axes.set_yticks(range(len(controllers)), controllers)
        axes.tick_params(axis="y", length=0)
        axes.set_axisbelow(True)
        axes.grid(axis="x", alpha=0.3)
        for row in range(0, len(controllers), 2):
            axes.axhspan(row - 0.5, row + 0.5, color="0.96", lw=0, zorder=0)
    readable_decades(grid[0, 0])
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel(quantity)
    if title:
        figure.suptitle(title)
    handles = [h for axes in grid.flat for h in axes.get_legend_handles_labels()[0]]
    labels = [str(handle.get_label()) for handle in handles]
    if handles:
        across = min(len(labels), 2 + columns)
        figure.legend(handles, labels, loc="outside lower center", ncols=across, frameon=False)
    return figure


def traced_path_picture(
    asked: Float[np.ndarray, "samples 2"],
    errors: Mapping[str, Float[np.ndarray, "samples 2"]],
    *,
    magnified: float,
    title: str | None = None,
) -> Figure:
    """A path in its plane and the hand's path, its errors magnified.

    **Arguments**

    - `asked`: (samples, 2) the path in coordinates of its plane [mm].
    - `errors`: (samples, 2) of the hand in the plane, by controller [mm].
    - `magnified`: how many times larger errors are drawn.

    **Returns** a matplotlib figure with a panel for each controller, the path in grey. Panels have
    one scale.
    """
    columns = 2 if len(errors) > 1 else 1
    lines = -(-len(errors) // columns)
    figure = new_figure(3.4 * columns + 0.4, 3.5 * lines + 0.5)
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (name, error), colour in zip(
        grid.flat, errors.items(), (COLOURS * len(errors))[: len(errors)], strict=False
    ):
        drawn = asked + magnified * error
        axes.plot(*asked.T, color=MEASURED, lw=3.0)
        axes.plot(*drawn.T, color=colour, lw=1.3)
        axes.plot(*drawn[:1].T, "o", color=colour, ms=4)
        size = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        axes.set_title(f"{name}: {size:.2f} mm rms in the plane", fontsize="medium")
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)
    for axes in grid.flat[len(errors) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("in the plane [mm]")
    for axes in grid[-1]:
        axes.set_xlabel("in the plane [mm]")
    note = f"departure from the path (grey) drawn {magnified:g} times"
    figure.suptitle(f"{title}\n{note}" if title else note)
    return figure


def joint_error_picture(
    time: Float[np.ndarray, " samples"],
    errors: Mapping[str, Float[np.ndarray, "samples joints"]],
    *,
    title: str | None = None,
    unit: str = "mrad",
) -> Figure:
    """Errors of every joint over time, one line for each controller.

    **Arguments**

    - `time`: (samples,) [s].
    - `errors`: (samples, joints) by controller.
    - `unit`: of the errors.

    **Returns** a matplotlib figure with a panel for each joint.
    """
    joints = next(iter(errors.values())).shape[1]
    columns = 2 if joints > 1 else 1
    lines = -(-joints // columns)
    figure = new_figure(4.4 * columns, 1.0 + 1.7 * lines)
    grid = figure.subplots(lines, columns, sharex=True, squeeze=False)
    for joint, axes in enumerate(grid.flat):
        if joint >= joints:
            axes.set_visible(False)
            continue
        axes.axhline(0.0, color=QUIET, lw=0.8, zorder=0.5)
        for i, (name, error) in enumerate(errors.items()):
            colour, style = COLOURS[i % len(COLOURS)], STYLES[i % len(STYLES)]
            axes.plot(time, error[:, joint], color=colour, ls=style, lw=1.3, label=name)
        axes.set_title(f"joint {joint + 1}", fontsize="medium")
        axes.set_ylabel(f"error [{unit}]")
        axes.grid(alpha=0.25)
        axes.margins(x=0.0)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    if title:
        figure.suptitle(title)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure

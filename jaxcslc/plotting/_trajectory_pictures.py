from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ._look import COLOURS, MEASURED, QUIET, legend_below, new_figure


if TYPE_CHECKING:
    from matplotlib.figure import Figure


def motion_picture(
    time: Float[np.ndarray, " samples"],
    position: Float[np.ndarray, " samples"],
    velocity: Float[np.ndarray, " samples"],
    acceleration: Float[np.ndarray, " samples"],
    *,
    title: str | None = None,
    unit: str = "rad",
) -> "Figure":
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
    for axes, colour, (name, values, own_unit, centre) in zip(
        rows, COLOURS, profiles, strict=False
    ):
        axes.axhline(centre, color=MEASURED, lw=1.0, zorder=0.5)
        axes.plot(time, values, color=colour, lw=1.5)
        axes.set_ylabel(f"{name}\n[{own_unit}]")
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
    title: str | None = None,
    unit: str = "N m",
) -> "Figure":
    """One joint's torque where it turns round (Fig. 7.6-4).

    Static friction, which the model does not have, shows as ramps of the error on both sides of
    the instant of zero velocity.

    **Arguments**

    - `time`: (samples,) of the stretch [s].
    - `measured`: (samples,) the torque that the drive was asked for: a line.
    - `predicted`: (samples,) by the network: dots.
    - `reversal`: when the estimated velocity is zero [s].
    - `true_reversal`: the same of a machine whose truth is known.

    **Returns** a matplotlib figure. Below the torques it shows their difference, which is what
    the thesis reads its thresholds from.
    """
    figure = new_figure(6.0, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    upper.plot(time, measured, color=COLOURS[1], lw=1.5, label="measured")
    upper.plot(time, predicted, ".", color=COLOURS[0], ms=4.5, label="predicted")
    lower.axhline(0.0, color=MEASURED, lw=1.0, zorder=0.5)
    lower.plot(time, measured - predicted, color=QUIET, lw=1.2)
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
    legend_below(upper, columns=2 if true_reversal is not None else 3)
    return figure

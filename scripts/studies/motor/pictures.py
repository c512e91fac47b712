"""Pictures of a motor's response (Figs. 7.2-1 and 7.2-2)."""

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, figure_of, legend_below, single_axes


def motor_curve_picture(
    demanded: Float[np.ndarray, " samples"],
    torque: Float[np.ndarray, " samples"],
    *,
    limit: float,
    title: str | None = None,
    unit: str = "N m",
) -> Figure:
    """The response curve of a motor and its limit of linearity (Fig. 7.2-1).

    **Arguments**

    - `demanded`: (samples,) ascending; power as the torque that a linear motor would deliver.
    - `torque`: (samples,) that it delivers.
    - `limit`: of linearity, in demanded torque.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    axes.plot(demanded, demanded, color=QUIET, ls="--", lw=1.0, label="linear motor")
    axes.plot(demanded, torque, color=COLOURS[1], lw=2.0, label="motor")
    axes.axvline(limit, color=COLOURS[0], ls=":", lw=1.5)
    axes.annotate(
        f"limit of linearity\n{limit:.3g} {unit}",
        (limit, 0.06),
        (8, 0),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        va="bottom",
    )
    axes.set_xlabel(f"demanded torque [{unit}]")
    axes.set_ylabel(f"torque delivered [{unit}]")
    axes.margins(x=0.0)
    axes.set_ylim(bottom=0.0)
    legend_below(axes)
    return figure_of(axes)


def motor_response_picture(
    mass: Float[np.ndarray, " measurements"],
    torque: Float[np.ndarray, " measurements"],
    *,
    title: str | None = None,
    unit: str = "N m",
) -> Figure:
    """Mean torque of a joint against the mass that hangs from it (Fig. 7.2-2).

    The line is the least-squares fit to all measurements but those with the heaviest mass: a
    motor beyond its limit of linearity shows by a heaviest point above the line (7.2.3).

    **Arguments**

    - `mass`: (measurements,) suspended [kg].
    - `torque`: (measurements,) the demand's mean over whole oscillations.

    **Returns** a matplotlib figure. How far above the line the heaviest point lies is written
    beside it.

    **Raises**

    - `ValueError`: with fewer than two different masses below the heaviest.
    """
    heaviest = mass == np.max(mass)
    if np.unique(mass[~heaviest]).size < 2:
        raise ValueError(
            f"{np.unique(mass).size} different masses; expected three or more, to draw a line"
            " through all but the heaviest"
        )
    slope, offset = np.polyfit(mass[~heaviest], torque[~heaviest], 1)
    axes = single_axes(title)
    ends = np.array([0.0, 1.04 * np.max(mass)])
    axes.plot(
        ends,
        offset + slope * ends,
        color=COLOURS[1],
        lw=1.2,
        label="line through all but the heaviest",
    )
    axes.plot(mass, torque, "x", color=COLOURS[0], ms=8, mew=1.8, label="measurement")
    off = float(np.mean(torque[heaviest] - offset - slope * mass[heaviest]))
    axes.annotate(
        f"{off:+.2g} {unit} from the line",
        (float(np.max(mass)), float(np.mean(torque[heaviest]))),
        (-14, 0),
        textcoords="offset points",
        ha="right",
        va="center",
    )
    axes.set_xlabel("suspended mass [kg]")
    axes.set_ylabel(f"mean torque [{unit}]")
    legend_below(axes)
    return figure_of(axes)

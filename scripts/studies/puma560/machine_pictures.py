"""Pictures of friction and backlash (Figs. 2.5-1 and 2.5-3)."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, cross_hair, figure_of, legend_below, single_axes


def friction_picture(
    velocity: Float[np.ndarray, " samples"],
    friction: Float[np.ndarray, " samples"],
    *,
    viscous: float,
    dry: float,
    static: float,
    title: str | None = None,
    units: tuple[str, str] = ("rad/s", "N m"),
) -> Figure:
    """The friction profile of a joint and its three parts (Fig. 2.5-1, Eqn. 2.5-4).

    **Arguments**

    - `velocity`: (samples,) ascending; where it changes sign the curve is broken, as friction
      is.
    - `friction`: (samples,) at those velocities.
    - `viscous`, `dry`, `static`: k^v, the slope; k^d, where the slope meets the axis; k^s, where
      the profile does. They are drawn as a dashed line and as marks.
    - `units`: of velocity and friction.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title)
    cross_hair(axes)
    start = int(np.searchsorted(velocity, 0.0))
    axes.plot(
        np.insert(velocity, start, 0.0),
        np.insert(np.where(velocity == 0.0, np.nan, friction), start, np.nan),
        color=COLOURS[1],
        lw=2.0,
        label="friction",
    )
    fastest = float(np.max(np.abs(velocity)))
    for sign in (-1.0, 1.0):
        axes.plot(
            [0.0, sign * fastest],
            [sign * dry, sign * (dry + viscous * fastest)],
            color=COLOURS[0],
            ls="--",
            lw=1.2,
            label="viscous and dry friction" if sign > 0 else None,
        )
        axes.plot([0.0, 0.0], [sign * dry, sign * static], "o", color=QUIET, ms=4, zorder=3)
    # Words go to the upper left and the lower right, where friction never is.
    for value, symbol, side, shift in ((static, "s", "bottom", 1), (dry, "d", "top", -1)):
        axes.annotate(
            f"$k^{symbol}$ = {value:.3g} {units[1]}",
            (0.0, value),
            (-10, shift),
            textcoords="offset points",
            ha="right",
            va=side,
        )
    per_velocity = "/".join(reversed(units[0].split("/")))  # s/rad
    _mark_slope(axes, fastest, viscous, dry, f"{units[1]} {per_velocity}")
    axes.set_xlabel(f"velocity [{units[0]}]")
    axes.set_ylabel(f"friction [{units[1]}]")
    legend_below(axes)
    return figure_of(axes)


def _mark_slope(axes: Axes, fastest: float, viscous: float, dry: float, unit: str) -> None:
    """The triangle under a straight line that says how steep it is."""
    left, right = 0.55 * fastest, 0.85 * fastest
    low, high = dry + viscous * left, dry + viscous * right
    axes.plot([left, right, right], [low, low, high], color=QUIET, lw=0.9)
    axes.annotate(
        f"slope $k^v$ = {viscous:.3g} {unit}",
        (0.5 * (left + right), low),
        (0.97, 0.4),
        textcoords="axes fraction",
        ha="right",
        va="top",
        arrowprops={"arrowstyle": "-", "color": QUIET, "lw": 0.8, "shrinkB": 0},
    )


def hysteresis_picture(
    rotor: Float[np.ndarray, " samples"],
    link: Float[np.ndarray, " samples"],
    *,
    backlash: float | None = None,
    arrows: int = 8,
    title: str | None = None,
    unit: str = "mrad",
) -> Figure:
    """The loop that backlash makes of a link's position against its rotor's (Fig. 2.5-3).

    **Arguments**

    - `rotor`, `link`: (samples,) positions in the order of time, both at the joint, that is, the
      rotor's divided by the gear ratio.
    - `backlash`: width of the dead band, marked where given.
    - `arrows`: how many show the direction round the loop, at equal distances along it.
    - `unit`: of all positions.

    **Returns** a matplotlib figure.
    """
    axes = single_axes(title, width=5.4, height=4.8)
    (line,) = axes.plot(rotor, link, color=COLOURS[1], lw=1.6)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(rotor), np.diff(link)))])
    step = length[-1] / 200
    for position in length[-1] * (np.arange(arrows) + 0.5) / arrows:
        ends = [position, position + step]
        x, y = np.interp(ends, length, rotor), np.interp(ends, length, link)
        axes.annotate(
            "",
            (x[1], y[1]),
            (x[0], y[0]),
            arrowprops={
                "arrowstyle": "-|>",
                "color": line.get_color(),
                "mutation_scale": 16,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )
    if backlash is not None:
        _mark_width(axes, rotor, link, backlash, unit)
    axes.set_xlabel(f"rotor position, at the joint [{unit}]")
    axes.set_ylabel(f"link position [{unit}]")
    return figure_of(axes)


def _mark_width(
    axes: Axes,
    rotor: Float[np.ndarray, " samples"],
    link: Float[np.ndarray, " samples"],
    backlash: float,
    unit: str,
) -> None:
    """A double arrow across the loop, half way up, as wide as the backlash."""
    height = 0.5 * (np.max(link) + np.min(link))
    centre = 0.5 * (np.max(rotor) + np.min(rotor))
    ends = (centre - 0.5 * backlash, centre + 0.5 * backlash)
    arrow = {"arrowstyle": "<->", "color": QUIET, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (ends[0], height), (ends[1], height), arrowprops=arrow)
    axes.annotate(
        "$b$", (centre, height), (0, 3), textcoords="offset points", ha="center", va="bottom"
    )
    # The loop leaves this corner free, however narrow it is.
    axes.text(
        0.04, 0.95, f"backlash $b$ = {backlash:.3g} {unit}", transform=axes.transAxes, va="top"
    )

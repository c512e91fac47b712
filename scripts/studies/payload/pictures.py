"""Pictures of the payload study."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, STYLES, new_figure


_SIGMAS = 1.96  # of a 95 % band
_CARRIED = "0.9"
_LABEL = 1.7  # width of a name in a legend [inches]
# How far beyond the truth the axes reach; wide bands are cut off.
_MASS_MARGIN, _ERROR_MARGIN, _CENTRE_MARGIN = 0.25, 3.0, 0.05  # parts and 0.1 kg; %; m


class PayloadCurve(NamedTuple):
    """The estimates of a payload over time, and the true payload."""

    time: Float[np.ndarray, " samples"]
    """[s]."""

    mass: Float[np.ndarray, " samples"]
    """The estimate [kg]."""

    mass_error: Float[np.ndarray, " samples"]
    """Its standard error [kg]."""

    centre: Float[np.ndarray, "samples 3"]
    """Of gravity, the estimate [m]."""

    centre_error: Float[np.ndarray, "samples 3"]
    """Its standard error [m]; may be infinite."""

    carrying: Bool[np.ndarray, " samples"]
    """Whether a payload was detected."""

    true_mass: float
    """[kg]."""

    true_centre: Float[np.ndarray, "3"]
    """[m]."""

    picked: float
    """When it was picked up [s]."""

    placed: float
    """When it was put down [s]."""

    detected: tuple[float, ...] = ()
    """When picking up or putting down was detected [s]."""


class Spread(NamedTuple):
    """Quantiles over several runs, (samples,) each."""

    low: Float[np.ndarray, " samples"]
    middle: Float[np.ndarray, " samples"]
    high: Float[np.ndarray, " samples"]


def payload_picture(curves: Mapping[str, PayloadCurve], *, title: str | None = None) -> Figure:
    """Estimates of a payload's mass and centre of gravity with their 95 % bands, over time.

    A column for each payload: the mass, its error while a payload is carried and detected, and the
    centre's three coordinates while one is detected. The payload is carried in the grey stretch,
    dotted lines are at the detection of picking up and putting down.

    **Arguments**

    - `curves`: by the name of the payload.

    **Returns** a matplotlib figure.

    **Raises**

    - `ValueError`: for no curves.
    """
    if not curves:
        raise ValueError("no curves; expected one or more")
    figure = new_figure(1.6 + 2.7 * len(curves), 7.0)
    grid = figure.subplots(3, len(curves), sharex=True, squeeze=False)
    for column, (name, curve) in zip(grid.T, curves.items(), strict=True):
        for axes in column:
            axes.axvspan(curve.picked, curve.placed, color=_CARRIED, lw=0, label="carried")
            for time in curve.detected:
                axes.axvline(time, color=QUIET, ls=":", lw=1.2, label="detected")
            axes.grid(alpha=0.25)
            axes.margins(x=0.01)
        column[0].set_title(name)
        column[-1].set_xlabel("time [s]")
        _columns(column, curve)
    for axes, label in zip(
        grid[:, 0], ("mass [kg]", "error of the mass [%]", "centre of gravity [mm]"), strict=True
    ):
        axes.set_ylabel(label)
    _finish(figure, title)
    return figure


def _columns(column: np.ndarray, curve: PayloadCurve) -> None:
    """A payload's three panels."""
    mass, off, centre = column
    inside = (curve.time >= curve.picked) & (curve.time < curve.placed)
    truth = np.where(inside, curve.true_mass, 0.0)
    mass.step(curve.time, truth, where="post", color=QUIET, lw=1.0, label="truth")
    _band(mass, curve.time, curve.mass, curve.mass_error, 0, "mass")
    margin = _MASS_MARGIN * curve.true_mass + 0.1
    mass.set_ylim(-margin, curve.true_mass + margin)
    off.set_ylim(-_ERROR_MARGIN, _ERROR_MARGIN)
    off.axhline(0.0, color=QUIET, lw=1.0)
    low, high = np.min(curve.true_centre), np.max(curve.true_centre)
    centre.set_ylim(1e3 * (low - _CENTRE_MARGIN), 1e3 * (high + _CENTRE_MARGIN))
    if not curve.true_mass:
        off.text(0.5, 0.6, "no payload", transform=off.transAxes, ha="center")
    else:
        percent = 100.0 / curve.true_mass * np.where(inside & curve.carrying, 1.0, np.nan)
        error = percent * (curve.mass - curve.true_mass)
        _band(off, curve.time, error, percent * curve.mass_error, 0, "mass")
    shown = np.where(curve.carrying, 1e3, np.nan)
    for axis in range(3):
        if curve.true_mass:
            true = [1e3 * float(curve.true_centre[axis])] * 2
            centre.plot([curve.picked, curve.placed], true, color=QUIET, lw=1.0)
        value, error = shown * curve.centre[:, axis], 1e3 * curve.centre_error[:, axis]
        _band(centre, curve.time, value, error, 1 + axis, f"{'xyz'[axis]} of the centre")


def hand_error_picture(
    time: Float[np.ndarray, " samples"],
    errors: Mapping[str, Mapping[str, Spread]],
    *,
    picked: float,
    placed: float,
    title: str | None = None,
) -> Figure:
    """Distance of the hand from its reference under several methods.

    Lines are medians over the runs, bands from the lower to the higher quantile. A column for each
    payload; the axes of errors are logarithmic.

    **Arguments**

    - `time`: (samples,) [s].
    - `errors`: by the names of the payload and of the method [mm].
    - `picked`, `placed`: when the payload was picked up and put down [s].

    **Returns** a matplotlib figure.

    **Raises**

    - `ValueError`: for no errors.
    """
    if not errors:
        raise ValueError("no errors; expected those of one payload or more")
    figure = new_figure(1.2 + 3.0 * len(errors), 3.6)
    grid = figure.subplots(1, len(errors), sharey=True, squeeze=False)
    for axes, (name, methods) in zip(grid[0], errors.items(), strict=True):
        axes.axvspan(picked, placed, color=_CARRIED, lw=0, label="carried")
        for number, (method, spread) in enumerate(methods.items()):
            look: dict[str, Any] = {"color": COLOURS[number % len(COLOURS)]}
            axes.fill_between(time, spread.low, spread.high, alpha=0.25, lw=0, **look)
            style = STYLES[number % len(STYLES)]
            axes.plot(time, spread.middle, ls=style, lw=1.2, label=method, **look)
        axes.set_yscale("log")
        axes.set_title(name)
        axes.set_xlabel("time [s]")
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    grid[0, 0].set_ylabel("error of the hand [mm]")
    _finish(figure, title)
    return figure


def _band(
    axes: Axes, time: np.ndarray, value: np.ndarray, error: np.ndarray, look: int, label: str
) -> None:
    half = _SIGMAS * np.where(np.isfinite(error), error, np.nan)
    axes.fill_between(time, value - half, value + half, color=COLOURS[look], alpha=0.3, lw=0)
    axes.plot(time, value, color=COLOURS[look], ls=STYLES[look], lw=1.3, label=label)


def _finish(figure: Figure, title: str | None) -> None:
    """A title, and a legend below with each label once."""
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside lower center",
        ncols=min(len(handles), int(figure.get_figwidth() / _LABEL)),
        frameon=False,
    )
    if title:
        figure.suptitle(title)

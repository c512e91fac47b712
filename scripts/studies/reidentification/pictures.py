"""Picture of the study of re-identified friction."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, figure_of, legend_below, single_axes


def reidentification_picture(
    lengths: Sequence[float],
    errors: Mapping[str, Float[np.ndarray, "lengths seeds"]],
    *,
    floor: float | None = None,
    quantiles: tuple[float, float] = (0.1, 0.9),
    title: str | None = None,
    quantity: str = "mean error cost ε [N m]",
) -> Figure:
    """Torque errors of coefficients that were identified from recordings of several lengths.

    Lines are medians over the seeds, bands the range between two quantiles.

    **Arguments**

    - `lengths`: of the recordings [s].
    - `errors`: (lengths, seeds) by the name of the method, positive; NaN where a method failed.
    - `floor`: the error of the true coefficients.
    - `quantiles`: lower and upper edge of the bands.
    - `quantity`: of the errors, with its unit.

    **Returns** a matplotlib figure; both axes are logarithmic.

    **Raises**

    - `ValueError`: for another number of rows than of lengths.
    """
    axes = single_axes(title, width=6.4, height=4.4)
    marks = "os^vDP"
    for number, (name, values) in enumerate(errors.items()):
        if len(values) != len(lengths):
            raise ValueError(f"{name}: expected {len(lengths)} rows, got {len(values)}")
        finite = np.any(np.isfinite(values), axis=1)
        x, drawn = np.asarray(lengths)[finite], values[finite]
        low, middle, high = np.nanquantile(drawn, [quantiles[0], 0.5, quantiles[1]], axis=1)
        colour = COLOURS[number % len(COLOURS)]
        axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(x, middle, color=colour, marker=marks[number % len(marks)], ms=4.5, label=name)
    if floor is not None:
        axes.axhline(floor, color=QUIET, ls="--", lw=1.0, label="true coefficients")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(list(lengths), [f"{length:g}" for length in lengths])
    axes.minorticks_off()
    axes.set_xlabel("length of the recording [s]")
    axes.set_ylabel(quantity)
    legend_below(axes)
    return figure_of(axes)

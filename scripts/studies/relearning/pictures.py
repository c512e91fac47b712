"""Picture of the relearning study."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from jaxcslc.plotting import COLOURS
from scripts.studies.figures import QUIET, figure_of, legend_below, single_axes


def relearning_picture(
    lengths: Sequence[float],
    errors: Mapping[str, Float[np.ndarray, "lengths seeds"]],
    *,
    floor: float | None = None,
    quantiles: tuple[float, float] = (0.1, 0.9),
    title: str | None = None,
    quantity: str = "mean error cost ε [N m]",
) -> Figure:
    """What is left of the torque error after learning from recordings of several lengths.

    Lines are medians over the seeds, bands the range between two quantiles.

    **Arguments**

    - `lengths`: of the recordings [s].
    - `errors`: (lengths, seeds) by the name of the way, positive; NaN where a way found nothing.
    - `floor`: what the true coefficients leave.
    - `quantiles`: lower and upper edge of the bands.
    - `quantity`: of the errors, with its unit.

    **Returns** a matplotlib figure; both axes are logarithmic.

    **Raises**

    - `ValueError`: for another number of rows than of lengths.
    """
    axes = single_axes(title, width=6.4, height=4.4)
    marks = "os^vDP"
    for place, (name, values) in enumerate(errors.items()):
        if len(values) != len(lengths):
            raise ValueError(f"{name}: expected {len(lengths)} rows, got {len(values)}")
        found = np.any(np.isfinite(values), axis=1)
        at, own = np.asarray(lengths)[found], values[found]
        low, middle, high = np.nanquantile(own, [quantiles[0], 0.5, quantiles[1]], axis=1)
        colour = COLOURS[place % len(COLOURS)]
        axes.fill_between(at, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(at, middle, color=colour, marker=marks[place % len(marks)], ms=4.5, label=name)
    if floor is not None:
        axes.axhline(floor, color=QUIET, ls="--", lw=1.0, label="true coefficients")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(list(lengths), [f"{length:g}" for length in lengths])
    axes.minorticks_off()
    axes.set_xlabel("length of the recording that is learnt from [s]")
    axes.set_ylabel(quantity)
    legend_below(axes)
    return figure_of(axes)

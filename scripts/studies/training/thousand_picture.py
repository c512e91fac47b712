"""Picture of ε over many machines: trained, solved, and the coefficients known beforehand."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from jaxcslc.plotting import COLOURS, STYLES, new_figure
from scripts.studies.figures import QUIET, readable_decades


_BINS = 40


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

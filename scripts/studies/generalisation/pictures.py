"""Picture of the generalisation study."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from scripts.studies.figures import COLOURS, QUIET, new_figure


# A family of networks: numbers of weights, and ε of the training and the comparison recording.
Family = tuple[
    Float[np.ndarray, " sizes"],
    Float[np.ndarray, "sizes seeds"],
    Float[np.ndarray, "sizes seeds"],
]
_MARKERS = ("o", "s", "P", "D", "^", "v")


def generalisation_picture(
    families: Mapping[str, Family],
    references: Mapping[str, Family],
    *,
    title: str | None = None,
    unit: str = "N m",
) -> Figure:
    """Errors of networks of several sizes on training and comparison patterns (4.3).

    One panel for the training patterns and one for the comparison recording, on the same axes.
    Markers are at medians over seeds, bars reach from the lower to the upper quartile.

    **Arguments**

    - `families`: by name, (sizes,) numbers of weights, (sizes, seeds) ε of the training patterns
      and (sizes, seeds) ε of the comparison recording.
    - `references`: drawn in black with a line through the median.
    - `unit`: of ε.

    **Returns** a matplotlib figure.
    """
    figure = new_figure(9.5, 5.2)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    look: dict[str, Any] = {"elinewidth": 1.0, "capsize": 2.0, "lw": 1.0}
    for axes, errors, panel in ((left, 1, "training patterns"), (right, 2, "comparison recording")):
        for i, (name, family) in enumerate(families.items()):
            order = np.argsort(family[0])
            middle, reach = _spread(family[errors][order])
            axes.errorbar(
                family[0][order],
                middle,
                yerr=reach,
                color=COLOURS[i % len(COLOURS)],
                marker=_MARKERS[i % len(_MARKERS)],
                ms=6,
                label=name,
                **look,
            )
        for i, (name, family) in enumerate(references.items()):
            middle, reach = _spread(family[errors])
            for height in middle:
                axes.axhline(float(height), color=QUIET, lw=0.9, ls="--", zorder=0.5)
            axes.errorbar(
                family[0],
                middle,
                yerr=reach,
                color="black",
                marker="*X"[i % 2],
                ms=(13, 8)[i % 2],
                ls="none",
                label=name,
                elinewidth=1.0,
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("number of weights")
        axes.set_title(panel, fontsize="medium")
        axes.grid(alpha=0.25, which="both")
    left.set_ylabel(f"ε [{unit}]")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 4), frameon=False
    )
    if title:
        figure.suptitle(title)
    return figure


def _spread(
    errors: Float[np.ndarray, "sizes seeds"],
) -> tuple[Float[np.ndarray, " sizes"], Float[np.ndarray, "2 sizes"]]:
    """Medians over seeds, and how far the quartiles are from them."""
    low, middle, high = np.quantile(errors, [0.25, 0.5, 0.75], axis=1)
    return middle, np.stack([middle - low, high - middle])

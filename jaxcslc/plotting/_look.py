"""Look of all pictures: colours, line styles, figures without a window, and their files."""

from pathlib import Path
from typing import TYPE_CHECKING

from .._environment import require


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Okabe and Ito's palette, which colour-blind readers can tell apart. Measurements are a broad grey.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours that colour-blind readers can tell apart (Okabe and Ito)."""
STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)))
"""Styles of lines, in the order of the colours."""
MEASURED = "0.65"
"""Grey of measured curves."""


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure in the style of the package's pictures, without a window.

    **Arguments**

    - `width`, `height`: size [inches].

    **Returns** a matplotlib figure.

    >>> figure = new_figure(6.0, 4.0)
    >>> axes = figure.subplots()
    """
    matplotlib = require("matplotlib.figure", "plot")  # takes 0.3 s, and most users do not draw
    return matplotlib.Figure(figsize=(width, height), layout="constrained")


def save_picture(figure: "Figure", path: Path) -> None:
    """Draw a figure into a PNG file."""
    figure.savefig(path, dpi=130)

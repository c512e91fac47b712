"""Look of all pictures of studies, and parts that several share."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from jaxcslc.report import COLOURS as COLOURS


# Styles of lines, in the order of the colours.
STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)))
# Grey of measured curves; of zero lines, limits and their annotations.
MEASURED, QUIET = "0.65", "0.35"


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure in the style of all pictures, without a window; sizes in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def save_picture(figure: Figure, path: Path) -> None:
    """Draw a figure into a PNG file."""
    figure.savefig(path, dpi=130)


def single_axes(title: str | None, *, width: float = 6.0, height: float = 4.0) -> Axes:
    """The axes of a figure with one panel [inches]."""
    axes = new_figure(width, height).subplots()
    axes.grid(alpha=0.25)
    if title:
        axes.set_title(title)
    return axes


def figure_of(axes: Axes) -> Figure:
    """The whole figure that axes are part of."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    return figure


def legend_below(axes: Axes, *, columns: int | None = None) -> None:
    """A legend below the axes, where it covers nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure_of(axes).legend(
        handles, labels, loc="outside lower center", ncols=columns or len(labels), frameon=False
    )


def cross_hair(axes: Axes) -> None:
    """Lines through the origin, behind everything."""
    axes.axhline(0.0, color=QUIET, lw=0.8, zorder=0.5)
    axes.axvline(0.0, color=QUIET, lw=0.8, zorder=0.5)


def readable_decades(axes: Axes, ticks: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Ticks at these multiples of every decade of the horizontal axis, as plain numbers."""
    axes.xaxis.set_major_locator(LogLocator(subs=ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())

from typing import TYPE_CHECKING


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Okabe and Ito's palette, told apart by colour-blind readers; what was measured is a broad grey.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)))
MEASURED = "0.65"
# Zero lines, limits and what annotates them.
QUIET = "0.35"


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure [inches] that no window manager knows of."""
    from matplotlib.figure import Figure  # takes 0.3 s, and most users of the package do not draw

    return Figure(figsize=(width, height), layout="constrained")


def single_axes(title: str | None, *, width: float = 6.0, height: float = 4.0) -> "Axes":
    """The axes of a figure with one picture."""
    axes = new_figure(width, height).subplots()
    axes.grid(alpha=0.25)
    if title:
        axes.set_title(title)
    return axes


def figure_of(axes: "Axes") -> "Figure":
    """The whole figure that axes are part of."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    return figure


def legend_below(axes: "Axes", *, columns: int | None = None) -> None:
    """A legend outside of the picture, where it covers nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure_of(axes).legend(
        handles, labels, loc="outside lower center", ncols=columns or len(labels), frameon=False
    )


def cross_hair(axes: "Axes") -> None:
    """Lines through the origin, behind everything."""
    axes.axhline(0.0, color=QUIET, lw=0.8, zorder=0.5)
    axes.axvline(0.0, color=QUIET, lw=0.8, zorder=0.5)

"""Base of charts: the drawing by plotly and by matplotlib."""

import abc
import base64
import io
from typing import TYPE_CHECKING, Any, ClassVar

from ._blocks import AbstractBlock


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Text in plotly's drawings: that of the page.
FONT = {"family": "system-ui, sans-serif", "size": 13, "color": "#1b1f24"}
GRID = "#e3e6ea"
MASKED = "#dfe7f3"
MEASURED = "#9aa1a9"


class AbstractChart(AbstractBlock):
    """A drawing of data, described once and drawn by plotly or by matplotlib.

    **Attributes**

    - `caption`: below the chart, and its text for those who do not see it.
    """

    kind: ClassVar[str] = "chart"
    caption: str

    @property
    @abc.abstractmethod
    def height(self) -> int:
        """Height of the drawing on a page [pixels]."""

    @property
    def width(self) -> int | None:
        """Greatest width [pixels]; None for that of the page."""
        return None

    @abc.abstractmethod
    def plotly_figure(self) -> dict[str, Any]:
        """`data` and `layout` for plotly.js, as plain data."""

    @abc.abstractmethod
    def figure(self) -> "Figure":
        """The chart as a matplotlib figure."""

    def png(self) -> str:
        """`figure()` as a PNG file in base64, to stand in a page."""
        file = io.BytesIO()
        self.figure().savefig(file, format="png", dpi=110)
        return base64.b64encode(file.getvalue()).decode("ascii")


def base_layout(height: int) -> dict[str, Any]:
    """Return the layout that all plotly drawings have in common."""
    return {
        "height": height,
        "font": FONT,
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "closest",
        "hoverlabel": {"font": {"size": 12}},
        "dragmode": "zoom",
        "modebar": {"orientation": "h", "bgcolor": "rgba(255,255,255,0.7)"},
    }

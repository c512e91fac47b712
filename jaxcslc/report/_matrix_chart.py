"""Chart of a matrix, such as correlations."""

import dataclasses
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from .._environment import require
from ..plotting import COLOURS, new_figure
from ._chart import AbstractChart, base_layout
from ._chart_curves import plain


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_ORANGE, _BLUE = COLOURS[0], COLOURS[1]
_MOST_LABELS = 50  # of 10 pixels each, beside the highest matrix


@dataclasses.dataclass(frozen=True, eq=False)
class MatrixChart(AbstractChart):
    """A square matrix of numbers from -1 to 1, as colours.

    **Attributes**

    - `labels`: of its rows and columns.
    - `values`: row by row; of a symmetric matrix.
    - `caption`: below the chart.

    >>> chart = MatrixChart(("kB1", "kv1"), ((1.0, -0.5), (-0.5, 1.0)), "Correlations")
    >>> chart.plotly_figure()["data"][0]["z"]
    [[1.0, -0.5], [-0.5, 1.0]]
    """

    labels: tuple[str, ...]
    values: Sequence[Sequence[float]]
    caption: str

    @property
    def height(self) -> int:
        return int(np.clip(14 * len(self.labels) + 90, 260, 640))

    @property
    def width(self) -> int | None:
        return self.height + 60

    @property
    def ticks(self) -> range:
        """Rows that have a label: all, or every second and so on where labels would overlap."""
        return range(0, len(self.labels), -(-len(self.labels) // _MOST_LABELS) or 1)

    def plotly_figure(self) -> dict[str, Any]:
        labels = [escape(label) for label in self.labels]
        layout = base_layout(self.height)
        layout["margin"] = {"t": 30, "b": 60, "l": 60, "r": 8}
        # Ticks by number: labels that are equal would otherwise share a row.
        ticks = {
            "tickvals": list(self.ticks),
            "ticktext": [labels[i] for i in self.ticks],
            "showgrid": False,
        }
        small = {"tickfont": {"size": 10}, "zeroline": False}
        layout["xaxis"] = {**ticks, **small, "tickangle": -90}
        layout["yaxis"] = {**ticks, **small, "autorange": "reversed"}
        rows = [plain(row, 3) for row in self.values]
        pairs = [[f"{a}, {b}" for b in labels] for a in labels]
        trace = {
            **{"type": "heatmap", "z": rows, "zmin": -1, "zmax": 1, "text": pairs},
            "hovertemplate": "%{text}: %{z:.2f}<extra></extra>",
            "colorscale": [[0, _BLUE], [0.5, "#ffffff"], [1, _ORANGE]],
            "colorbar": {"thickness": 12, "len": 0.9, "tickvals": [-1, -0.5, 0, 0.5, 1]},
            "xgap": 0.5,
            "ygap": 0.5,
        }
        return {"data": [trace], "layout": layout}

    def figure(self) -> "Figure":
        size = self.height / 75
        figure = new_figure(size + 1.2, size)
        axes = figure.subplots()
        colormap = require("matplotlib.colors", "plot").LinearSegmentedColormap
        colours = colormap.from_list("signed", [_BLUE, "#ffffff", _ORANGE])
        image = axes.imshow(np.asarray(self.values, float), cmap=colours, vmin=-1, vmax=1)
        labels = [self.labels[i] for i in self.ticks]
        axes.set_xticks(self.ticks, labels, rotation=90, fontsize=7, parse_math=False)
        axes.set_yticks(self.ticks, labels, fontsize=7, parse_math=False)
        figure.colorbar(image, ax=axes, shrink=0.8)
        return figure

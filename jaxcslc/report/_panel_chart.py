"""Charts of curves in panels, a panel per joint."""

import dataclasses
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ..plotting import COLOURS, MEASURED as MEASURED_GREY, new_figure
from ._chart import GRID, MASKED, MEASURED, AbstractChart, base_layout
from ._chart_curves import Curve, plain


if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Pixels of the drawing.
_TOP, _BOTTOM, _LEFT, _RIGHT, _GAP = 100, 46, 58, 12, 34
_TITLE = 22  # of a panel; the legend stands above it, and buttons above the legend

_LINES: dict[str, dict[str, Any]] = {
    "measured": {"mode": "lines", "line": {"color": MEASURED, "width": 3}},
    "predicted": {"mode": "lines", "line": {"color": COLOURS[0], "width": 1.3}},
    "residual": {"mode": "lines", "line": {"color": COLOURS[1], "width": 1}},
    "points": {"mode": "markers", "marker": {"color": MEASURED, "size": 3}},
    "fitted": {"mode": "markers", "marker": {"color": COLOURS[0], "size": 3}},
}
_STATIC: dict[str, dict[str, Any]] = {
    "measured": {"color": MEASURED_GREY, "lw": 2.5},
    "predicted": {"color": COLOURS[0], "lw": 1.0},
    "residual": {"color": COLOURS[1], "lw": 0.8},
    "points": {"color": MEASURED_GREY, "ls": "", "marker": ".", "ms": 2},
    "fitted": {"color": COLOURS[0], "ls": "", "marker": ".", "ms": 2},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Panel:
    """Pair of axes of a `PanelChart`.

    **Attributes**

    - `title`: above the panel, with the unit of y.
    - `curves`: in the order in which they are drawn.
    - `shaded`: stretches of x that are shaded.
    - `height`: of the axes [pixels].
    - `limits`: of y; by default those of the curves.

    >>> Panel("joint 1 [N m]", (Curve("measured", (0.0, 1.0), (2.0, 3.0), "measured"),)).range
    (1.95, 3.05)
    """

    title: str
    curves: tuple[Curve, ...]
    shaded: tuple[tuple[float, float], ...] = ()
    height: int = 150
    limits: Sequence[float] | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Range of y: `limits`, or that of the curves and a little more."""
        if self.limits is not None:
            low, high = self.limits
            return low, high
        values = np.concatenate([np.asarray(curve.y, float) for curve in self.curves])
        values = values[np.isfinite(values)]
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
        margin = 0.05 * (high - low) or 1.0
        return low - margin, high + margin


@dataclasses.dataclass(frozen=True, eq=False)
class PanelChart(AbstractChart):
    """Panels below each other over one x, that is zoomed in all of them at once.

    **Attributes**

    - `panels`: from the top.
    - `x_label`: with its unit.
    - `caption`: below the chart.
    - `shading`: what shaded stretches are, for the legend.

    >>> curve = Curve("measured", (0.0, 1.0), (2.0, 3.0), "measured")
    >>> chart = PanelChart((Panel("joint 1 [N m]", (curve,), ((0.2, 0.4),)),), "time [s]", "")
    >>> [trace["name"] for trace in chart.plotly_figure()["data"]]
    ['not fitted', 'measured']
    """

    panels: tuple[Panel, ...]
    x_label: str
    caption: str
    shading: str = "not fitted"

    @property
    def height(self) -> int:
        drawn = sum(panel.height for panel in self.panels)
        return _TOP + _BOTTOM + drawn + _GAP * (len(self.panels) - 1)

    def plotly_figure(self) -> dict[str, Any]:
        layout = base_layout(self.height)
        layout["margin"] = {"t": _TOP, "b": _BOTTOM, "l": _LEFT, "r": _RIGHT}
        layout["annotations"] = []
        data: list[dict[str, Any]] = []
        inner, top = self.height - _TOP - _BOTTOM, 0
        above_title = {"y": 1 + _TITLE / inner, "yanchor": "bottom"}
        # Small, so that three entries fit beside each other on a telephone: more are cut off.
        small = {"orientation": "h", "x": 0, "font": {"size": 11}}
        layout["legend"] = {"itemsizing": "constant", **small, **above_title}
        named: set[str] = set()
        for number, panel in enumerate(self.panels, 1):
            suffix = "" if number == 1 else str(number)
            last = number == len(self.panels)
            high, low = 1 - top / inner, 1 - (top + panel.height) / inner
            layout[f"xaxis{suffix}"] = {
                "anchor": f"y{suffix}",
                "gridcolor": GRID,
                "zeroline": False,
                "showticklabels": last,
                **({} if number == 1 else {"matches": "x"}),
                **({"title": {"text": escape(self.x_label)}} if last else {}),
            }
            layout[f"yaxis{suffix}"] = {
                "anchor": f"x{suffix}",
                "domain": [max(low, 0.0), high],
                "range": plain(panel.range),
                "gridcolor": GRID,
                "zerolinecolor": "#b8bec6",
                "nticks": 5,
            }
            layout["annotations"].append(
                {
                    **{"text": escape(panel.title), "showarrow": False, "xref": "paper"},
                    **{"yref": "paper", "x": 0, "y": high, "xanchor": "left", "yanchor": "bottom"},
                }
            )
            axes = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
            for trace in self._traces(panel):
                # What a panel's title says needs no entry.
                listed = trace["name"] not in named and trace["name"] not in escape(panel.title)
                named.add(trace["name"])
                data.append(trace | axes | {"showlegend": listed})
            top += panel.height + _GAP
        return {"data": data, "layout": layout}

    def _traces(self, panel: Panel) -> list[dict[str, Any]]:
        traces: list[dict[str, Any]] = []
        if panel.shaded:
            bottom, top = plain(panel.range)
            x: list[float | None] = []
            y: list[float | None] = []
            ends = plain(np.ravel(panel.shaded), 8)
            for start, end in zip(ends[::2], ends[1::2], strict=True):
                x += [start, start, end, end, None]
                y += [bottom, top, top, bottom, None]
            shape = {"fill": "toself", "fillcolor": MASKED, "line": {"width": 0}}
            traces.append(
                {
                    **{"type": "scatter", "mode": "lines", "name": escape(self.shading)},
                    **{"x": x, "y": y, "hoverinfo": "skip", "legendgroup": "shading", **shape},
                }
            )
        for curve in panel.curves:
            traces.append(
                {
                    **{
                        "type": "scatter",
                        "name": escape(curve.name),
                        "legendgroup": escape(curve.name),
                    },
                    **{"x": plain(curve.x, 8), "y": plain(curve.y), "connectgaps": False},
                    **_LINES[curve.look],
                }
            )
        return traces

    def figure(self) -> "Figure":
        figure = new_figure(10.0, self.height / 75)
        grid = figure.subplots(
            len(self.panels),
            1,
            sharex=True,
            squeeze=False,
            gridspec_kw={"height_ratios": [panel.height for panel in self.panels]},
        )
        labelled: dict[str, Any] = {}
        for panel, axes in zip(self.panels, grid[:, 0], strict=True):
            self._draw(panel, axes)
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                labelled.setdefault(label, handle)
        grid[-1, 0].set_xlabel(_literal(self.x_label))
        figure.legend(
            list(labelled.values()),
            list(labelled),
            loc="outside upper left",
            ncols=max(len(labelled), 1),
            frameon=False,
        )
        return figure

    def _draw(self, panel: Panel, axes: "Axes") -> None:
        low, high = panel.range
        for i, (start, end) in enumerate(panel.shaded):
            label = _literal(self.shading) if i == 0 else None
            axes.axvspan(start, end, color=MASKED, lw=0, label=label)
        for curve in panel.curves:
            axes.plot(
                np.asarray(curve.x, float),
                np.asarray(curve.y, float),
                label=_literal(curve.name),
                **_STATIC[curve.look],
            )
        axes.set_ylim(low, high)
        axes.set_title(_literal(panel.title), loc="left", fontsize=10)
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)


def _literal(text: str) -> str:
    """Text that matplotlib draws as it is, and does not take for a formula."""
    return text.replace("$", r"\$")

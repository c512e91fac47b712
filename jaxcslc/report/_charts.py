"""Charts of a page, drawn by plotly: curves in panels, matrices, arms; and films, drawn as SVG.

A chart describes its drawing as plotly's `data` and `layout`. The page's script draws it.
"""

import abc
import dataclasses
from collections.abc import Sequence
from html import escape
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float

from ._page import AbstractBlock


# Okabe and Ito's palette, which colour-blind readers can tell apart. Measurements are a broad grey.
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
# Text in drawings: that of the page.
_FONT = {"family": "system-ui, sans-serif", "size": 13, "color": "#1b1f24"}
_GRID, _ZERO, _MASKED, _MEASURED, _ARM = (
    "#e3e6ea",
    "#b8bec6",
    "rgba(110,150,210,0.22)",
    "#9aa1a9",
    "#4b5563",
)
_ORANGE, _BLUE = COLOURS[:2]

# Of a chart of panels [pixels]; a panel's title stands in the gap above it, the legend above the
# first title.
_TOP, _BOTTOM, _LEFT, _RIGHT, _GAP, _TITLE = 64, 46, 58, 12, 34, 22
# Labels of 10 pixels each, beside the highest matrix.
_MOST_LABELS = 50
# Sides of a body's centre at which its number stands, in turn: neighbours' numbers differ.
_SIDES = ("middle right", "middle left", "bottom center", "top right")
# Angles of an ellipsoid's mesh.
_AROUND, _UP = 25, 13
# Of a view of a film [pixels].
_VIEW, _MARGIN = 300, 26
_VIEWS = ((0, 2, "from the side"), (1, 2, "from the front"), (0, 1, "from above"))
# The largest power of ten that is a float exactly.
_EXACT_POWER = 22

CurveLook = Literal["measured", "predicted", "residual", "points", "fitted"]
_LOOKS: dict[CurveLook, dict[str, Any]] = {
    "measured": {"mode": "lines", "line": {"color": _MEASURED, "width": 5}},
    "predicted": {"mode": "lines", "line": {"color": _ORANGE, "width": 1}},
    "residual": {"mode": "lines", "line": {"color": _BLUE, "width": 1}},
    "points": {"mode": "markers", "marker": {"color": _MEASURED, "size": 3}},
    "fitted": {"mode": "markers", "marker": {"color": _ORANGE, "size": 3}},
}


class AbstractChart(AbstractBlock):
    """A drawing of data.

    **Attributes**

    - `caption`: below the chart, and its text for those who do not see it.
    """

    kind: ClassVar[str] = "chart"
    caption: str
    group: str = ""

    @property
    def label(self) -> str:
        """Text for screen readers."""
        return self.caption

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
        """Return `data` and `layout` for plotly.js, as plain data."""

    def _layout(self, top: int, bottom: int, left: int, right: int, **more: Any) -> dict[str, Any]:
        """Return a layout with margins [pixels], and with what all drawings have in common."""
        return {
            "height": self.height,
            "font": _FONT,
            "paper_bgcolor": "#ffffff",
            "plot_bgcolor": "#ffffff",
            "hovermode": "closest",
            "hoverlabel": {"font": {"size": 12}},
            "dragmode": "zoom",
            "modebar": {"orientation": "h", "bgcolor": "rgba(255,255,255,0.7)"},
            "margin": {"t": top, "b": bottom, "l": left, "r": right},
            **more,
        }


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A line, or points, of a panel.

    **Attributes**

    - `name`: in the legend.
    - `x`, `y`: NaN breaks the line.
    - `look`: `"measured"`, a broad grey line; `"predicted"` and `"residual"`, thin ones; or
      `"points"` and `"fitted"`, grey and coloured points.

    >>> Curve("measured", (0.0, 1.0), (2.0, 3.0), "measured").look
    'measured'
    """

    name: str
    x: Sequence[float | None]
    y: Sequence[float | None]
    look: CurveLook


@dataclasses.dataclass(frozen=True, eq=False)
class Panel:
    """Pair of axes of a `PanelChart`.

    **Attributes**

    - `title`: above the panel, with the unit of y.
    - `curves`: in the order in which they are drawn.
    - `shaded`: intervals of x that are shaded.
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
    - `shading`: what shaded intervals are, for the legend.
    - `group`: charts of one group on a page are zoomed together; none if empty.

    >>> curve = Curve("measured", (0.0, 1.0), (2.0, 3.0), "measured")
    >>> chart = PanelChart((Panel("joint 1 [N m]", (curve,), ((0.2, 0.4),)),), "time [s]", "")
    >>> [trace["name"] for trace in chart.plotly_figure()["data"]]
    ['masked', 'measured']
    """

    panels: tuple[Panel, ...]
    x_label: str
    caption: str
    shading: str = "masked"
    group: str = ""

    @property
    def label(self) -> str:
        return self.caption or f"{', '.join(panel.title for panel in self.panels)}: {self.x_label}"

    @property
    def height(self) -> int:
        drawn = sum(panel.height for panel in self.panels)
        return _TOP + _BOTTOM + drawn + _GAP * (len(self.panels) - 1)

    def plotly_figure(self) -> dict[str, Any]:
        inner, top = self.height - _TOP - _BOTTOM, 0
        # Small, so that three entries fit beside each other on a telephone: more are cut off.
        legend = {"itemsizing": "constant", "orientation": "h", "x": 0, "font": {"size": 11}}
        legend |= {"y": 1 + _TITLE / inner, "yanchor": "bottom"}
        titles: list[dict[str, Any]] = []
        layout = self._layout(_TOP, _BOTTOM, _LEFT, _RIGHT, annotations=titles, legend=legend)
        data: list[dict[str, Any]] = []
        named: set[str] = set()
        for number, panel in enumerate(self.panels, 1):
            suffix = "" if number == 1 else str(number)
            last = number == len(self.panels)
            high, low = 1 - top / inner, 1 - (top + panel.height) / inner
            layout[f"xaxis{suffix}"] = {
                "anchor": f"y{suffix}",
                "gridcolor": _GRID,
                "zeroline": False,
                "showticklabels": last,
                **({} if number == 1 else {"matches": "x"}),
                **({"title": {"text": escape(self.x_label)}} if last else {}),
            }
            layout[f"yaxis{suffix}"] = {
                "anchor": f"x{suffix}",
                "domain": [max(low, 0.0), high],
                "range": rounded(panel.range),
                "gridcolor": _GRID,
                "zerolinecolor": _ZERO,
                "nticks": 5,
            }
            place = {"xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
            title = {"text": escape(panel.title), "showarrow": False, "x": 0, "y": high}
            titles.append(title | place)
            axes = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
            for trace in self._traces(panel):
                # What a panel's title says needs no entry.
                listed = trace["name"] not in named and trace["name"] not in escape(panel.title)
                named.add(trace["name"])
                data.append({"type": "scatter", "showlegend": listed, **trace, **axes})
            top += panel.height + _GAP
        return {"data": data, "layout": layout}

    def _traces(self, panel: Panel) -> list[dict[str, Any]]:
        traces: list[dict[str, Any]] = []
        if panel.shaded:
            bottom, top = rounded(panel.range)
            x: list[float | None] = []
            ends = rounded(np.ravel(panel.shaded), 8)
            for start, end in zip(ends[::2], ends[1::2], strict=True):
                x += [start, start, end, end, None]
            shape = {"fill": "toself", "fillcolor": _MASKED, "line": {"width": 0}}
            y = [bottom, top, top, bottom, None] * len(panel.shaded)
            shading = {"name": escape(self.shading), "legendgroup": "shading", "mode": "lines"}
            traces.append({**shading, **shape, "x": x, "y": y, "hoverinfo": "skip"})
        for curve in panel.curves:
            points = {"x": rounded(curve.x, 8), "y": rounded(curve.y), "connectgaps": False}
            name = {"name": escape(curve.name), "legendgroup": escape(curve.name)}
            traces.append({**name, **points, **_LOOKS[curve.look]})
        return traces


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

    def plotly_figure(self) -> dict[str, Any]:
        labels = [escape(label) for label in self.labels]
        # Ticks by number: labels that are equal would otherwise share a row. Every second label,
        # and so on, where they would overlap.
        labelled = list(range(0, len(labels), -(-len(labels) // _MOST_LABELS) or 1))
        ticks = {
            "tickvals": labelled,
            "ticktext": [labels[i] for i in labelled],
            "tickfont": {"size": 10},
            "showgrid": False,
            "zeroline": False,
        }
        axes = {"xaxis": {**ticks, "tickangle": -90}, "yaxis": {**ticks, "autorange": "reversed"}}
        trace = {
            "type": "heatmap",
            "z": [rounded(row, 3) for row in self.values],
            "zmin": -1,
            "zmax": 1,
            "text": [[f"{a}, {b}" for b in labels] for a in labels],
            "hovertemplate": "%{text}: %{z:.2f}<extra></extra>",
            "colorscale": [[0, _BLUE], [0.5, "#ffffff"], [1, _ORANGE]],
            "colorbar": {"thickness": 12, "len": 0.9, "tickvals": [-1, -0.5, 0, 0.5, 1]},
            "xgap": 0.5,
            "ygap": 0.5,
        }
        return {"data": [trace], "layout": self._layout(30, 60, 60, 8, **axes)}


@dataclasses.dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A solid ellipsoid.

    **Attributes**

    - `name`: of the body.
    - `centre`: (3,) [m].
    - `axes`: (3, 3), its columns the half axes with their lengths [m].

    >>> import numpy as np
    >>> ball = Ellipsoid("link 1", np.zeros(3), 0.1 * np.eye(3))
    >>> x, y, z = ball.surface()
    >>> round(float(np.sqrt(x**2 + y**2 + z**2).max()), 6)
    0.1
    """

    name: str
    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]

    def surface(self) -> Float[np.ndarray, "3 up around"]:
        """Return points of its surface, x, y and z in turn."""
        up, around = np.linspace(0, np.pi, _UP), np.linspace(0, 2 * np.pi, _AROUND)
        ball = [
            np.outer(np.sin(up), np.cos(around)),
            np.outer(np.sin(up), np.sin(around)),
            np.outer(np.cos(up), np.ones_like(around)),
        ]
        return self.centre[:, None, None] + np.einsum("ab,bij->aij", self.axes, np.stack(ball))


@dataclasses.dataclass(frozen=True, eq=False)
class ArmChart(AbstractChart):
    """Bodies as ellipsoids on the lines between a robot's joints.

    **Attributes**

    - `lines`: (lines, 2, 3), from joint to joint, in the base frame [m].
    - `bodies`: in the base frame.
    - `caption`: below the chart.

    >>> import numpy as np
    >>> chart = ArmChart(np.zeros((1, 2, 3)), (Ellipsoid("link 1", np.zeros(3), np.eye(3)),), "")
    >>> [trace["type"] for trace in chart.plotly_figure()["data"]]
    ['scatter3d', 'surface', 'scatter3d']
    """

    lines: Float[np.ndarray, "lines 2 3"]
    bodies: tuple[Ellipsoid, ...]
    caption: str

    @property
    def height(self) -> int:
        return 520

    def plotly_figure(self) -> dict[str, Any]:
        scene: dict[str, Any] = {
            f"{name}axis": {
                "title": {"text": f"{name} [m]", "font": {"size": 12}},
                "tickfont": {"size": 11},
            }
            for name in "xyz"
        }
        for axis in scene.values():
            axis |= {"backgroundcolor": "#ffffff", "gridcolor": _GRID, "nticks": 5}
        points = [self.lines.reshape(-1, 3).T]
        points += [body.surface().reshape(3, -1) for body in self.bodies]
        sides = np.maximum(np.ptp(np.concatenate(points, axis=1), axis=1), 1e-9)
        sides /= np.max(sides)  # the longest side is 1: the camera then sees all of it
        scene["aspectmode"] = "manual"
        scene["aspectratio"] = dict(zip("xyz", sides.tolist(), strict=True))
        scene["camera"] = {"eye": {"x": 1.15, "y": 1.15, "z": 0.45}}
        # A gap after each line.
        path = np.pad(self.lines, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 3)
        data: list[dict[str, Any]] = [
            {
                "type": "scatter3d",
                "name": "joint to joint",
                "mode": "lines+markers",
                **{name: rounded(column) for name, column in zip("xyz", path.T, strict=True)},
                "line": {"color": _ARM, "width": 7},
                "marker": {"color": _ARM, "size": 4},
                "hoverinfo": "skip",
                "showlegend": False,
            }
        ]
        for i, body in enumerate(self.bodies):
            colour, surface = COLOURS[i % len(COLOURS)], zip("xyz", body.surface(), strict=True)
            data.append(
                {
                    "type": "surface",
                    "name": escape(body.name),
                    **{name: [rounded(row, 4) for row in values] for name, values in surface},
                    "colorscale": [[0, colour], [1, colour]],
                    "showscale": False,
                    "opacity": 0.25,
                    "hoverinfo": "name",
                    "legendgroup": str(i),
                }
            )
            # Names overlap where bodies are close: a number at the body, the name in the legend.
            data.append(
                {
                    "type": "scatter3d",
                    "name": f"{i + 1} {escape(body.name)}",
                    "mode": "markers+text",
                    "text": [str(i + 1)],
                    "textposition": _SIDES[i % len(_SIDES)],
                    **{name: rounded([x], 4) for name, x in zip("xyz", body.centre, strict=True)},
                    "marker": {"color": colour, "size": 5},
                    "hoverinfo": "name",
                    "legendgroup": str(i),
                }
            )
        legend = {"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom"}
        return {"data": data, "layout": self._layout(40, 10, 40, 0, scene=scene, legend=legend)}


@dataclasses.dataclass(frozen=True, eq=False)
class Film(AbstractBlock):
    """A moving arm, its links lines from joint to joint, in three views beside each other.

    An SVG picture that animates itself: it needs no script, and is a few kilobytes a second.

    **Attributes**

    - `frames`: (frames, lines, 2, 3), from joint to joint, in the base frame [m].
    - `duration`: of all frames [s], which then begin again.
    - `caption`: below the film, and its text for those who do not see it.

    **Raises**

    - `ValueError`: fewer than two frames.

    >>> import numpy as np
    >>> frames = np.zeros((2, 1, 2, 3))
    >>> frames[1, 0, 1] = [0.1, 0.2, 0.3]
    >>> Film(frames, 1.0, "an arm").svg().count("<animate")
    9
    """

    kind: ClassVar[str] = "film"
    frames: Float[np.ndarray, "frames lines 2 3"]
    duration: float
    caption: str

    def __post_init__(self) -> None:
        if len(self.frames) < 2:
            raise ValueError(f"frames: expected two or more, got {len(self.frames)}")

    def svg(self) -> str:
        """Return the picture."""
        low = np.minimum(self.frames.min((0, 1, 2)), 0.0)
        high = np.maximum(self.frames.max((0, 1, 2)), 0.0)
        extent = max(float(np.max(high - low)), 1e-9)
        scale = (_VIEW - 2 * _MARGIN) / extent
        pixels, base = (scale * (x - (low + high) / 2) + _VIEW / 2 for x in (self.frames, 0.0))
        parts: list[str] = []
        for number, (first, second, name) in enumerate(_VIEWS):
            left = number * _VIEW
            axes = f"{'xyz'[first]} to the right, {'xyz'[second]} upwards"
            parts += [
                f'<text x="{left + 10}" y="18" font-size="13" fill="currentColor">'
                f"{name}: {axes}</text>",
                f'<circle cx="{base[first] + left:.1f}" cy="{_VIEW - base[second]:.1f}" r="5"'
                f' fill="{_MEASURED}"/>',
                self._arm(pixels[..., first] + left, _VIEW - pixels[..., second]),
            ]
        # A round length of about a fifth of the extent.
        decade = 10.0 ** np.floor(np.log10(extent / 5))
        bar = float(decade * max(step for step in (1, 2, 5) if step * decade <= extent / 5))
        return (
            f'<svg viewBox="0 0 {3 * _VIEW} {_VIEW}" xmlns="http://www.w3.org/2000/svg"'
            f' style="width:100%;max-width:{3 * _VIEW}px">{"".join(parts)}'
            f'<path d="M10 {_VIEW - 10} h{scale * bar:.1f}" stroke="currentColor"/>'
            f'<text x="{16 + scale * bar:.1f}" y="{_VIEW - 6}" font-size="13" fill="currentColor">'
            f"{bar:g} m</text></svg>"
        )

    def _arm(
        self, x: Float[np.ndarray, "frames lines 2"], y: Float[np.ndarray, "frames lines 2"]
    ) -> str:
        """Links, and the end of the last one."""
        links = [
            "".join(
                f"M{a[0]:.1f} {b[0]:.1f}L{a[1]:.1f} {b[1]:.1f}" for a, b in zip(*frame, strict=True)
            )
            for frame in zip(x, y, strict=True)
        ]
        across, down = ([f"{value:.1f}" for value in values[:, -1, 1]] for values in (x, y))
        return (
            f'<path d="{links[0]}" fill="none" stroke="#0072b2" stroke-width="5"'
            f' stroke-linecap="round">{self._animate("d", links)}</path>'
            f'<circle cx="{across[0]}" cy="{down[0]}" r="6" fill="#d55e00">'
            f"{self._animate('cx', across)}{self._animate('cy', down)}</circle>"
        )

    def _animate(self, attribute: str, values: list[str]) -> str:
        return (
            f'<animate attributeName="{attribute}" dur="{self.duration:g}s"'
            f' repeatCount="indefinite" values="{";".join(values)}"/>'
        )


def envelope(
    x: Float[np.ndarray, " samples"], y: Float[np.ndarray, " samples"], most: int = 5000
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Return a curve of fewer points that looks the same: its extremes in equal windows.

    **Arguments**

    - `x`: ascending.
    - `y`: of each x; a window that is NaN throughout stays a gap.
    - `most`: points that are left at most, two a window, and one for each gap.

    **Returns** `x` and `y` of the minimum and maximum of each window, in ascending order of x.

    **Raises**

    - `ValueError`: fewer than two points.

    >>> import numpy as np
    >>> x = np.arange(100.0)
    >>> y = np.where(x == 37, 5.0, 0.0)
    >>> fewer_x, fewer_y = envelope(x, y, 10)
    >>> len(fewer_x) <= 10, float(fewer_y.max())
    (True, 5.0)
    """
    if most < 2:
        raise ValueError(f"most: expected at least 2 points, got {most}")
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    starts, sizes = edges[:-1], np.diff(edges)
    # All windows as rows, of which some end with one sample less.
    columns = np.arange(np.max(sizes))
    windows = y[np.minimum(starts[:, None] + columns, len(y) - 1)]
    counted = (columns < sizes[:, None]) & np.isfinite(windows)
    lowest = starts + np.argmin(np.where(counted, windows, np.inf), axis=1)
    highest = starts + np.argmax(np.where(counted, windows, -np.inf), axis=1)
    kept = np.unique(np.concatenate([lowest, highest]))
    return x[kept], y[kept]


def intervals(
    x: Float[np.ndarray, " samples"], mask: Bool[np.ndarray, " samples"], most: int = 400
) -> list[tuple[float, float]]:
    """Return intervals of x where a mask is True, from half a sample before to half after.

    **Arguments**

    - `x`: ascending.
    - `mask`: of each x.
    - `most`: intervals that are left at most: the narrowest gaps between them are closed first.

    **Returns** start and end of each.

    >>> import numpy as np
    >>> intervals(np.arange(6.0), np.array([False, True, True, False, False, True]))
    [(0.5, 2.5), (4.5, 5.0)]
    """
    if not np.any(mask):
        return []
    changes = np.diff(np.concatenate([[False], mask, [False]]).astype(int))
    middles = np.concatenate([x[:1], 0.5 * (x[:-1] + x[1:]), x[-1:]])
    low, high = middles[changes == 1], middles[changes == -1]
    if len(low) > most:
        gaps = low[1:] - high[:-1]
        widest = np.sort(np.argsort(-gaps, kind="stable")[: most - 1])
        low, high = low[np.concatenate([[0], widest + 1])], high[np.append(widest, len(high) - 1)]
    return list(zip(low.tolist(), high.tolist(), strict=True))


def rounded(values: Sequence[float | None] | np.ndarray, digits: int = 5) -> list[float | None]:
    """Return numbers to some significant digits, as they stand in a page; None for NaN.

    >>> rounded([1.2345678, float("nan"), 123456.0])
    [1.2346, None, 123460.0]
    """
    x = np.asarray(values, float)
    finite = np.isfinite(x)
    size = np.abs(np.where(finite, x, 0.0))
    magnitude = np.floor(np.log10(size, out=np.zeros_like(x), where=size != 0.0))
    # Powers of ten up to this are exact, so that quotients by them are the decimal numbers.
    power = np.clip(digits - 1 - magnitude, -_EXACT_POWER, _EXACT_POWER)
    up, down = 10.0 ** np.maximum(power, 0.0), 10.0 ** np.maximum(-power, 0.0)
    # Python's own numbers: those of NumPy take three times as long to be written.
    numbers = (np.rint(np.where(finite, x, 0.0) * up / down) / up * down).tolist()
    if np.all(finite):
        return numbers
    return [x if kept else None for x, kept in zip(numbers, finite.tolist(), strict=True)]

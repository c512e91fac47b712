"""Drawing of an arm and of the ellipsoids of its bodies."""

import dataclasses
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..plotting import COLOURS, STYLES, new_figure
from ._chart import FONT, AbstractChart, base_layout
from ._chart_curves import plain


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_ARM = "#4b5563"
# Angles of an ellipsoid's mesh.
_AROUND, _UP = 25, 13


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
        """Points of its surface, x, y and z in turn."""
        up, around = np.linspace(0, np.pi, _UP), np.linspace(0, 2 * np.pi, _AROUND)
        ball = np.stack(
            [
                np.outer(np.sin(up), np.cos(around)),
                np.outer(np.sin(up), np.sin(around)),
                np.outer(np.cos(up), np.ones_like(around)),
            ]
        )
        return self.centre[:, None, None] + np.einsum("ab,bij->aij", self.axes, ball)

    def outline(self, first: int, second: int) -> Float[np.ndarray, "2 around"]:
        """Its outline seen along the third axis: the projection of an ellipsoid is an ellipse."""
        flat = self.axes[[first, second]]
        values, vectors = np.linalg.eigh(flat @ flat.T)
        half = vectors * np.sqrt(np.maximum(values, 0.0))
        around = np.linspace(0, 2 * np.pi, 4 * _AROUND)
        circle = np.stack([np.cos(around), np.sin(around)])
        return self.centre[[first, second]][:, None] + half @ circle


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
    ['scatter3d', 'surface']
    """

    lines: Float[np.ndarray, "lines 2 3"]
    bodies: tuple[Ellipsoid, ...]
    caption: str

    @property
    def height(self) -> int:
        return 520

    def plotly_figure(self) -> dict[str, Any]:
        layout = base_layout(self.height)
        layout["margin"] = {"t": 10, "b": 40, "l": 0, "r": 0}
        layout["legend"] = {"orientation": "h", "x": 0, "y": 0, "yanchor": "top"}
        layout["scene"] = {
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.7, "y": 1.7, "z": 1.1}},
            **{
                f"{name}axis": {"title": {"text": f"{name} [m]"}, "tickfont": FONT | {"size": 10}}
                for name in "xyz"
            },
        }
        path: list[list[float | None]] = [[], [], []]
        for line in self.lines:
            for axis in range(3):
                path[axis] += [*plain(line[:, axis]), None]
        data: list[dict[str, Any]] = [
            {
                **{"type": "scatter3d", "name": "joint to joint", "mode": "lines+markers"},
                **dict(zip("xyz", path, strict=True)),
                **{"line": {"color": _ARM, "width": 5}, "marker": {"color": _ARM, "size": 3}},
                **{"hoverinfo": "skip", "showlegend": True},
            }
        ]
        for i, body in enumerate(self.bodies):
            colour = COLOURS[i % len(COLOURS)]
            surface = {
                name: [plain(row, 4) for row in values]
                for name, values in zip("xyz", body.surface(), strict=True)
            }
            data.append(
                {
                    **{"type": "surface", "name": escape(body.name), **surface},
                    **{"colorscale": [[0, colour], [1, colour]], "showscale": False},
                    **{"opacity": 0.55, "showlegend": True, "hoverinfo": "name"},
                }
            )
        return {"data": data, "layout": layout}

    def figure(self) -> "Figure":
        figure = new_figure(10.0, 4.6)
        views = (("x", "z"), ("y", "z"), ("x", "y"))
        for axes, names in zip(figure.subplots(1, 3), views, strict=True):
            first, second = ("xyz".index(name) for name in names)
            for line in self.lines:
                axes.plot(line[:, first], line[:, second], color=_ARM, lw=2, marker="o", ms=3)
            for i, body in enumerate(self.bodies):
                axes.plot(
                    *body.outline(first, second),
                    color=COLOURS[i % len(COLOURS)],
                    ls=STYLES[i % len(STYLES)],
                    label=body.name.replace("$", r"\$"),
                )
            axes.set_xlabel(f"{names[0]} [m]")
            axes.set_ylabel(f"{names[1]} [m]")
            axes.set_aspect("equal", adjustable="datalim")
            axes.grid(alpha=0.25)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
        return figure

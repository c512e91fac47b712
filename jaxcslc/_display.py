"""Tables, charts and progress for notebooks and prompts; figures of plotly, which is an extra."""

import contextlib
import html
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ._environment import require
from ._text_table import number_text


# Points of a curve that a chart draws at most: more than a screen has columns.
_MOST_POINTS = 4000
_PANEL_HEIGHT, _MARGIN = 220, 120  # of a chart [pixels]


def html_table(title: str, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> str:
    """Return a title and a table for notebooks; numbers have four digits, texts are escaped.

    >>> html_table("fit", {"name": ["kB1"], "value": [0.51234]})
    '<p><b>fit</b></p><table><tr><th>name</th><th>value</th></tr><tr><td>kB1</td>\
<td>0.5123</td></tr></table>'
    """
    rows = [columns.keys(), *zip(*columns.values(), strict=True)]
    cells = [
        [html.escape(x if isinstance(x, str) else number_text(float(x))) for x in row]
        for row in rows
    ]
    lines = ["".join(f"<th>{cell}</th>" for cell in cells[0])]
    lines += ["".join(f"<td>{cell}</td>" for cell in row) for row in cells[1:]]
    table = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<p><b>{html.escape(title)}</b></p><table>{table}</table>"


def html_rows(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a title and a table as `html_table` does, of rows with the same columns.

    >>> import math
    >>> html_rows("fit", [{"name": "kB1", "value": math.inf}])
    '<p><b>fit</b></p><table><tr><th>name</th><th>value</th></tr><tr><td>kB1</td>\
<td>∞</td></tr></table>'
    """
    return html_table(title, {name: [row[name] for row in rows] for name in (rows or [{}])[0]})


def curve_figure(
    title: str,
    time: Float[np.ndarray, " samples"],
    panels: Mapping[str, Float[np.ndarray, "samples joints"]],
    joint_names: Sequence[str],
) -> Any:
    """Return a `plotly.graph_objects.Figure` of quantities over time, one panel each.

    - `time`: [s].
    - `panels`: by title; the curves of a joint have one colour and one entry of the legend.

    **Raises** `MissingExtraError` without plotly.
    """
    figure = _panels(title, tuple(panels), x_title="time [s]")
    step = -(-len(time) // _MOST_POINTS)
    for row, values in enumerate(panels.values(), start=1):
        for joint, name in enumerate(joint_names):
            curve = {"x": time[::step], "y": values[::step, joint], "mode": "lines"}
            figure.add_scatter(**curve, **_legend(name, joint, row), row=row, col=1)
    return figure


def bar_figure(
    title: str,
    names: Sequence[str],
    panels: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float]]]],
) -> Any:
    """Return a `plotly.graph_objects.Figure` of bars, one for each name, one panel a quantity.

    - `panels`: by title, then by the entry of the legend: where bars begin, and their lengths.

    **Raises** `MissingExtraError` without plotly.
    """
    figure = _panels(title, tuple(panels), x_title="")
    for row, groups in enumerate(panels.values(), start=1):
        for number, (name, (base, length)) in enumerate(groups.items()):
            bars = {"x": list(names), "base": base, "y": length}
            figure.add_bar(**bars, **_legend(name, number, row), row=row, col=1)
    return figure


def _panels(title: str, titles: Sequence[str], *, x_title: str) -> Any:
    subplots = require("plotly.subplots", "report")
    figure = subplots.make_subplots(
        len(titles), 1, shared_xaxes=True, vertical_spacing=0.06, subplot_titles=titles
    )
    figure.update_layout(
        title=title, template="plotly_white", height=_MARGIN + _PANEL_HEIGHT * len(titles)
    )
    figure.update_xaxes(title_text=x_title, row=len(titles), col=1)
    return figure


def _legend(name: str, number: int, row: int) -> dict[str, Any]:
    """Return one entry of the legend, and one colour, for a name in all panels."""
    colours = require("plotly.colors", "report").qualitative.D3
    colour = colours[number % len(colours)]
    return {
        "name": name,
        "legendgroup": name,
        "showlegend": row == 1,
        "marker": {"color": colour},
    }


def html_of(shown: Any) -> str:
    """Return how a notebook shows an object of this package."""
    return shown._repr_html_()


Progress = Callable[[str], None] | bool | None


def is_watched() -> bool:
    """Return whether somebody watches: in a notebook, at Python's prompt, or on a terminal.

    Workers of a pool are not watched: their lines would overwrite each other.
    """
    if multiprocessing.parent_process() is not None:
        return False
    return hasattr(sys, "ps1") or (sys.stderr is not None and sys.stderr.isatty())


def progress_bar(**options: Any) -> Any:
    """Return a bar of `tqdm`: a widget in notebooks, elsewhere a line on standard error."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="IProgress")  # tqdm then writes text
        from tqdm.auto import tqdm

        return tqdm(**options)


@contextlib.contextmanager
def steps(progress: Progress, title: str) -> Generator[Callable[[str], None]]:
    """Yield a function to be called with a few words at the start of each step.

    - `progress`: such a function itself; True shows steps in a line of `tqdm`, which disappears at
      the end; False shows none; None shows them where somebody watches (`is_watched`). The
      environment variable `TQDM_DISABLE=1` turns all such lines off.
    - `title`: what is computed.

    >>> with steps(print, "identify") as step:
    ...     step("fitting coefficients")
    fitting coefficients
    """
    if callable(progress):
        yield progress
    elif progress or (progress is None and is_watched()):
        with progress_bar(desc=title, bar_format="{desc} ({elapsed})", leave=False) as bar:
            yield lambda words: bar.set_description_str(f"{title}: {words}")
    else:
        yield lambda words: None

"""The index page of the experiment."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from scripts.studies.tables import number_text


Rows = list[dict[str, Any]]


# Of coefficients; the CSV files have these too.
_LEFT_OUT = ("group", "positive", "relative_error")
_LAST = ("reason", "expression")
_LONGEST = 70  # characters of a cell; the whole text appears under the pointer


def html_table(rows: Rows) -> str:
    """Rows as an HTML table; numbers to four digits, columns of text to the left."""
    names = [name for name in rows[0] if name not in (*_LEFT_OUT, *_LAST)]
    names += [name for name in _LAST if name in rows[0]]
    text = {name for name in names if any(isinstance(row.get(name), str) for row in rows)}
    head = "".join(f"<th{_side(name in text)}>{escape(_heading(name))}</th>" for name in names)
    body = "".join(
        "<tr>" + "".join(_cell(row.get(name, ""), name in text) for name in names) + "</tr>\n"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table>\n"


def _heading(name: str) -> str:
    return name.replace("_", " ")


def _side(text: bool) -> str:
    return " class='text'" if text else ""


def _cell(value: Any, text: bool) -> str:
    if isinstance(value, bool | np.bool_):
        shown = "yes" if value else "no"
    else:
        shown = "" if value != value else number_text(value)
    whole = f" title='{escape(shown)}'" if len(shown) > _LONGEST else ""
    shown = shown if not whole else shown[: _LONGEST - 2] + " …"
    return f"<td{_side(text)}{whole}>{escape(shown)}</td>"


def index_page(
    tables: Mapping[str, tuple[str, Rows]], captions: Mapping[str, str], notes: Sequence[str]
) -> str:
    """One page with every table and figure.

    **Arguments**

    - `tables`: captions and rows, by the name of the CSV file.
    - `captions`: of the figures, by number.
    """
    style = (
        "body{font:16px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}"
        "table{border-collapse:collapse;font-size:13px;margin:.5em 0}"
        "td,th{border-bottom:1px solid #ccc;padding:.15em .6em;text-align:right;"
        "vertical-align:bottom}td{white-space:nowrap}.text{text-align:left}"
        "th:first-child,td:first-child{text-align:left;position:sticky;left:0;background:#fff}"
        "img{max-width:100%}.wide{overflow-x:auto}"
    )
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'>",
        f"<title>PUMA 560 experiment</title><style>{style}</style>",
        "<h1>The identification experiment on two simulated PUMA 560s</h1>",
        *(f"<p>{escape(note)}</p>" for note in notes),
        "<h2>Tables</h2>",
    ]
    for name, (caption, rows) in tables.items():
        parts.append(
            f"<h3 id='{name}'>{escape(caption)}</h3><div class='wide'>{html_table(rows)}</div>"
            f"<p><a href='{name}.csv'>{name}.csv</a></p>"
        )
    parts.append("<h2>Figures</h2>")
    for number, caption in captions.items():
        parts.append(
            f"<figure><img src='figure_{number}.png' alt='{escape(caption)}'>"
            f"<figcaption>Fig. {number}. {escape(caption)}</figcaption></figure>"
        )
    return "\n".join(parts) + "\n"

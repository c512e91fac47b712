"""The index page of the experiment."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from scripts.studies.tables import number_text


Rows = list[dict[str, Any]]


def html_table(rows: Rows) -> str:
    """Rows as an HTML table; numbers to four digits."""
    names = list(rows[0])
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(
        "<tr>"
        + "".join(f"<td>{escape(number_text(row.get(name, '')))}</td>" for name in names)
        + "</tr>\n"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table>\n"


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
        "td,th{border-bottom:1px solid #ccc;padding:.15em .6em;text-align:right}"
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

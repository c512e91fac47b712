"""Rows as text, and as the cells that evidence pages have (`stored.py`)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxcslc._text_table import text_table


def number_text(value: Any, digits: int = 4) -> str:
    """A float to some digits; anything else as it is."""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def rows_table(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None, *, digits: int = 4
) -> str:
    """Rows as a table, columns of text to the left.

    **Arguments**

    - `columns`: names of those to show, by default all of the first row.
    - `digits`: of floats.
    """
    head, *body = cells_of(rows, columns, digits=digits)
    left = [name for name in head if isinstance(rows[0][name], str)]
    return text_table(head, body, left=left)


def cells_of(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None, *, digits: int = 4
) -> list[list[str]]:
    """Rows as cells of text, the head first; arguments as of `rows_table`."""
    columns = list(rows[0]) if columns is None else list(columns)
    return [columns, *([number_text(row[name], digits) for name in columns] for row in rows)]


def grouped(cells: Sequence[Sequence[str]]) -> list[list[str]]:
    """Cells whose first column is empty where it repeats the row above.

    >>> grouped([["arm", "motion"], ["Panda", "A"], ["Panda", "B"]])
    [['arm', 'motion'], ['Panda', 'A'], ['', 'B']]
    """
    above = [[""], *cells]
    return [
        ["" if row[0] == before[0] else row[0], *row[1:]]
        for before, row in zip(above, cells, strict=False)
    ]


def stacked(first: str, tables: Mapping[str, Sequence[Sequence[str]]]) -> list[list[str]]:
    """Tables of one form as one, the name of each in a column before it.

    - `first`: head of that column.

    >>> stacked("arm", {"A": [["", "ε"], ["fit", "1"]], "B": [["", "ε"], ["fit", "2"]]})
    [['arm', '', 'ε'], ['A', 'fit', '1'], ['B', 'fit', '2']]
    """
    head, *_ = next(iter(tables.values()))
    lines = [[name, *row] for name, (_, *rows) in tables.items() for row in rows]
    return grouped([[first, "", *head[1:]], *lines])


def median_text(values: Sequence[float] | np.ndarray, form: str = ".3g") -> str:
    """Median and the range from 10 to 90 % of the finite values."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return "-"
    low, middle, high = np.quantile(finite, [0.1, 0.5, 0.9])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"

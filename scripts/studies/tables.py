"""Rows as text."""

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
    columns = list(rows[0]) if columns is None else columns
    left = [name for name in columns if isinstance(rows[0][name], str)]
    cells = [[number_text(row[name], digits) for name in columns] for row in rows]
    return text_table(columns, cells, left=left)


def median_text(values: Sequence[float] | np.ndarray, form: str = ".3g") -> str:
    """Median and the range from 10 to 90 % of the finite values."""
    finite = np.asarray(values, float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return "-"
    low, middle, high = np.quantile(finite, [0.1, 0.5, 0.9])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"

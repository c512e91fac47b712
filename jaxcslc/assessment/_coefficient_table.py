from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Array, Float

from ..learning import Identification
from ..network import CSLC
from ._text import text_table


_LONGEST_EXPRESSION = 60


def coefficient_rows(
    network: CSLC,
    fit: Identification | None = None,
    reference: Mapping[str, Float[Array | np.ndarray, " _"]] | None = None,
    *,
    sensitivity: Float[Array | np.ndarray, " _"] | None = None,
    groups: Sequence[str] | None = None,
) -> list[dict[str, str | float | bool]]:
    """One row a coefficient: name, group, expression, unit and, with a fit, what it found.

    With a reference and sensitivities the rows are those of Figs. B.1-1 to B.5-2.

    **Arguments**

    - `fit`: adds `value`, `standard_error`, `relative_error` and `identifiability`: `determined`;
      `sign` where the value contradicts a positive coefficient; `weak` where its standard error
      exceeds the value; `undetermined` where the patterns do not tell it.
    - `reference`: further columns of values, such as Armstrong's, or the true ones.
    - `sensitivity`: adds the column `sensitivity`; see `output_sensitivity`.
    - `groups`: only the coefficients of these groups, such as `["mass"]` for Fig. B.1-1; by
      default all.

    **Raises**

    - `ValueError`: for a group that the network does not have, or a vector of another length.

    >>> import jaxcslc as jc
    >>> from jaxcslc.assessment import coefficient_rows
    >>> network = jc.derive(jc.puma560())
    >>> len(coefficient_rows(network, groups=["gravity"]))
    5
    """
    present = tuple(dict.fromkeys(coefficient.group for coefficient in network.coefficients))
    for group in groups or ():
        if group not in present:
            raise ValueError(f"groups: expected some of {', '.join(present)}, got {group!r}")
    columns = dict(reference or {}) | ({} if sensitivity is None else {"sensitivity": sensitivity})
    for name, vector in columns.items():
        if vector.shape != (network.size,):
            raise ValueError(f"{name}: expected shape ({network.size},), got {vector.shape}")
    rows: list[dict[str, str | float | bool]] = []
    for i, coefficient in enumerate(network.coefficients):
        if groups is not None and coefficient.group not in groups:
            continue
        row: dict[str, str | float | bool] = {
            "name": coefficient.name,
            "group": coefficient.group,
            "unit": coefficient.unit,
            "positive": coefficient.positive,
        }
        if fit is not None:
            value, error = float(fit.k[i]), float(fit.standard_error[i])
            row["value"], row["standard_error"] = value, error
            row["relative_error"] = abs(error / value) if value else float("inf")
            row["identifiability"] = _verdict(
                value, error, bool(fit.determined[i]), coefficient.positive
            )
        for name, vector in columns.items():
            row[name] = float(vector[i])
        row["expression"] = coefficient.expression
        rows.append(row)
    return rows


def coefficient_text(rows: list[dict[str, str | float | bool]]) -> str:
    """Coefficient rows as a table to read; long expressions are cut."""
    shown = [name for name in rows[0] if name not in ("group", "positive", "relative_error")]
    cells = [[_cell(name, row[name]) for name in shown] for row in rows]
    return text_table(shown, cells, left=("unit", "identifiability", "expression"))


def _cell(name: str, value: str | float | bool) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    text = str(value)
    if name == "expression":
        cut = len(text) > _LONGEST_EXPRESSION
        return text[: _LONGEST_EXPRESSION - 2] + " …" if cut else text
    return text


def _verdict(value: float, error: float, determined: bool, positive: bool) -> str:
    if not determined:
        return "undetermined"
    if error > abs(value):
        return "weak"
    return "sign" if positive and value < 0 else "determined"

"""Table of coefficients with standard errors, for text and CSV."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Array, Float

from .._text_table import text_table
from ..least_squares import Identification
from ..network import AbstractLinearNetwork
from ..uncertainty import SystematicError, uncertainty_interval
from ._excitation import Excitation
from ._model_description import ModelDescription
from ._verdicts import verdicts


# What a line has room for: alone, and beside a value with its errors, interval and verdict.
_LONGEST_EXPRESSION, _LONGEST_BESIDE_VALUE = 60, 30
_GOOD = "well determined"
_HEADERS = {"standard_error": "std error", "systematic_error": "systematic"}


def coefficient_rows(
    network: AbstractLinearNetwork | ModelDescription,
    fit: Identification | None = None,
    reference: Mapping[str, Float[Array | np.ndarray, " _"]] | None = None,
    *,
    sensitivity: Float[Array | np.ndarray, " _"] | None = None,
    groups: Sequence[str] | None = None,
    excitation: Excitation | None = None,
    systematic: SystematicError | None = None,
    level: float = 0.95,
) -> list[dict[str, str | float | bool]]:
    """Return one row per coefficient: name, group, unit, expression; with a fit, value and verdict.

    With a reference and sensitivities the rows are those of Figs. B.1-1 to B.5-2.

    **Arguments**

    - `fit`: adds `value`, `standard_error`, `relative_error`, the interval's ends `low` and
      `high`, and `verdict` and `reason`, as `verdicts` gives them.
    - `reference`: further columns of values, such as Armstrong's, or the true ones.
    - `sensitivity`: adds the column `sensitivity`: mean torque per unit of each coefficient (7.6).
    - `excitation`: adds `variance_inflation`, and reasons that name it; see
      `degree_of_excitation`.
    - `systematic`: adds `systematic_error`, and widens intervals; see `systematic_error`.
    - `level`: of the intervals.
    - `groups`: only the coefficients of these groups, such as `["mass"]` for Fig. B.1-1; by
      default all.

    **Raises**

    - `ValueError`: for a group that the network does not have, or a vector of another length.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import coefficient_rows
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
    judged = (
        None
        if fit is None
        else verdicts(network, fit, excitation, systematic=systematic, level=level)
    )
    interval = None if fit is None else uncertainty_interval(fit, systematic, level)
    # On the host once: JAX takes 50 µs for an entry, and compiles a program first.
    inflation = None if excitation is None else np.asarray(excitation.variance_inflation)
    shifts = None if systematic is None else systematic.total
    columns = {name: np.asarray(vector) for name, vector in columns.items()}
    k, errors = ((), ()) if fit is None else map(np.asarray, (fit.k, fit.standard_error))
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
        if fit is not None and judged is not None and interval is not None:
            value, error = float(k[i]), float(errors[i])
            row["value"], row["standard_error"] = value, error
            if shifts is not None:
                row["systematic_error"] = float(shifts[i])
            row["relative_error"] = abs(error / value) if value else float("inf")
            row["low"], row["high"] = (float(end) for end in interval[i])
            if inflation is not None:
                row["variance_inflation"] = float(inflation[i])
            row["verdict"], row["reason"] = judged[i].kind, judged[i].reason
        for name, vector in columns.items():
            row[name] = float(vector[i])
        row["expression"] = coefficient.expression
        rows.append(row)
    return rows


def coefficient_text(rows: list[dict[str, str | float | bool]]) -> str:
    """Coefficient rows as a table to read; long expressions are cut.

    Reasons of verdicts follow the table, for coefficients that are not well determined.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import coefficient_rows, coefficient_text
    >>> pendulum = jc.Manipulator.from_modified_dh(
    ...     [(0, 0, 0, 0)], gravity=(0, -9.81, 0), friction=()
    ... )
    >>> print(coefficient_text(coefficient_rows(jc.derive(pendulum, lengths="numeric"))))
    name  unit   expression
    kB1   kg m²  Izz1 + Im1
    kB2   kg m   m1*rx1
    kB3   kg m   m1*ry1
    """
    hidden = ("group", "positive", "relative_error", "variance_inflation", "reason")
    shown = [name for name in rows[0] if name not in hidden]
    longest = _LONGEST_BESIDE_VALUE if "value" in rows[0] else _LONGEST_EXPRESSION
    cells = [[_cell(row[name], longest * (name == "expression")) for name in shown] for row in rows]
    header = [_HEADERS.get(name, name) for name in shown]
    table = text_table(header, cells, left=("unit", "verdict", "expression"))
    doubtful = [row for row in rows if row.get("verdict", _GOOD) != _GOOD]
    reasons = [f"  {row['name']}: {row['reason']}" for row in doubtful]
    return "\n".join([table, *(["", "not well determined:", *reasons] if reasons else [])])


def _cell(value: str | float | bool, longest: int) -> str:
    """The text of a cell, cut where it has more than `longest` characters; 0 for any number."""
    if isinstance(value, float):
        return f"{value:.4g}"
    text = str(value)
    return text[: longest - 2] + " …" if 0 < longest < len(text) else text

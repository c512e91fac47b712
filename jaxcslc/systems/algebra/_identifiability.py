"""Constants that follow from the coefficients, and independence of columns."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxcslc._rank import numerical_rank
from jaxcslc.derivation import Coefficient


if TYPE_CHECKING:
    from .._system import System


Verdict = Literal["alone", "only in combinations", "not at all"]


COMPLEX_STEP = 1e-30
"""Of derivatives in the complex plane: analytic functions to rounding."""


@dataclasses.dataclass(frozen=True)
class ConstantIdentifiability:
    """Verdict whether an unknown constant follows from the coefficients, which fits determine.

    **Attributes**

    - `constant`: its name.
    - `verdict`: `"alone"`: it can be computed from coefficients; `"only in combinations"`: it
      can't be told apart from others; `"not at all"`: it cancels from every equation.
    - `coefficients`: names of those that it is part of.

    >>> from jaxcslc.systems import ConstantIdentifiability
    >>> print(ConstantIdentifiability("l", "only in combinations", ("k2", "k3")))
    constant 'l': only in combinations, k2, k3
    """

    constant: str
    verdict: Verdict
    coefficients: tuple[str, ...]

    def __str__(self) -> str:
        if self.verdict == "not at all":
            return (
                f"constant {self.constant!r}: not at all, it cancels from every equation;"
                " no recording determines it"
            )
        listed = ", ".join(self.coefficients)
        return f"constant {self.constant!r}: {self.verdict}, {listed}"


def identifiability_of(
    symbols: Mapping[str, Any],
    formulas: Sequence[Any],
    coefficients: Sequence[Coefficient],
) -> tuple[ConstantIdentifiability, ...]:
    """Determine the identifiability of each unknown constant.

    It follows from the derivatives of the coefficients at one random set of values.

    A constant can be computed from the coefficients near almost every set of values if its unit
    vector is a combination of their gradients.
    """
    from sympy import lambdify

    names = list(symbols)
    draw = np.random.default_rng(0)
    point = np.array(
        [draw.uniform(0.5, 1.5) * (-1 if symbols[name].is_negative else 1) for name in names]
    )
    function = lambdify(list(symbols.values()), list(formulas), modules="numpy", cse=True)
    # Complex steps: derivatives of analytic functions to rounding, without their expressions.
    steps = point[:, None] + 1j * COMPLEX_STEP * np.eye(len(names))
    values = [np.broadcast_to(value, len(names)) for value in function(*steps)]
    gradient = np.imag(np.array(values, complex)) / COMPLEX_STEP
    rank = numerical_rank(gradient.T)
    rows: list[ConstantIdentifiability] = []
    for index, name in enumerate(names):
        part_of = tuple(
            coefficient.name
            for coefficient, formula in zip(coefficients, formulas, strict=True)
            if symbols[name] in formula.free_symbols
        )
        verdict: Verdict = "not at all"
        if part_of:
            with_unit = np.vstack([gradient, np.eye(len(names))[index]])
            alone = numerical_rank(with_unit.T) == rank
            verdict = "alone" if alone else "only in combinations"
        rows.append(ConstantIdentifiability(name, verdict, part_of))
    return tuple(rows)


def independent(system: "System", regressor: Sequence[Sequence[Any]]) -> bool:
    """Return whether the columns of a regressor are independent at random states, numerically.

    Columns are functions that exact algebra has made independent, as far as it knows the functions:
    this is where it is held to it. States where a function is not real are left out.
    """
    from sympy import lambdify

    size = len(regressor[0])
    draw = np.random.default_rng(0)
    arguments = list(system.symbols.motion.values())
    searched = {
        system.symbols.constants[constant.name]: draw.uniform(*constant.bounds)
        for constant in system.nonlinear
        if constant.bounds is not None
    }
    expressions = [[x.subs(searched) for x in row] for row in regressor]
    function = lambdify(arguments, expressions, modules="numpy", cse=True)
    states = draw.uniform(-2.0, 2.0, (len(arguments), 20 + 4 * size))
    with np.errstate(all="ignore"):
        values = function(*states.astype(complex))
    count = states.shape[1]
    columns = [[np.broadcast_to(x, count) for x in row] for row in values]
    rows = np.moveaxis(np.array(columns, complex), 1, -1).reshape(-1, size)
    finite = np.all(np.isfinite(rows), axis=1)
    real = np.all(np.abs(np.imag(rows)) <= 1e-12 * np.abs(rows), axis=1)
    return numerical_rank(np.real(rows[finite & real])) == size

"""Constants of a system as they follow from coefficients: which do, and their values."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float
from sympy import lambdify

from .._rank import numerical_rank, pseudo_inverse
from ..least_squares import Identification


if TYPE_CHECKING:
    from ._separation import Separation
    from ._system import System


Verdict = Literal["alone", "only in combinations", "not at all"]


# Of derivatives in the complex plane: so small that its square is nothing beside 1.
_COMPLEX_STEP = 1e-30
# The search for constants ends when a step changes them by less than this part.
_PRECISION = 1e-12
# Coefficients that were met exactly count as if their relative error were this.
_LEAST_ERROR = 1e-9
# How far constants may miss coefficients: standard errors, and of exact ones a part of themselves.
_MISSED_ERRORS, _MISSED_PART = 10.0, 1e-3
# Of a complex number: a smaller imaginary part is rounding.
_REAL = 1e-12


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


def determine_identifiability(separation: "Separation") -> tuple[ConstantIdentifiability, ...]:
    """Determine the identifiability of each unknown constant.

    It follows from the derivatives of the coefficients at one random set of values: a constant can
    be computed from the coefficients near almost every set of values if its unit vector is a
    combination of their gradients.
    """
    symbols, draw = separation.symbols, np.random.default_rng(0)
    signs = [-1 if symbol.is_negative else 1 for symbol in symbols.values()]
    point = np.array([draw.uniform(0.5, 1.5) * sign for sign in signs])
    gradient = _gradient(separation, point)
    rank = numerical_rank(gradient.T)
    rows: list[ConstantIdentifiability] = []
    for name, symbol, unit in zip(symbols, symbols.values(), np.eye(len(symbols)), strict=True):
        part_of = tuple(
            coefficient.name
            for coefficient, formula in zip(
                separation.coefficients, separation.formulas, strict=True
            )
            if symbol in formula.free_symbols
        )
        verdict: Verdict = "not at all"
        if part_of:
            alone = numerical_rank(np.vstack([gradient, unit]).T) == rank
            verdict = "alone" if alone else "only in combinations"
        rows.append(ConstantIdentifiability(name, verdict, part_of))
    return tuple(rows)


def _gradient(
    separation: "Separation", values: Float[np.ndarray, " constants"]
) -> Float[np.ndarray, "coefficients constants"]:
    """Return the derivatives of the coefficients, by complex steps: exact to rounding."""
    steps = values[:, None] + 1j * _COMPLEX_STEP * np.eye(len(values))
    return np.imag(separation.evaluate(steps)) / _COMPLEX_STEP


def independent(system: "System", regressor: Sequence[Sequence[Any]]) -> bool:
    """Return whether the columns of a regressor are independent at random states, numerically.

    Columns are functions that exact algebra has made independent, as far as it knows the functions:
    this is where it is held to it. States where a function is not real are excluded.
    """
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
    # Random values of constants, except their signs, and of the motion in SI units.
    states = draw.uniform(-2.0, 2.0, (len(arguments), 20 + 4 * size))
    with np.errstate(all="ignore"):
        values = function(*states.astype(complex))
    count = states.shape[1]
    columns = [[np.broadcast_to(x, count) for x in row] for row in values]
    rows = np.moveaxis(np.array(columns, complex), 1, -1).reshape(-1, size)
    finite = np.all(np.isfinite(rows), axis=1)
    real = np.all(np.abs(np.imag(rows)) <= _REAL * np.abs(rows), axis=1)
    return numerical_rank(np.real(rows[finite & real])) == size


@dataclasses.dataclass(frozen=True)
class ConstantEstimate:
    """An unknown constant as it follows from identified coefficients.

    **Attributes**

    - `name`, `unit`: of the constant.
    - `value`: that explains the coefficients best, in its unit.
    - `standard_error`: from the coefficients' covariance, to first order.

    >>> from jaxcslc.systems import ConstantEstimate
    >>> print(ConstantEstimate("l", "m", 0.5, 0.002))
    l = 0.5 ± 0.002 m
    """

    name: str
    unit: str
    value: float
    standard_error: float

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.4g} ± {self.standard_error:.2g} {self.unit}".rstrip()


def constants_from(system: "System", fit: Identification) -> tuple[ConstantEstimate, ...]:
    """Return the constants of a system that its coefficients determine.

    The values whose coefficients are nearest to the identified ones, each difference divided by its
    standard error: where there are more coefficients than constants, all of them count. Constants
    that are determined only in combinations have no estimate.

    **Arguments**

    - `system`: whose coefficients were identified.
    - `fit`: of its network.

    **Returns** an estimate of each constant that follows from coefficients alone, in the order of
    `system.unknown`; none where a coefficient is not determined, or where no values of the signs
    that are known come near the coefficients.

    >>> import jaxcslc as jc
    >>> from jaxcslc.systems import constants_from
    >>> tank, recording = jc.examples.tank()
    >>> fit = jc.identify_system(tank, recording).fit
    >>> [(row.name, round(row.value, 4), row.unit) for row in constants_from(tank, fit)]
    [('area', 3.0, 'm²'), ('outlet', 0.5, '')]
    """
    from scipy.optimize import least_squares  # takes a while to load

    separation = system.separation
    alone = [row.constant for row in separation.identifiability if row.verdict == "alone"]
    if not alone or not np.all(np.asarray(fit.determined)):
        return ()
    symbols = separation.symbols.values()
    negative = np.array([bool(symbol.is_negative) for symbol in symbols])
    positive = np.array([bool(symbol.is_positive) for symbol in symbols])
    k, error = np.asarray(fit.k), np.asarray(fit.standard_error)
    size = np.maximum(np.abs(k), np.max(np.abs(k)) * _LEAST_ERROR)
    weight = 1.0 / np.maximum(error, _LEAST_ERROR * size)
    # The searches start from constants of these sizes, in their units.
    searches = (
        least_squares(
            lambda values: weight * (np.real(separation.evaluate(values)) - k),
            size * np.where(negative, -1.0, 1.0),
            jac=lambda values: weight[:, None] * _gradient(separation, values),
            bounds=(np.where(positive, 0.0, -np.inf), np.where(negative, 0.0, np.inf)),
            x_scale="jac",
            xtol=_PRECISION,
            ftol=_PRECISION,
            gtol=_PRECISION,
        )
        for size in (1.0, 0.1, 10.0)
    )
    best = min(searches, key=lambda search: search.cost)
    misfit = np.abs(np.real(separation.evaluate(best.x)) - k)
    if np.any(misfit > np.maximum(_MISSED_ERRORS * error, _MISSED_PART * np.abs(k))):
        return ()
    inverse = pseudo_inverse(weight[:, None] * _gradient(separation, best.x)) * weight[None, :]
    covariance = inverse @ np.asarray(fit.covariance) @ inverse.T
    units = {constant.name: constant.unit for constant in system.unknown}
    return tuple(
        ConstantEstimate(name, units[name], float(best.x[i]), float(np.sqrt(covariance[i, i])))
        for i, name in enumerate(separation.symbols)
        if name in alone
    )

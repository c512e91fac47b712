"""Fit of factorised equations: minimum, refinement, robust loss and errors.

It joins `_minimum`, `_correction`, `_losses` and `_standard_errors`.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ._compiled import on_host, untraced
from ._correction import corrected, needs_correction
from ._factors import JointFactors, Unknowns
from ._fixed import Fixed
from ._identification import Identification
from ._losses import Loss, robust_residuals
from ._minimum import JointWeights, Solution, minimum, minimum_coefficients, weighted_minimum
from ._rows import AbstractRows
from ._standard_errors import Errors, independent_errors, ordinary_residuals, with_errors


def fit_of_factors(
    unknowns: Unknowns,
    factors: JointFactors,
    rows: AbstractRows | None,
    fixed: Fixed | None,
    sums: Callable[[Any], Any] | None,
    *,
    joint_weights: JointWeights,
    loss: Loss,
    errors: Errors,
    rcond: float | None,
) -> Identification:
    """The fit of factorised equations, on the host or compiled.

    **Arguments**

    - `unknowns`, `factors`: the coefficients, and the triangles of every joint's equations.
    - `rows`: the equations themselves, for a second pass; None for ordinary least squares with
      errors for independent noise.
    - `fixed`: coefficients that keep their values, or None.
    - `sums`: `residual_sums` as a function of coefficients, where the patterns can be passed again.
    - the others: as of `LeastSquares`.
    """
    factors, fixed = untraced((factors, fixed))
    solution, weights = ordinary_minimum(unknowns, factors, fixed, joint_weights, rcond)
    if sums is not None and needs_correction(unknowns, factors, solution, weights):
        solution = corrected(unknowns, solution, weights, sums(solution.k))
    if rows is None:
        return _independent(unknowns, factors, solution, fixed)
    if on_host((rows, factors, solution, fixed)) and loss == "squared":
        with np.errstate(divide="ignore", invalid="ignore"):
            residuals = ordinary_residuals(rows, solution, weights)
            return with_errors(rows, factors, residuals, errors, fixed)
    factors, solution, weights = jax.tree.map(jax.device_put, (factors, solution, weights))
    if loss == "squared":
        residuals = _ordinary_residuals(rows, solution, weights)
    else:
        residuals = _robust_residuals(
            rows,
            factors,
            solution,
            weights,
            residual_weights=isinstance(joint_weights, str) and joint_weights == "residual",
            loss=loss,
            rcond=rcond,
            fixed=fixed,
        )
    return _with_errors(rows, factors, residuals, errors, fixed)


def ordinary_minimum(
    unknowns: Unknowns,
    factors: JointFactors,
    fixed: Fixed | None,
    joint_weights: JointWeights,
    rcond: float | None,
) -> tuple[Solution, Array | np.ndarray]:
    """The ordinary solution, and the weights of joints that it ended with.

    On the host unless JAX is tracing: there is less to compute than to compile.
    """
    factors, fixed = untraced((factors, fixed))
    here = on_host((factors, fixed))
    solve = minimum if here else _compiled_minimum
    before = None
    if here and fixed is None:
        before = lambda weights: minimum_coefficients(unknowns, factors, weights, rcond)
    # NaN is the answer where there is none, as JAX has it.
    with np.errstate(divide="ignore", invalid="ignore"):
        return weighted_minimum(
            unknowns,
            factors,
            joint_weights,
            lambda weights: solve(unknowns, factors, weights, rcond, fixed),
            before=before,
        )


def _independent(
    unknowns: Unknowns, factors: JointFactors, solution: Solution, fixed: Fixed | None
) -> Identification:
    if not on_host((factors, solution, fixed)):
        return _independent_errors(unknowns, factors, solution, fixed)
    with np.errstate(divide="ignore", invalid="ignore"):
        return independent_errors(unknowns, factors, solution, fixed)


_compiled_minimum = eqx.filter_jit(minimum)
_independent_errors = eqx.filter_jit(independent_errors)
_ordinary_residuals = eqx.filter_jit(ordinary_residuals)
_robust_residuals = eqx.filter_jit(robust_residuals)
_with_errors = eqx.filter_jit(with_errors)

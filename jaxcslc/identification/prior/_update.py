from collections.abc import Mapping
from typing import Any, overload

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Int

from ..._rank import null_vectors, pseudo_inverse
from ...inertia import Known
from ..solver import RESULTS, FoldFit, Identification


# A coefficient that shares this part of a unit null vector is not determined by itself.
_SHARE = 1e-6
# Singular values below this part of the largest are rounding of the fit's covariance.
_SMALLEST = 1e-9
# Standard errors are taken as no less than this part of their coefficient.
_FINEST = 1e-6


@overload
def with_knowledge(fit: Identification, known: Mapping[int, Known]) -> Identification: ...
@overload
def with_knowledge(fit: FoldFit, known: Mapping[int, Known]) -> FoldFit: ...
def with_knowledge(
    fit: Identification | FoldFit, known: Mapping[int, Known]
) -> Identification | FoldFit:
    """A fit to which is added what was known of its coefficients before.

    Least squares with a row more for each value, in units of its error. The equations of the
    recording enter by the fit and its covariance for independent errors, which say of them all that
    least squares need to know. So the new coefficients minimise

        (k - k₀)ᵀ C⁻¹ (k - k₀) + Σ ((kᵢ - valueᵢ) / errorᵢ)²

    where k₀ and C are the fit's, C⁻¹ on the combinations that it determines; fixed coefficients
    have their values, and bounds hold. Where nothing determines a combination, the change of the
    fit is the least one, coefficients in units of their size. Standard errors follow what the fit's
    errors and those of the values do to the result; at bounds that are reached they are those
    without bounds.

    **Arguments**

    - `fit`: an `Identification` or a fit without a fold.
    - `known`: by index of a coefficient.

    **Returns** a fit of the same kind.
    """
    if not known:
        return fit
    k = np.asarray(fit.k, float)
    fixed = np.array([i for i, entry in known.items() if entry.fixed], int)
    free = np.setdiff1d(np.arange(len(k)), fixed)
    values = np.array([known[i].value for i in fixed], float)
    white = information_rows(fit, k)
    soft = [(i, entry) for i, entry in known.items() if entry.error > 0.0]
    rows = np.zeros((len(soft), len(k)))
    target = np.zeros(len(soft))
    for row, (i, entry) in enumerate(soft):
        rows[row, i] = 1.0 / entry.error
        target[row] = float(entry.value or 0.0) / entry.error
    start = k.copy()
    start[fixed] = values
    matrix = np.concatenate([white, rows])
    missing = np.concatenate([white @ (k - start), target - rows @ start])
    inverse = pseudo_inverse(matrix[:, free], _SMALLEST)
    null = null_vectors(matrix[:, free], _SMALLEST)
    change = inverse @ missing
    start[free] += change
    start = _within_bounds(start, matrix, missing, free, known, change)

    # What errors of the fit and of the values do to the coefficients that are not fixed.
    of_white, of_values = np.split(inverse, [len(white)], axis=1)
    follow = np.zeros((len(free), len(k)))
    follow[:, free] = np.eye(len(free)) - of_values @ rows[:, free]
    follow[:, fixed] = of_white @ white[:, fixed]

    def covariance_of(covariance: Any) -> Float[np.ndarray, "coefficients coefficients"]:
        whole = np.zeros((len(k), len(k)))
        part = follow @ np.asarray(covariance) @ follow.T + of_values @ of_values.T
        whole[np.ix_(free, free)] = part
        return whole

    undetermined = np.zeros((len(k), len(k)))
    undetermined[np.ix_(np.arange(len(null)), free)] = null
    if isinstance(fit, FoldFit):
        return FoldFit(start, covariance_of(fit.covariance), undetermined)
    scale = np.linalg.norm(matrix, axis=0)
    shares = undetermined * np.where(scale > 0, scale, 1.0)
    lengths = np.linalg.norm(shares, axis=1, keepdims=True)
    shares = shares / np.where(lengths > 0, lengths, 1.0)
    determined = np.sqrt(np.sum(shares**2, axis=0)) < _SHARE
    covariance = covariance_of(fit.covariance)
    error = np.where(determined, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.inf)
    deficient = RESULTS.rank_deficient if len(null) else RESULTS.successful
    rank = len(free) - len(null)
    changed = (
        *(start, error, covariance, covariance_of(fit.independent_covariance)),
        *(undetermined, determined, np.asarray(rank), deficient),
    )
    return eqx.tree_at(
        lambda f: (
            *(f.k, f.standard_error, f.covariance, f.independent_covariance),
            *(f.undetermined, f.determined, f.rank, f.result),
        ),
        fit,
        tuple(jnp.asarray(x) if isinstance(x, np.ndarray) else x for x in changed),
        is_leaf=lambda x: x is fit.result,
    )


def information_rows(
    fit: Identification | FoldFit, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "rank coefficients"]:
    """Rows whose product with a change of the coefficients is that of the fit's equations, up to a
    rotation, in units of the residual.

    **Arguments**

    - `fit`: an `Identification` or a fit without a fold; `k`: (p,) its coefficients.

    A change is one within the covariance's range and one that the fit leaves open. The former
    counts by the inverse of the covariance, the latter not at all. Neither rank is guessed.
    """
    independent = fit.independent_covariance if isinstance(fit, Identification) else fit.covariance
    covariance, open_rows = np.asarray(independent, float), np.asarray(fit.undetermined, float)
    open_rows = open_rows[np.linalg.norm(open_rows, axis=1) > 0.0]
    rank = len(k) - len(open_rows)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # Of coefficients that nothing depends on, values and errors are rounding.
    rounding = error + np.abs(k) < _SMALLEST * np.max(error + np.abs(k), initial=0.0)
    units = np.where(rounding, 1.0, error + _FINEST * np.abs(k))
    scaled = covariance / np.outer(units, units)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2 + _FINEST**2 * np.eye(len(k)))
    basis = np.linalg.qr((open_rows / units).T)[0] if len(open_rows) else np.zeros((len(k), 0))
    parts = np.linalg.inv(np.concatenate([vectors[:, len(k) - rank :], basis], axis=1))
    rows = parts[:rank] / np.sqrt(values[len(k) - rank :])[:, None]
    return np.where(rounding, 0.0, rows / units)


def _within_bounds(
    k: Float[np.ndarray, " coefficients"],
    matrix: Float[np.ndarray, "rows coefficients"],
    missing: Float[np.ndarray, " rows"],
    free: Int[np.ndarray, " free"],
    known: Mapping[int, Known],
    change: Float[np.ndarray, " free"],
) -> Float[np.ndarray, " coefficients"]:
    """The minimum within bounds, if that without them is not."""
    low, high = np.full(len(k), -np.inf), np.full(len(k), np.inf)
    for i, entry in known.items():
        low[i], high[i] = entry.low, entry.high
    if np.all((k >= low) & (k <= high)):
        return k
    before = k[free] - change
    scale = np.linalg.norm(matrix[:, free], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solution = scipy.optimize.lsq_linear(
        matrix[:, free] / scale,
        missing,
        ((low[free] - before) * scale, (high[free] - before) * scale),
        method="bvls",
    )
    k = k.copy()
    k[free] = np.clip(before + solution.x / scale, low[free], high[free])
    return k

"""Least-squares solution of factorised equations, joints weighted, and solutions by fold."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._environment import array_namespace
from .._rank import rank_tolerance
from ._factors import JointFactors, Unknowns, triangle_of
from ._fixed import Fixed


# Weights settle to a percent in two rounds: residuals hardly depend on them.
_ROUNDS = 3
# A coefficient that shares this part of a unit null vector is not determined by itself.
_SHARE = 1e-6

# NumPy's arrays or JAX's.
Numbers = Any

JointWeights = (
    Literal["equal", "residual"] | tuple[float, ...] | Float[Array | np.ndarray, " joints"]
)


class Solution(NamedTuple):
    """The minimum of weighted factorised equations, before anything is said of errors.

    - `k`: (p,) coefficients.
    - `inverse_gram`: (p, p), the pseudo-inverse of the weighted regressor's Gram matrix.
    - `variance`: the sum of squared weighted residuals over the remaining degrees of freedom.
    - `inherited`: (p, p), what errors of fixed coefficients do to all; None without any.
    - the others: as in `Identification`.
    """

    k: Float[Numbers, "*batch coefficients"]
    inverse_gram: Float[Numbers, "*batch coefficients coefficients"]
    variance: Float[Numbers, "*batch"]
    rank: Int[Numbers, "*batch"]
    condition: Float[Numbers, "*batch"]
    undetermined: Float[Numbers, "*batch coefficients coefficients"]
    determined: Bool[Numbers, "*batch coefficients"]
    finite: Bool[Numbers, "*batch"]
    inherited: Float[Numbers, "*batch coefficients coefficients"] | None = None


def minimum(
    unknowns: Unknowns,
    factors: JointFactors,
    weights: Float[Numbers, "*batch joints"],
    rcond: float | None,
    fixed: Fixed | None = None,
) -> Solution:
    """The least-squares solution of factorised equations, joints weighted.

    A singular value decomposition of the one triangle that is left, its columns scaled to unit
    length. What fixed coefficients explain is taken off the target; their columns come behind
    those that are fitted, whose triangle then tells how the fitted ones would follow the fixed.
    Computed by NumPy if the factors are NumPy's, so that nothing is compiled, and by JAX otherwise.
    """
    xp = array_namespace(factors.counts)
    reduced = _reduced(xp, unknowns, factors, weights, fixed)
    matrix, target, scale = reduced.matrix, reduced.target, reduced.scale
    # NumPy's decomposition raises at NaN, which the result is to tell of.
    decomposed = xp.where(reduced.finite[..., None, None], matrix, 0.0)
    left, singular, right = xp.linalg.svd(decomposed, full_matrices=False)
    equations = xp.sum(factors.counts, axis=-1)
    tolerance = xp.asarray(rank_tolerance(matrix.shape[-1], equations, rcond))
    counted = singular > tolerance[..., None] * singular[..., :1]
    rank = xp.sum(counted, axis=-1)
    inverse = xp.where(counted, 1.0 / xp.where(counted, singular, 1.0), 0.0)
    projected = _times(xp.swapaxes(left, -1, -2), target)
    columns = xp.swapaxes(right, -1, -2)
    k = _times(columns, inverse * projected) / scale

    # Residual of the weighted equations: what the triangle leaves out, and what rank left out.
    lost = xp.where(counted, 0.0, projected)
    degrees_of_freedom = xp.maximum(equations - rank, 1.0)
    squares = xp.sum(reduced.remainder**2, axis=-1) + xp.sum(lost**2, axis=-1)
    half = columns * inverse[..., None, :] / scale[..., :, None]

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = xp.where(counted[..., :, None], 0.0, right)
    solution = Solution(
        k=k,
        inverse_gram=half @ xp.swapaxes(half, -1, -2),
        variance=squares / degrees_of_freedom,
        rank=rank,
        condition=singular[..., 0]
        / xp.min(xp.where(counted, singular, singular[..., :1]), axis=-1),
        undetermined=null / scale[..., None, :],
        determined=xp.sqrt(xp.sum(null**2, axis=-2)) < _SHARE,
        finite=reduced.finite,
    )
    if fixed is None:
        return solution
    return _among(xp, solution, fixed, -half @ xp.swapaxes(left, -1, -2) @ reduced.others)


@runtime_checkable
class Reduced(Protocol):
    """Interface of factors or products that weighting joints by residual needs."""

    @property
    def counts(self) -> Float[Numbers, "*batch joints"]:
        """Equations of each joint."""
        ...

    def root_mean_squares(
        self, unknowns: Unknowns, k: Float[Numbers, "*batch coefficients"]
    ) -> Float[Numbers, "*batch joints"]:
        """Torque error of each joint."""
        ...


def weighted_minimum(
    unknowns: Unknowns,
    factors: Reduced,
    joint_weights: JointWeights,
    solve: Callable[[Any], Any],
    *,
    before: Callable[[Any], Any] | None = None,
) -> tuple[Any, Any]:
    """Return the result of `solve` for the weights of joints, and these weights.

    - `joint_weights`: those of `LeastSquares`.
    - `solve`: a function of the weights (..., n) that returns what has coefficients `k`.
    - `before`: used in its place before the last of the rounds that weight joints by residual,
      where coefficients alone are needed.
    """
    xp = array_namespace(factors.counts)
    weights = xp.ones(factors.counts.shape)
    if not isinstance(joint_weights, str):
        n = len(unknowns.support)
        if len(joint_weights) != n:
            raise ValueError(f"joint_weights: expected {n} numbers, got {len(joint_weights)}")
        weights = weights * xp.asarray(joint_weights, float)
    by_residual = isinstance(joint_weights, str) and joint_weights == "residual"
    for _ in range(_ROUNDS if by_residual else 0):
        k = (before or solve)(weights).k
        weights = residual_weights(factors.root_mean_squares(unknowns, k), factors.counts)
    return solve(weights), weights


def residual_weights(
    error: Float[Numbers, "*batch joints"], counts: Float[Numbers, "*batch joints"]
) -> Float[Numbers, "*batch joints"]:
    """Return the reciprocal of each joint's residual as its weight.

    A joint without equations, or without error, has weight 1.
    """
    xp = array_namespace(error)
    largest = xp.max(error, axis=-1, keepdims=True)
    floor = xp.where(largest > 0, 1e-12 * largest, 1.0)
    return xp.where(counts > 0, 1.0 / xp.maximum(error, floor), 1.0)


class Coefficients(NamedTuple):
    """The coefficients of a minimum alone."""

    k: Float[Numbers, "*batch coefficients"]


def fold_coefficients(
    unknowns: Unknowns,
    factors: JointFactors,
    joint_weights: JointWeights,
    rcond: float | None,
) -> Float[np.ndarray, "folds coefficients"]:
    """The coefficients fitted to all folds but one, for each one left out.

    Triangles of folds stack like the patterns that they stand for, so no pattern is seen again.
    The minimum of `minimum`, in NumPy and without what only a final fit needs (rank, standard
    errors): a search for settings calls this some hundred times on a few hundred rows.

    - `factors`: of the folds, NumPy's arrays with a leading axis of folds.
    """
    others = _without_each_fold(factors)
    return weighted_minimum(
        unknowns,
        others,
        joint_weights,
        lambda weights: minimum_coefficients(unknowns, others, weights, rcond),
    )[0].k


def minimum_coefficients(
    unknowns: Unknowns,
    factors: JointFactors,
    weights: Float[np.ndarray, "*batch joints"],
    rcond: float | None,
) -> Coefficients:
    """The coefficients of `minimum` alone, in NumPy, in a third of its time where rank is full."""
    reduced = _reduced(np, unknowns, factors, weights, None)
    tolerance = rank_tolerance(unknowns.size, np.sum(factors.counts, axis=-1), rcond)
    try:
        inverse = np.linalg.inv(reduced.matrix)
    except np.linalg.LinAlgError:
        return Coefficients(minimum(unknowns, factors, weights, rcond).k)
    # Frobenius norms bound the singular values: where even the bounds are far enough apart,
    # the rank is full, and the triangle gives what its decomposition would.
    spread = np.linalg.norm(reduced.matrix, axis=(-2, -1)) * np.linalg.norm(inverse, axis=(-2, -1))
    if not np.all(spread * tolerance < 1.0):
        return Coefficients(minimum(unknowns, factors, weights, rcond).k)
    return Coefficients(_times(inverse, reduced.target) / reduced.scale)


class FoldFit(NamedTuple):
    """A fit to all folds but one, as far as bodies are fitted to it.

    - `k`: (p,) coefficients.
    - `covariance`: (p, p), for independent errors.
    - `undetermined`: (p, p), as of `Identification`.
    """

    k: Float[np.ndarray, " coefficients"]
    covariance: Float[np.ndarray, "coefficients coefficients"]
    undetermined: Float[np.ndarray, "coefficients coefficients"]


def fold_fits(
    unknowns: Unknowns, factors: JointFactors, joint_weights: JointWeights, rcond: float | None
) -> tuple[FoldFit, ...]:
    """The fits to all folds but one, for each one left out: `fold_coefficients` with covariances.

    - `factors`: of the folds, NumPy's arrays with a leading axis of folds.
    """
    others = _without_each_fold(factors)
    solution, _ = weighted_minimum(
        unknowns,
        others,
        joint_weights,
        lambda weights: minimum(unknowns, others, weights, rcond),
        before=lambda weights: minimum_coefficients(unknowns, others, weights, rcond),
    )
    covariance = solution.variance[:, None, None] * solution.inverse_gram
    return tuple(map(FoldFit, solution.k, covariance, solution.undetermined))


def _without_each_fold(factors: JointFactors) -> JointFactors:
    """Return, for each fold, the factors of all other folds."""
    folds = factors.counts.shape[0]
    kept = ~np.eye(folds, dtype=bool)
    triangles = tuple(
        triangle.reshape(-1, *triangle.shape[-1:])[_rows_of(kept, triangle.shape[-2])]
        for triangle in map(np.asarray, factors.triangles)
    )
    return JointFactors.of_rows(triangles, kept @ np.asarray(factors.counts))


def _rows_of(kept: Bool[np.ndarray, "folds others"], size: int) -> Int[np.ndarray, "folds rows"]:
    """Return, for each fold, the row indices of all other folds' triangles of a size."""
    others = [np.flatnonzero(row) for row in kept]
    return np.stack([(fold[:, None] * size + np.arange(size)).ravel() for fold in others])


class _Reduced(NamedTuple):
    """Triangle that is left of weighted equations.

    - `matrix`: (p, p) of fitted coefficients, columns of unit length; `scale`: their lengths.
    - `target`: (p,) right-hand side; `remainder`: what no coefficient changes.
    - `others`: (p, f), the columns of fixed coefficients.
    """

    matrix: Any
    target: Any
    remainder: Any
    scale: Any
    others: Any
    finite: Any


def _reduced(
    xp: ModuleType, unknowns: Unknowns, factors: JointFactors, weights: Any, fixed: Fixed | None
) -> _Reduced:
    size = unknowns.size
    free = np.arange(size) if fixed is None else np.array(fixed.free)
    p, columns = len(free), factors.stacked(unknowns, weights)
    if fixed is not None:
        order = np.concatenate([free, fixed.remaining])
        coefficients, target = columns[..., :size], columns[..., size:]
        # Fitted ones too: what they change by is then looked for, and nothing where they are free.
        target = target - _times(coefficients, fixed.k)[..., None]
        columns = xp.concatenate([coefficients[..., order], target], axis=-1)
    triangle = triangle_of(np.asarray(columns)) if xp is np else xp.linalg.qr(columns, mode="r")
    matrix = triangle[..., :p, :p]
    scale = xp.linalg.norm(matrix, axis=-2)
    scale = xp.where(scale > 0, scale, 1.0)
    return _Reduced(
        matrix / scale[..., None, :],
        triangle[..., :p, size],
        triangle[..., p:, size],
        scale,
        triangle[..., :p, p:size],
        xp.all(xp.isfinite(triangle), axis=(-2, -1)),
    )


def _among(xp: ModuleType, part: Solution, fixed: Fixed, follow: Any) -> Solution:
    """The solution for some coefficients as one for all.

    - `follow`: how the fitted coefficients change with those that are fixed.
    """
    p, free, remaining = len(fixed.k), np.array(fixed.free), fixed.remaining
    # The columns of the identity that belong to fitted and to fixed coefficients.
    fitted, kept = np.eye(p)[:, free], np.eye(p)[:, remaining]
    return Solution(
        k=fixed.k + fitted @ part.k,
        inverse_gram=fitted @ part.inverse_gram @ fitted.T,
        variance=part.variance,
        rank=part.rank,
        condition=part.condition,
        undetermined=np.eye(p, len(free)) @ part.undetermined @ fitted.T,
        determined=xp.where(fitted.any(axis=1), (fitted @ part.determined) > 0.5, fixed.determined),
        finite=part.finite & xp.all(xp.isfinite(fixed.k)),
        inherited=(fitted @ follow + kept) @ kept.T,
    )


def _times(matrix: Any, vector: Any) -> Any:
    return (matrix @ vector[..., None])[..., 0]

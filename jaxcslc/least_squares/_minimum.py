"""Least-squares solution of factorised equations, joints weighted, and solutions by fold.

`Fixed` coefficients keep known values, with their uncertainty.
"""

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._environment import array_namespace
from .._rank import rank_tolerance
from ..network import AbstractLinearNetwork
from ._columns import traced
from ._factors import JointFactors, Unknowns, triangle_of
from ._identification import Identification


# Of residuals, as a part of the torque: what is smaller is rounding.
_ROUNDING = 1e-12
# A coefficient that shares this part of a unit null vector is not determined by itself: rounding of
# null vectors, whose singular values are at least 10^-14 of the largest, is below it.
UNDETERMINED_SHARE = 1e-6

# NumPy's arrays or JAX's.
Numbers = Any

Previous = Identification | Float[Array | np.ndarray, " coefficients"]
"""Result of an earlier identification, or its coefficients alone."""


class Fixed(eqx.Module):
    """Coefficients that keep their values in a fit, and how well these are known.

    **Attributes**

    - `free`: indices of those that are fitted.
    - `k`: (p,) what the others are fixed at, and what the fitted ones are near where a fit has a
      choice.
    - `covariance`, `independent_covariance`: (p, p), `determined`: (p,), as in `Identification`;
      what they say of fitted coefficients is not used.
    - `degrees_of_freedom`: that belongs to the covariance.
    """

    free: tuple[int, ...] = eqx.field(static=True)
    k: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    independent_covariance: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    degrees_of_freedom: Float[Array, ""]

    @classmethod
    def except_for(
        cls, network: AbstractLinearNetwork, previous: Previous, groups: Sequence[str]
    ) -> "Fixed":
        """Keep the values of `previous` except those of `groups`.

        It may end before the last ones if those are all fitted.

        **Raises** `ValueError` for names that are none, and for another network's `previous`.
        """
        free = tuple(
            i for i in _indices(network, groups) if network.names[i] not in network.known_values
        )
        # Sizes are the robot's: padded by JAX, each would be compiled.
        xp: Any = jnp if traced(previous) else np
        values = xp.asarray(previous.k if isinstance(previous, Identification) else previous)
        size, missing = len(values), network.size - len(values)
        if missing < 0 or not {*range(size, network.size)} <= set(free):
            raise ValueError(f"previous: expected {network.size} coefficients, got {size}")
        if isinstance(previous, Identification):
            if previous.names != network.names[:size]:
                raise ValueError(
                    f"previous: its coefficients are {previous.names[0]} to {previous.names[-1]}"
                    f" ({size});"
                    f" {network.name!r} has {network.names[0]} to {network.names[-1]}"
                    f" ({network.size})"
                )
            covariances = previous.covariance, previous.independent_covariance
            determined, degrees_of_freedom = previous.determined, previous.degrees_of_freedom
        else:
            covariances = (np.zeros((size, size)),) * 2
            determined, degrees_of_freedom = np.ones(size, bool), np.array(np.inf)
        padded = [xp.pad(xp.asarray(x), (0, missing)) for x in (values, *covariances)]
        known = xp.pad(xp.asarray(determined), (0, missing), constant_values=True)
        return cls(
            free,
            *(jnp.asarray(x, float) for x in padded),
            determined=jnp.asarray(known, bool),
            degrees_of_freedom=jnp.asarray(degrees_of_freedom, float),
        )

    @classmethod
    def from_known(cls, network: AbstractLinearNetwork) -> "Fixed | None":
        """Return the coefficients that are numbers (`network.known_values`), without errors; None
        if none is.
        """
        if not (known := network.known_values):
            return None
        free = tuple(i for i, name in enumerate(network.names) if name not in known)
        k = np.array([known.get(name, 0.0) for name in network.names])
        none = jnp.zeros((len(k), len(k)))
        return cls(free, jnp.asarray(k), none, none, jnp.ones(len(k), bool), jnp.asarray(jnp.inf))

    @property
    def remaining(self) -> Int[np.ndarray, " fixed"]:
        """Indices of those that are not fitted."""
        return np.setdiff1d(np.arange(len(self.k)), self.free)


def check_nothing_known(network: AbstractLinearNetwork, what: str) -> None:
    """**Raises** `ValueError` if coefficients are numbers, which `what` would fit."""
    if known := network.known_values:
        raise ValueError(
            f"{what}: {', '.join(known)} of {network.name!r} are fixed by known masses, which"
            " only LeastSquares.fit supports; pass what is known as a prior instead"
        )


JointWeights = (
    Literal["equal", "residual"] | tuple[float, ...] | Float[Array | np.ndarray, " joints"]
)
"""Weights of the joints' equations: equal, by residual, or given."""


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
    """Return the least-squares solution of factorised equations, joints weighted.

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

    # Without any regressor, there is no smallest singular value.
    least = xp.min(xp.where(counted, singular, singular[..., :1]), axis=-1)
    condition = xp.where(least > 0.0, singular[..., 0] / xp.where(least > 0.0, least, 1.0), xp.inf)

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = xp.where(counted[..., :, None], 0.0, right)
    solution = Solution(
        k=k,
        inverse_gram=half @ xp.swapaxes(half, -1, -2),
        variance=squares / degrees_of_freedom,
        rank=rank,
        condition=condition,
        undetermined=null / scale[..., None, :],
        determined=xp.sqrt(xp.sum(null**2, axis=-2)) < UNDETERMINED_SHARE,
        finite=reduced.finite,
    )
    if fixed is None:
        return solution
    return _among(xp, solution, fixed, -half @ xp.swapaxes(left, -1, -2) @ reduced.others)


def joint_weights_of(
    unknowns: Unknowns,
    factors: JointFactors,
    joint_weights: JointWeights,
    rcond: float | None,
    fixed: Fixed | None = None,
) -> Float[Numbers, "*batch joints"]:
    """Return the weights of joints that a fit ends with.

    - `joint_weights`, `rcond`: of `LeastSquares`.
    """
    weights = first_weights(unknowns, factors.counts, joint_weights)
    if joint_weights != "residual":
        return weights

    def errors(weights: Float[Numbers, "*batch joints"]) -> Float[Numbers, "*batch joints"]:
        k = minimum_coefficients(unknowns, factors, weights, rcond, fixed)
        return factors.root_mean_squares(unknowns, k)

    scale = factors.counts, factors.torque_scale(), unknowns.joint_sizes
    return weights_by_residual(errors, weights, *scale)


def first_weights(
    unknowns: Unknowns, counts: Float[Numbers, "*batch joints"], joint_weights: JointWeights
) -> Float[Numbers, "*batch joints"]:
    """Return the weights of joints that are given; 1 if they are not."""
    xp = array_namespace(counts)
    weights = xp.ones(counts.shape)
    if isinstance(joint_weights, str):
        return weights
    n = len(unknowns.support)
    if len(joint_weights) != n:
        raise ValueError(f"joint_weights: expected {n} numbers, got {len(joint_weights)}")
    return weights * xp.asarray(joint_weights, float)


def weights_by_residual(
    errors: Callable[[Float[Numbers, "*batch joints"]], Float[Numbers, "*batch joints"]],
    weights: Float[Numbers, "*batch joints"],
    counts: Float[Numbers, "*batch joints"],
    torque: Float[Numbers, "*batch joints"],
    sizes: Float[Numbers, " joints"],
) -> Float[Numbers, "*batch joints"]:
    """Return weights of joints by the residuals of fits with the weights before.

    - `errors`: root mean square residuals of the fit with some weights; `weights`: of the first.
    - `counts`, `torque`, `sizes`: as of `residual_weights`.
    """
    # Weights settle to a percent in two rounds: residuals barely depend on them.
    for number in range(3):
        # Residuals of equal weights do not tell yet what is usual: weak joints have large ones.
        usual = sizes if number else None
        weights = residual_weights(errors(weights), counts, torque, usual)
    return weights


def residual_weights(
    error: Float[Numbers, "*batch joints"],
    counts: Float[Numbers, "*batch joints"],
    torque: Float[Numbers, "*batch joints"],
    sizes: Float[Numbers, " joints"] | None,
) -> Float[Numbers, "*batch joints"]:
    """Return the reciprocal of each joint's noise as its weight; 1 of a joint without equations.

    The noise is the residual, and no less than what a fit can hide of the usual noise
    (`hidden_noise`): of the median of the joints' residuals as parts of their torques; or of the
    torques, where no joint has more equations than coefficients. So a joint that barely moves has
    no greater weight than others.

    - `error`, `torque`: root mean squares of residuals and of torques.
    - `counts`: of equations; `sizes`: how many coefficients each joint's equations depend on; None
      for residuals as they are.
    """
    xp = array_namespace(error)
    # Torque that is rounding beside that of other joints is none.
    some = torque > _ROUNDING * xp.max(torque, axis=-1, keepdims=True)
    parts = error / xp.where(some, torque, 1.0)
    floor = _ROUNDING
    if sizes is not None:
        hidden = hidden_noise(parts, xp.where(some, counts, 0.0), sizes, xp.ones_like(parts))
        floor = xp.maximum(hidden, floor)
    noise = xp.maximum(error, floor * torque)
    # A joint whose torque is always zero says nothing of its noise.
    largest = xp.max(xp.where(counts > 0, noise, 0.0), axis=-1, keepdims=True)
    noise = xp.where(some, noise, largest)
    return xp.where((counts > 0) & (noise > 0), 1.0 / xp.where(noise > 0, noise, 1.0), 1.0)


def hidden_noise(
    noise: Float[Numbers, "*batch fits"],
    counts: Float[Numbers, "*batch fits"],
    sizes: Float[Numbers, "..."],
    otherwise: Float[Numbers, "..."],
) -> Float[Numbers, "*batch fits"]:
    """Return what fits may hide of noise that is usual among them, the median.

    p coefficients follow any torque in p of N equations: only the other N - p tell of noise. The
    usual noise counts as one more that does, as it would in a prior for the variance. A fit of as
    many equations as coefficients, whose residual is zero, is then as noisy as is usual; one of
    10,000 equations may have a hundredth of the usual noise.

    - `noise`: root mean square residuals; `counts`: N, of equations; `sizes`: p, of coefficients.
    - `otherwise`: the usual noise where no fit has more equations than coefficients.
    """
    xp = array_namespace(noise)
    usual = _median(xp, noise, counts > sizes, otherwise)
    return usual / xp.sqrt(xp.maximum(counts - sizes, 0.0) + 1.0)


def _median(xp: ModuleType, values: Any, counted: Any, otherwise: Any) -> Any:
    """The median along the last axis of the values that are counted; `otherwise` of none."""
    ordered = xp.sort(xp.where(counted, values, xp.inf), axis=-1)
    number = xp.sum(counted, axis=-1, keepdims=True)
    low, high = (
        xp.take_along_axis(ordered, index, axis=-1)
        for index in (xp.maximum(number - 1, 0) // 2, xp.minimum(number // 2, values.shape[-1] - 1))
    )
    return xp.where(number > 0, 0.5 * (low + high), otherwise)


def minimum_coefficients(
    unknowns: Unknowns,
    factors: JointFactors,
    weights: Float[Numbers, "*batch joints"],
    rcond: float | None,
    fixed: Fixed | None = None,
) -> Float[Numbers, "*batch coefficients"]:
    """Return the coefficients of `minimum` alone, in a third of its time where rank is full."""
    xp = array_namespace(factors.counts)
    if xp is np and fixed is None:
        reduced = _reduced(np, unknowns, factors, weights, None)
        tolerance = rank_tolerance(unknowns.size, np.sum(factors.counts, axis=-1), rcond)
        try:
            inverse = np.linalg.inv(reduced.matrix)
        except np.linalg.LinAlgError:
            return minimum(unknowns, factors, weights, rcond).k
        # Frobenius norms bound the singular values: where even the bounds are far enough apart,
        # the rank is full, and the triangle gives what its decomposition would.
        norms = (np.linalg.norm(x, axis=(-2, -1)) for x in (reduced.matrix, inverse))
        if np.all(np.prod([*norms], axis=0) * tolerance < 1.0):
            return _times(inverse, reduced.target) / reduced.scale
    return minimum(unknowns, factors, weights, rcond, fixed).k


def fold_coefficients(
    unknowns: Unknowns,
    factors: JointFactors,
    joint_weights: JointWeights,
    rcond: float | None,
) -> Float[np.ndarray, "folds coefficients"]:
    """Return the coefficients fitted to all folds but one, for each held-out fold.

    Triangles of folds stack like the patterns that they stand for, so no pattern is seen again.

    - `factors`: of the folds, NumPy's arrays with a leading axis of folds.
    """
    others = _without_each_fold(factors)
    weights = joint_weights_of(unknowns, others, joint_weights, rcond)
    return minimum_coefficients(unknowns, others, weights, rcond)


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
    """Return the fits of `fold_coefficients` with covariances; arguments are the same."""
    others = _without_each_fold(factors)
    weights = joint_weights_of(unknowns, others, joint_weights, rcond)
    solution = minimum(unknowns, others, weights, rcond)
    covariance = solution.variance[:, None, None] * solution.inverse_gram
    return tuple(map(FoldFit, solution.k, covariance, solution.undetermined))


def _without_each_fold(factors: JointFactors) -> JointFactors:
    """Return, for each fold, the factors of all other folds."""
    kept = ~np.eye(len(factors.counts), dtype=bool)
    triangles = (
        np.stack([np.concatenate(of_joint[others]) for others in kept])
        for of_joint in map(np.asarray, factors.triangles)
    )
    return JointFactors.from_rows(tuple(triangles), kept @ np.asarray(factors.counts))


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
    triangle = triangle_of(columns)
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


def _indices(network: AbstractLinearNetwork, groups: Sequence[str]) -> tuple[int, ...]:
    """Indices of the coefficients of groups or of names, ascending."""
    names = (groups,) if isinstance(groups, str) else tuple(groups)
    there = dict.fromkeys(coefficient.group for coefficient in network.coefficients)
    listed = f"{', '.join(there)}, and names, {network.names[0]} to {network.names[-1]}"
    if not names:
        raise ValueError(f"groups: none is given; expected some of {listed}")
    for name in names:
        if name not in there and name not in network.names:
            raise ValueError(f"groups: there is no {name!r}; expected some of {listed}")
    return tuple(
        index
        for index, coefficient in enumerate(network.coefficients)
        if coefficient.group in names or coefficient.name in names
    )

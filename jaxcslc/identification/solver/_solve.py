import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...network import CSLC
from ._factors import JointFactors
from ._fixed import Fixed
from ._identification import Identification
from ._solution import RESULTS


class Solution(eqx.Module):
    """The minimum of factorised equations, before anything is said of errors.

    `inverse_gram` (p, p) is the pseudo-inverse of the weighted regressor's Gram matrix, `variance`
    the sum of squared weighted residuals over the remaining degrees of freedom; `inherited` (p, p)
    is what errors of fixed coefficients do to all, None without any; the others are as in
    `Identification`.
    """

    k: Float[Array, " coefficients"]
    inverse_gram: Float[Array, "coefficients coefficients"]
    variance: Float[Array, ""]
    rank: Int[Array, ""]
    condition: Float[Array, ""]
    undetermined: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    result: RESULTS
    inherited: Float[Array, "coefficients coefficients"] | None = None


def minimum(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
    fixed: Fixed | None = None,
) -> Solution:
    """The least-squares solution of factorised equations, joints weighted.

    A singular value decomposition of the one triangle that is left, its columns scaled to unit
    length so that neither rank nor condition depends on units. What fixed coefficients explain is
    taken off the target; their columns come behind those that are fitted, whose triangle then
    tells how the fitted ones would follow the fixed.
    """
    size = network.size
    free = np.arange(size) if fixed is None else np.array(fixed.free)
    p, columns = len(free), factors.stacked(network, weights)
    if fixed is not None:
        order = np.concatenate([free, fixed.remaining])
        columns = columns[:, np.append(order, size)]
        # Fitted ones too: what they change by is then looked for, and nothing where they are free.
        columns = columns.at[:, size].add(-columns[:, :size] @ fixed.k[order])
    triangle = jnp.linalg.qr(columns, mode="r")
    matrix, target, rest = triangle[:p, :p], triangle[:p, size], triangle[p:, size]
    scale = jnp.linalg.norm(matrix, axis=0)
    scale = jnp.where(scale > 0, scale, 1.0)
    left, singular, right = jnp.linalg.svd(matrix / scale[None, :], full_matrices=False)

    equations = jnp.sum(factors.counts)
    if rcond is None:
        # Rounding of a factorisation grows with its size; the factor 10 is a heuristic that
        # keeps columns that are proportional in exact arithmetic from counting as two.
        rcond_ = 10 * jnp.finfo(matrix.dtype).eps * jnp.maximum(p, jnp.sqrt(equations))
    else:
        rcond_ = jnp.asarray(rcond, matrix.dtype)
    counts = singular > rcond_ * singular[0]
    rank = jnp.sum(counts)
    inverse = jnp.where(counts, 1.0 / jnp.where(counts, singular, 1.0), 0.0)
    k = (right.T @ (inverse * (left.T @ target))) / scale

    # Residual of the weighted equations: what the triangle leaves out, and what rank left out.
    lost = jnp.where(counts, 0.0, left.T @ target)
    degrees_of_freedom = jnp.maximum(equations - rank, 1.0)
    variance = (jnp.sum(rest**2) + jnp.sum(lost**2)) / degrees_of_freedom
    half = (right.T * inverse[None, :]) / scale[:, None]

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = jnp.where(counts[:, None], 0.0, right) / scale[None, :]
    share = jnp.sqrt(jnp.sum(jnp.where(counts[:, None], 0.0, right) ** 2, axis=0))
    finite = jnp.all(jnp.isfinite(triangle))
    result = RESULTS.where(rank < p, RESULTS.rank_deficient, RESULTS.successful)
    result = RESULTS.where(equations < p, RESULTS.no_equations, result)
    solution = Solution(
        k=k,
        inverse_gram=half @ half.T,
        variance=variance,
        rank=rank,
        condition=singular[0] / jnp.min(jnp.where(counts, singular, singular[0])),
        undetermined=null,
        determined=share < 1e-6,
        result=RESULTS.where(finite, result, RESULTS.nonfinite),
    )
    return (
        solution
        if fixed is None
        else _among(solution, fixed, -half @ left.T @ triangle[:p, p:size])
    )


def _among(part: Solution, fixed: Fixed, follow: Float[Array, "fitted fixed"]) -> Solution:
    """The solution for some coefficients as one for all.

    - `follow`: how the fitted coefficients change with those that are fixed.
    """
    free, rest = np.array(fixed.free), fixed.remaining
    p = len(fixed.k)
    square = jnp.zeros((p, p))
    inherited = square.at[np.ix_(free, rest)].set(follow).at[rest, rest].set(1.0)
    finite = jnp.all(jnp.isfinite(fixed.k))
    return Solution(
        k=fixed.k.at[free].add(part.k),
        inverse_gram=square.at[np.ix_(free, free)].set(part.inverse_gram),
        variance=part.variance,
        rank=part.rank,
        condition=part.condition,
        undetermined=square.at[: len(free), free].set(part.undetermined),
        determined=fixed.determined.at[free].set(part.determined),
        result=RESULTS.where(finite, part.result, RESULTS.nonfinite),
        inherited=inherited,
    )


def solve(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
    fixed: Fixed | None = None,
) -> tuple[Solution, Identification]:
    """The least-squares fit of factorised equations, for errors that are independent."""
    solution = minimum(network, factors, weights, rcond, fixed)
    total = jnp.sum(factors.counts)
    return solution, identification(
        network,
        factors,
        solution,
        solution.variance * solution.inverse_gram,
        degrees_of_freedom=jnp.maximum(total - solution.rank, 1.0),
        effective=factors.counts,
        errors="independent",
        fixed=fixed,
    )


def identification(
    network: CSLC,
    factors: JointFactors,
    solution: Solution,
    covariance: Float[Array, "coefficients coefficients"],
    *,
    degrees_of_freedom: Float[Array, ""],
    effective: Float[Array, " joints"],
    errors: str,
    fixed: Fixed | None = None,
) -> Identification:
    """What users are handed; `factors` are those of all equations that count, unweighted.

    Errors of coefficients that were fixed have nothing to do with this recording's: covariances
    add up.
    """
    independent = solution.variance * solution.inverse_gram
    if fixed is not None and solution.inherited is not None:
        inherited = solution.inherited
        covariance = covariance + inherited @ fixed.covariance @ inherited.T
        independent = independent + inherited @ fixed.independent_covariance @ inherited.T
        degrees_of_freedom = jnp.minimum(degrees_of_freedom, fixed.degrees_of_freedom)
    norms = factors.residual_norms(network, solution.k)
    return Identification(
        k=solution.k,
        standard_error=jnp.where(solution.determined, jnp.sqrt(jnp.diag(covariance)), jnp.inf),
        covariance=covariance,
        independent_covariance=independent,
        torque_error=norms / jnp.sqrt(jnp.maximum(factors.counts, 1.0)),
        equations=factors.counts,
        effective_equations=effective,
        degrees_of_freedom=degrees_of_freedom,
        rank=solution.rank,
        condition=solution.condition,
        undetermined=solution.undetermined,
        determined=solution.determined,
        result=solution.result,
        names=network.names,
        errors=errors,
    )

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..network import CSLC
from ._factors import JointFactors
from ._identification import Identification
from ._solution import RESULTS


class Solution(eqx.Module):
    """The minimum of factorised equations, before anything is said of errors.

    `bread` (p, p) is the pseudo-inverse of the weighted regressor's Gram matrix, `variance` the
    mean square of the weighted residual for the degrees of freedom that are left; the others are
    as in `Identification`.
    """

    k: Float[Array, " coefficients"]
    bread: Float[Array, "coefficients coefficients"]
    variance: Float[Array, ""]
    rank: Int[Array, ""]
    condition: Float[Array, ""]
    undetermined: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    result: RESULTS


def minimum(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
) -> Solution:
    """The least-squares solution of factorised equations, joints weighted.

    A singular value decomposition of the one triangle that is left, its columns scaled to unit
    length so that neither rank nor condition depends on units.
    """
    triangle = jnp.linalg.qr(factors.stacked(network, weights), mode="r")
    p = network.size
    matrix, target, rest = triangle[:p, :p], triangle[:p, p], triangle[p, p]
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
    freedom = jnp.maximum(equations - rank, 1.0)
    variance = (rest**2 + jnp.sum(lost**2)) / freedom
    half = (right.T * inverse[None, :]) / scale[:, None]

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = jnp.where(counts[:, None], 0.0, right) / scale[None, :]
    share = jnp.sqrt(jnp.sum(jnp.where(counts[:, None], 0.0, right) ** 2, axis=0))
    finite = jnp.all(jnp.isfinite(triangle))
    result = RESULTS.where(rank < p, RESULTS.rank_deficient, RESULTS.successful)
    result = RESULTS.where(equations < p, RESULTS.no_equations, result)
    return Solution(
        k=k,
        bread=half @ half.T,
        variance=variance,
        rank=rank,
        condition=singular[0] / jnp.min(jnp.where(counts, singular, singular[0])),
        undetermined=null,
        determined=share < 1e-6,
        result=RESULTS.where(finite, result, RESULTS.nonfinite),
    )


def solve(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
) -> tuple[Solution, Identification]:
    """The least-squares fit of factorised equations, for errors that are independent."""
    solution = minimum(network, factors, weights, rcond)
    total = jnp.sum(factors.counts)
    return solution, identification(
        network,
        factors,
        solution,
        solution.variance * solution.bread,
        freedom=jnp.maximum(total - solution.rank, 1.0),
        effective=factors.counts,
        errors="independent",
    )


def identification(
    network: CSLC,
    factors: JointFactors,
    solution: Solution,
    covariance: Float[Array, "coefficients coefficients"],
    *,
    freedom: Float[Array, ""],
    effective: Float[Array, " joints"],
    errors: str,
) -> Identification:
    """What users are handed; `factors` are those of all equations that count, unweighted."""
    norms = factors.residual_norms(network, solution.k)
    return Identification(
        k=solution.k,
        standard_error=jnp.where(solution.determined, jnp.sqrt(jnp.diag(covariance)), jnp.inf),
        covariance=covariance,
        independent_covariance=solution.variance * solution.bread,
        torque_error=norms / jnp.sqrt(jnp.maximum(factors.counts, 1.0)),
        equations=factors.counts,
        effective_equations=effective,
        freedom=freedom,
        rank=solution.rank,
        condition=solution.condition,
        undetermined=solution.undetermined,
        determined=solution.determined,
        result=solution.result,
        names=network.names,
        errors=errors,
    )

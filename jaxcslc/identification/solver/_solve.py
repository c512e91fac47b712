import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...network import CSLC
from ._factors import JointFactors
from ._held import Held
from ._identification import Identification
from ._solution import RESULTS


class Solution(eqx.Module):
    """The minimum of factorised equations, before anything is said of errors.

    `bread` (p, p) is the pseudo-inverse of the weighted regressor's Gram matrix, `variance` the
    mean square of the weighted residual for the degrees of freedom that are left; `inherited`
    (p, p) is what errors of coefficients that were held do to all, None if none were; the others
    are as in `Identification`.
    """

    k: Float[Array, " coefficients"]
    bread: Float[Array, "coefficients coefficients"]
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
    held: Held | None = None,
) -> Solution:
    """The least-squares solution of factorised equations, joints weighted.

    A singular value decomposition of the one triangle that is left, its columns scaled to unit
    length so that neither rank nor condition depends on units. What held coefficients explain is
    taken off the target; their columns come behind those that are fitted, whose triangle then
    tells how the fitted ones would follow the held.
    """
    size = network.size
    free = np.arange(size) if held is None else np.array(held.free)
    p, columns = len(free), factors.stacked(network, weights)
    if held is not None:
        order = np.concatenate([free, held.rest])
        columns = columns[:, np.append(order, size)]
        # Fitted ones too: what they change by is then looked for, and nothing where they are free.
        columns = columns.at[:, size].add(-columns[:, :size] @ held.k[order])
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
    freedom = jnp.maximum(equations - rank, 1.0)
    variance = (jnp.sum(rest**2) + jnp.sum(lost**2)) / freedom
    half = (right.T * inverse[None, :]) / scale[:, None]

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = jnp.where(counts[:, None], 0.0, right) / scale[None, :]
    share = jnp.sqrt(jnp.sum(jnp.where(counts[:, None], 0.0, right) ** 2, axis=0))
    finite = jnp.all(jnp.isfinite(triangle))
    result = RESULTS.where(rank < p, RESULTS.rank_deficient, RESULTS.successful)
    result = RESULTS.where(equations < p, RESULTS.no_equations, result)
    solution = Solution(
        k=k,
        bread=half @ half.T,
        variance=variance,
        rank=rank,
        condition=singular[0] / jnp.min(jnp.where(counts, singular, singular[0])),
        undetermined=null,
        determined=share < 1e-6,
        result=RESULTS.where(finite, result, RESULTS.nonfinite),
    )
    return (
        solution if held is None else _among(solution, held, -half @ left.T @ triangle[:p, p:size])
    )


def _among(part: Solution, held: Held, follow: Float[Array, "fitted held"]) -> Solution:
    """The solution for some coefficients as one for all.

    - `follow`: how the fitted coefficients change with those that are held.
    """
    free, rest = np.array(held.free), held.rest
    p = len(held.k)
    square = jnp.zeros((p, p))
    inherited = square.at[np.ix_(free, rest)].set(follow).at[rest, rest].set(1.0)
    finite = jnp.all(jnp.isfinite(held.k))
    return Solution(
        k=held.k.at[free].add(part.k),
        bread=square.at[np.ix_(free, free)].set(part.bread),
        variance=part.variance,
        rank=part.rank,
        condition=part.condition,
        undetermined=square.at[: len(free), free].set(part.undetermined),
        determined=held.determined.at[free].set(part.determined),
        result=RESULTS.where(finite, part.result, RESULTS.nonfinite),
        inherited=inherited,
    )


def solve(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
    held: Held | None = None,
) -> tuple[Solution, Identification]:
    """The least-squares fit of factorised equations, for errors that are independent."""
    solution = minimum(network, factors, weights, rcond, held)
    total = jnp.sum(factors.counts)
    return solution, identification(
        network,
        factors,
        solution,
        solution.variance * solution.bread,
        freedom=jnp.maximum(total - solution.rank, 1.0),
        effective=factors.counts,
        errors="independent",
        held=held,
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
    held: Held | None = None,
) -> Identification:
    """What users are handed; `factors` are those of all equations that count, unweighted.

    Errors of coefficients that were held have nothing to do with this recording's: covariances
    add up.
    """
    independent = solution.variance * solution.bread
    if held is not None and solution.inherited is not None:
        inherited = solution.inherited
        covariance = covariance + inherited @ held.covariance @ inherited.T
        independent = independent + inherited @ held.independent_covariance @ inherited.T
        freedom = jnp.minimum(freedom, held.freedom)
    norms = factors.residual_norms(network, solution.k)
    return Identification(
        k=solution.k,
        standard_error=jnp.where(solution.determined, jnp.sqrt(jnp.diag(covariance)), jnp.inf),
        covariance=covariance,
        independent_covariance=independent,
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

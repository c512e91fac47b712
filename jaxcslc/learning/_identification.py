import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..network import CSLC
from ._factors import JointFactors
from ._solution import RESULTS
from ._undetermined import describe


class Identification(eqx.Module):
    """Coefficients found by a fit, and how far the patterns determine them.

    **Attributes**

    - `k`: (p,) coefficients, in the order of `network.coefficients`, in their units. Where the
      patterns leave a choice, the one of least norm after scaling every column to unit length.
    - `standard_error`: (p,) standard deviation of each, for independent residuals; infinite
      where the patterns do not determine it.
    - `covariance`: (p, p); entries of undetermined coefficients are those of the chosen solution.
    - `torque_error`: (n,) root mean square residual of each joint over the pairs that counted
      [N m or N].
    - `equations`: (n,) how many equations each joint took part with.
    - `rank`: of the regressor.
    - `condition`: ratio of the largest to the smallest singular value that counts, columns
      scaled to unit length.
    - `undetermined`: (p, p), its rows span the combinations of coefficients that can be added to
      `k` without changing any torque; rows beyond p - rank are zero.
    - `determined`: (p,) whether the patterns determine the coefficient by itself.
    - `result`: a member of `RESULTS`.
    - `names`: of the coefficients.
    """

    k: Float[Array, " coefficients"]
    standard_error: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    torque_error: Float[Array, " joints"]
    equations: Float[Array, " joints"]
    rank: Int[Array, ""]
    condition: Float[Array, ""]
    undetermined: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """What the patterns cannot tell, in words: coefficients, and what is known of them.

        One entry for every group of coefficients that the patterns leave undetermined, with the
        combinations of them that are determined. Not available under `jit`.
        """
        return describe(np.asarray(self.undetermined), self.names)

    def __repr__(self) -> str:
        if isinstance(self.k, Tracer) or self.k.ndim != 1:
            return f"Identification({len(self.names)} coefficients, batch {self.k.shape[:-1]})"
        rms = ", ".join(f"{value:.3g}" for value in np.asarray(self.torque_error))
        return (
            f"Identification({len(self.names)} coefficients, rank {int(self.rank)}, condition"
            f" {float(self.condition):.3g}, torque error per joint [{rms}])"
        )


def solve(
    network: CSLC,
    factors: JointFactors,
    weights: Float[Array, " joints"],
    rcond: float | None,
) -> Identification:
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
    covariance = variance * half @ half.T

    # Null space of the scaled matrix, brought back to the coefficients' units.
    null = jnp.where(counts[:, None], 0.0, right) / scale[None, :]
    share = jnp.sqrt(jnp.sum(jnp.where(counts[:, None], 0.0, right) ** 2, axis=0))
    determined = share < 1e-6
    norms = factors.residual_norms(network, k)
    finite = jnp.all(jnp.isfinite(triangle))
    result = RESULTS.where(rank < p, RESULTS.rank_deficient, RESULTS.successful)
    result = RESULTS.where(equations < p, RESULTS.no_equations, result)
    result = RESULTS.where(finite, result, RESULTS.nonfinite)
    return Identification(
        k=k,
        standard_error=jnp.where(determined, jnp.sqrt(jnp.diag(covariance)), jnp.inf),
        covariance=covariance,
        torque_error=norms / jnp.sqrt(jnp.maximum(factors.counts, 1.0)),
        equations=factors.counts,
        rank=rank,
        condition=singular[0] / jnp.min(jnp.where(counts, singular, singular[0])),
        undetermined=null,
        determined=determined,
        result=result,
        names=network.names,
    )

"""Iterative refinement of a solution by sums in double words.

Sums follow Ogita, Rump and Oishi, 'Accurate sum and dot product' (2005). `_factors_fit` uses it.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import AbstractLinearNetwork
from ._factors import JointFactors, Unknowns, weighted_rows
from ._minimum import Numbers, Solution
from ._preconditioned import block_at


# Standard errors by which rounding may move a coefficient.
_LARGEST_ERROR = 1e-9
# Errors of factors in units of rounding, on 65,536 random states of a PUMA 560 and a Panda beside
# exact solutions: of the torque's length over the noise, and of the condition number times the root
# of the number of equations. Both are upper ends.
_OF_TORQUE, _OF_CONDITION = 8.0, 0.5
# Patterns whose products are added to sums of their own, a power of two; joined in the end.
_CPU_LANES, _GPU_LANES = 1 << 11, 1 << 17
# Of a float64's 52 bits the upper half: products of such numbers are exact.
_UPPER_HALF = -(1 << 27)


def needs_correction(
    unknowns: Unknowns,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Numbers, " joints"],
) -> bool:
    """Return whether rounding of the factors may move a coefficient by 10^-9 of its standard error.

    Triangles are those of rows that rounding has changed. That moves coefficients by the
    condition number times the part of the residual that is then along the columns, which grows
    with the root of the number of equations, while standard errors shrink.
    """
    if not solution.finite:
        return False
    torque = [w * x[:, -1] for w, x in zip(weights, factors.triangles, strict=True)]
    torque = np.linalg.norm(np.concatenate(torque))
    noise = np.sqrt(solution.variance)
    in_noise = torque / noise if noise > 0.0 else np.inf if torque > 0.0 else 0.0
    of_condition = solution.condition * np.sqrt(np.sum(factors.counts))
    unit = 0.5 * np.finfo(float).eps
    return bool(unit * (_OF_TORQUE * in_noise + _OF_CONDITION * of_condition) > _LARGEST_ERROR)


def corrected(
    unknowns: Unknowns,
    solution: Solution,
    weights: Float[Numbers, " joints"],
    sums: Sequence[Float[np.ndarray, "2 entries"]],
) -> Solution:
    """The solution after one step of iterative refinement.

    What is left of the equations by the first solution is computed from the rows themselves, its
    products with the columns are summed in twice the precision, and the factors need then be good
    to some digits only: 'corrected seminormal equations' (Björck, 'Stability analysis of the method
    of seminormal equations for linear least squares problems', Linear Algebra and its Applications
    1987, doi:10.1016/0024-3795(87)90101-7), with double-word sums in place of single ones, since
    a sum of 10^8 products is rounded by more than the columns are.

    - `sums`: of `residual_sums`, for the solution's coefficients; of one or several sets of
      patterns.
    """
    # Joints cancel each other at the minimum.
    total = np.zeros(unknowns.size, np.longdouble)
    number = np.sum(np.asarray(sums, np.longdouble), axis=(0, 1))
    first = 0
    for support, weight in zip(unknowns.support, weights, strict=True):
        of_joint = number[first : first + len(support)]
        total[list(support)] += np.longdouble(weight) ** 2 * of_joint
        first += len(support)
    change = solution.inverse_gram @ total.astype(float)
    return solution._replace(k=solution.k + change)


def residual_sums(
    network: AbstractLinearNetwork,
    k: Float[Array, " coefficients"],
    *motion: Float[Array, "samples _"],
    on_gpu: bool,
) -> Float[Array, "2 entries"]:
    """Compute column times residual of `k`, per joint and coefficient of its support.

    Sums of exact products in double words (Ogita, Rump and Oishi, 'Accurate sum and dot product',
    SIAM J. Sci. Comput. 2005, doi:10.1137/030601818).

    **Returns** sums, and what rounding has taken off them.
    """
    lanes = _GPU_LANES if on_gpu else _CPU_LANES
    while lanes >= 2 * max(len(motion[0]), 1):
        lanes //= 2
    joint = np.repeat(np.arange(len(network.support)), [len(row) for row in network.support])

    def step(sums: tuple[Array, Array], start: Array) -> tuple[tuple[Array, Array], None]:
        rows = weighted_rows(network, *(x.T for x in block_at(motion, start, lanes)))
        residuals = [
            of_joint[-1] - k[np.array(support, dtype=int)] @ of_joint[:-1]
            for support, of_joint in zip(network.support, rows, strict=True)
        ]
        columns = jnp.concatenate([of_joint[:-1] for of_joint in rows])
        upper, lower = _product(columns, jnp.stack(residuals)[joint])
        total, rounded = _sum(sums[0], upper)
        return (total, sums[1] + (rounded + lower)), None

    empty = jnp.zeros((len(joint), lanes))
    starts = jnp.arange(0, max(len(motion[0]), 1), lanes)
    (total, small), _ = jax.lax.scan(step, (empty, empty), starts)
    while lanes > 1:
        lanes //= 2
        total, rounded = _sum(total[:, :lanes], total[:, lanes:])
        small = small[:, :lanes] + small[:, lanes:] + rounded
    return jnp.stack([total[:, 0], small[:, 0]])


def _product(x: Array, y: Array) -> tuple[Array, Array]:
    """A product as two numbers: that of the upper halves, which is exact, and what remains.

    By bits: a compiler may join the multiplications and additions of Dekker's splitting.
    """
    upper_x, upper_y = _upper_half(x), _upper_half(y)
    return upper_x * upper_y, upper_x * (y - upper_y) + (x - upper_x) * y


def _upper_half(x: Array) -> Array:
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    return jax.lax.bitcast_convert_type(bits & _UPPER_HALF, jnp.float64)


def _sum(x: Array, y: Array) -> tuple[Array, Array]:
    """A sum and its rounding error (Knuth)."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)

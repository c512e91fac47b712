import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...network import CSLC
from ._correlated import Errors, correlated_covariance, effective_counts, waves_for
from ._factors import JointFactors
from ._fixed import Fixed
from ._identification import Identification
from ._losses import Loss, influence, robust_scale, slope, weight
from ._rows import AbstractRows
from ._solution import RESULTS
from ._solve import Solution, identification, minimum


# Coefficients that change by less than this part of themselves have settled. Huber's rounds take
# some ten, the bisquare's some twenty.
_SETTLED = 1e-9
_ROUNDS = 100


class Residuals(NamedTuple):
    """What the errors of a fit are judged by: its solution, the weights of joints that went with
    it, and (instants, n) residuals, of a robust loss those of its pseudo-values."""

    solution: Solution
    weights: Float[Array, " joints"]
    residual: Float[Array, "instants joints"]


def ordinary_residuals(
    network: CSLC, rows: AbstractRows, solution: Solution, weights: Float[Array, " joints"]
) -> Residuals:
    """Of a fit that minimised squares."""
    return Residuals(solution, weights, _errors(network, rows, solution.k)[0])


def robust_residuals(
    network: CSLC,
    rows: AbstractRows,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Array, " joints"],
    *,
    residual_weights: bool,
    loss: Loss,
    rcond: float | None,
    fixed: Fixed | None = None,
) -> Residuals:
    """A fit by iteratively reweighted least squares (Holland and Welsch 1977).

    The scale of each joint's noise is taken from the median modulus of its errors. The
    bisquare's minimum is looked for from Huber's, which is the only one it has.

    To terms of higher order, a robust fit is an ordinary one to pseudo-values, whose residuals
    are psi(u) over the mean of psi'(u), times the scale (Street, Carroll and Ruppert, American
    Statistician 42, 1988): what holds for ordinary residuals holds for these.

    - `factors`: of the equations as they are.
    - `solution`: of ordinary least squares, to start from, with `weights`; with
      `residual_weights`, one over the robust scales take their place.
    """
    k = solution.k
    for stage in ("huber",) if loss == "huber" else ("huber", "bisquare"):
        k = _reweighted(network, rows, k, weights, residual_weights, stage, rcond, fixed)
    error, scale = _errors(network, rows, k)
    weights = 1.0 / scale if residual_weights else weights
    residual = _pseudo_residuals(rows, error, scale, loss)
    whole = minimum(network, factors, weights, rcond, fixed)
    squares = jnp.sum((weights[None, :] * residual) ** 2)
    return Residuals(
        dataclasses.replace(
            whole,
            k=k,
            variance=squares / jnp.maximum(jnp.sum(rows.counts) - whole.rank, 1.0),
            result=RESULTS.where(jnp.all(jnp.isfinite(k)), whole.result, RESULTS.nonfinite),
        ),
        weights,
        residual,
    )


def with_errors(
    network: CSLC,
    rows: AbstractRows,
    factors: JointFactors,
    found: Residuals,
    errors: Errors,
    fixed: Fixed | None = None,
) -> Identification:
    """The fit with standard errors that allow for independent or for correlated errors."""
    solution, weights, residual = found
    if errors == "independent":
        covariance = solution.variance * solution.inverse_gram
        degrees_of_freedom = jnp.maximum(jnp.sum(rows.counts) - solution.rank, 1.0)
        effective = factors.counts
    else:
        effective = effective_counts(residual, rows.counts)
        used = waves_for(effective)
        waves = rows.waves(network, weights[None, :] ** 2 * residual, weights, used)
        covariance = correlated_covariance(waves, solution.inverse_gram, used)
        degrees_of_freedom = jnp.sum(used)
    return identification(
        network,
        factors,
        solution,
        covariance,
        degrees_of_freedom=degrees_of_freedom,
        effective=effective,
        errors=errors,
        fixed=fixed,
    )


def _errors(
    network: CSLC, rows: AbstractRows, k: Float[Array, " coefficients"]
) -> tuple[Float[Array, "instants joints"], Float[Array, " joints"]]:
    """Torque errors of the equations that count, zero elsewhere; and each joint's scale."""
    error = rows.counts * (rows.torque - rows.predicted(network, k))
    scale = robust_scale(error, rows.counts)
    # Errors of which more than half are rounding still tell the others from themselves.
    floor = 1e-12 * jnp.max(jnp.abs(rows.torque), axis=0)
    return error, jnp.maximum(scale, jnp.where(floor > 0.0, floor, 1.0))


def _reweighted(
    network: CSLC,
    rows: AbstractRows,
    start: Float[Array, " coefficients"],
    weights: Float[Array, " joints"],
    residual_weights: bool,
    loss: Loss,
    rcond: float | None,
    fixed: Fixed | None,
) -> Float[Array, " coefficients"]:
    def improve(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        k, _, rounds = state
        error, scale = _errors(network, rows, k)
        root = jnp.sqrt(weight(loss, error / scale[None, :]))
        own = 1.0 / scale if residual_weights else weights
        better = minimum(network, rows.factors(network, root), own, rcond, fixed).k
        return better, jnp.max(jnp.abs(better - k)) / jnp.max(jnp.abs(better)), rounds + 1

    def unsettled(state: tuple[Array, Array, Array]) -> Array:
        _, change, rounds = state
        return (change > _SETTLED) & (rounds < _ROUNDS)

    state = (start, jnp.asarray(jnp.inf), jnp.asarray(0))
    return jax.lax.while_loop(unsettled, improve, state)[0]


def _pseudo_residuals(
    rows: AbstractRows,
    error: Float[Array, "instants joints"],
    scale: Float[Array, " joints"],
    loss: Loss,
) -> Float[Array, "instants joints"]:
    u = error / scale[None, :]
    number = jnp.maximum(jnp.sum(rows.counts, axis=0), 1.0)
    steepness = jnp.sum(rows.counts * slope(loss, u), axis=0) / number
    over = scale / jnp.where(steepness > 0, steepness, 1.0)
    return rows.counts * influence(loss, u) * over[None, :]

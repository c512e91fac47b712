"""Robust losses by iteratively reweighted least squares (Holland and Welsch 1977)."""

from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._factors import JointFactors
from ._fixed import Fixed
from ._minimum import Solution, minimum
from ._rows import AbstractRows
from ._standard_errors import FitResiduals


Loss = Literal["squared", "huber", "bisquare"]
LOSSES: tuple[str, ...] = get_args(Loss)

# In standard deviations. With these a fit to normal noise has 95 % of the efficiency of ordinary
# least squares (Holland and Welsch 1977).
_HUBER = 1.345
_BISQUARE = 4.685
# A normal variable's median absolute value, in standard deviations.
_MEDIAN = 0.6744897501960817


def influence(loss: Loss, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """psi(u): the influence on a fit of an equation with an error of `u` standard deviations.

    >>> import jax.numpy as jnp
    >>> influence("huber", jnp.array([0.5, 100.0])).tolist()
    [0.5, 1.345]
    >>> influence("bisquare", jnp.array([100.0])).tolist()
    [0.0]
    """
    match loss:
        case "squared":
            return u
        case "huber":
            return jnp.clip(u, -_HUBER, _HUBER)
        case "bisquare":
            inside = jnp.maximum(1.0 - (u / _BISQUARE) ** 2, 0.0)
            return u * inside**2


def slope(loss: Loss, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """The derivative of `influence`."""
    match loss:
        case "squared":
            return jnp.ones_like(u)
        case "huber":
            return (jnp.abs(u) <= _HUBER).astype(u.dtype)
        case "bisquare":
            square = (u / _BISQUARE) ** 2
            return jnp.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0)


def weight(loss: Loss, u: Float[Array, "..."]) -> Float[Array, "..."]:
    """psi(u) / u: what an equation's square counts for in a round of reweighting, from 0 to 1."""
    match loss:
        case "squared":
            return jnp.ones_like(u)
        case "huber":
            return _HUBER / jnp.maximum(jnp.abs(u), _HUBER)
        case "bisquare":
            return jnp.maximum(1.0 - (u / _BISQUARE) ** 2, 0.0) ** 2


def robust_scale(
    error: Float[Array, "samples joints"], counts: Float[Array, "samples joints"]
) -> Float[Array, " joints"]:
    """Each joint's standard deviation of error, from the median of its modulus.

    Half of the errors may be anything without moving it far. Zero of a joint without equations.
    """
    modulus = jnp.sort(jnp.where(counts > 0, jnp.abs(error), jnp.inf), axis=0)
    number = jnp.sum(counts > 0, axis=0)
    # Halfway between the two middle ones where their number is even.
    low, high = jnp.maximum(number - 1, 0) // 2, number // 2
    joints = jnp.arange(error.shape[1])
    middle = 0.5 * (modulus[low, joints] + modulus[jnp.minimum(high, len(modulus) - 1), joints])
    return jnp.where(number > 0, middle, 0.0) / _MEDIAN


# Coefficients that change by less than this part of themselves have converged. Huber's rounds take
# some ten, the bisquare's some twenty.
_TOLERANCE = 1e-9
_ROUNDS = 100


def robust_residuals(
    rows: AbstractRows,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Array, " joints"],
    *,
    residual_weights: bool,
    loss: Loss,
    rcond: float | None,
    fixed: Fixed | None = None,
) -> FitResiduals:
    """A fit by iteratively reweighted least squares (Holland and Welsch 1977).

    The scale of each joint's noise is taken from the median absolute error. The search for the
    bisquare's minimum starts from Huber's, which has only one.

    To terms of higher order, a robust fit is an ordinary one to pseudo-values, whose residuals
    are psi(u) over the mean of psi'(u), times the scale (Street, Carroll and Ruppert, American
    Statistician 42, 1988): what holds for ordinary residuals holds for these.

    - `factors`: of the equations as they are.
    - `solution`: of ordinary least squares, to start from, with `weights`; with
      `residual_weights`, one over the robust scales take their place.
    """
    k = solution.k
    stages: tuple[Loss, ...] = ("huber",) if loss == "huber" else ("huber", "bisquare")
    for stage in stages:
        k = _reweighted(rows, k, weights, residual_weights, stage, rcond, fixed)
    error, scale = errors_and_scale(rows, k)
    weights = 1.0 / scale if residual_weights else weights
    residual = _pseudo_residuals(rows, error, scale, loss)
    whole = minimum(rows.unknowns, factors, weights, rcond, fixed)
    squares = jnp.sum((weights[None, :] * residual) ** 2)
    whole = whole._replace(
        k=k,
        variance=squares / jnp.maximum(jnp.sum(rows.counts) - whole.rank, 1.0),
        finite=whole.finite & jnp.all(jnp.isfinite(k)),
    )
    return FitResiduals(whole, weights, residual)


def robust_weights(
    rows: AbstractRows, k: Float[Array, " coefficients"], loss: Loss
) -> tuple[Float[Array, "instants joints"], Float[Array, " joints"]]:
    """The roots of the weights of all equations in a round of reweighting, and joints' scales."""
    error, scale = errors_and_scale(rows, k)
    return jnp.sqrt(weight(loss, error / scale[None, :])), scale


def errors_and_scale(
    rows: AbstractRows, k: Float[Array, " coefficients"]
) -> tuple[Float[Array, "instants joints"], Float[Array, " joints"]]:
    """Torque errors of the equations that take part, zero elsewhere; and each joint's scale."""
    counts = jnp.asarray(rows.counts)
    error = counts * (rows.torque - rows.predicted(k))
    scale = robust_scale(error, counts)
    # Where more than half of the errors are rounding, a floor still tells outliers from them.
    floor = 1e-12 * jnp.max(jnp.abs(rows.torque), axis=0)
    return error, jnp.maximum(scale, jnp.where(floor > 0.0, floor, 1.0))


def _reweighted(
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
        root, scale = robust_weights(rows, k, loss)
        joint_weights = 1.0 / scale if residual_weights else weights
        better = minimum(rows.unknowns, rows.factors(root), joint_weights, rcond, fixed).k
        return better, jnp.max(jnp.abs(better - k)) / jnp.max(jnp.abs(better)), rounds + 1

    def not_converged(state: tuple[Array, Array, Array]) -> Array:
        _, change, rounds = state
        return (change > _TOLERANCE) & (rounds < _ROUNDS)

    state = (start, jnp.asarray(jnp.inf), jnp.asarray(0))
    return jax.lax.while_loop(not_converged, improve, state)[0]


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

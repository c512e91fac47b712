"""Robust losses by iteratively reweighted least squares (Holland and Welsch 1977)."""

from typing import Any, Literal, get_args

import jax
import numpy as np
from jaxtyping import Float

from .._environment import array_namespace
from ..recordings import NORMAL_MEDIAN
from ._columns import traced
from ._errors import Rows
from ._factors import JointFactors
from ._minimum import (
    Fixed,
    Numbers,
    Solution,
    minimum,
    minimum_coefficients,
    residual_weights,
)


Loss = Literal["squared", "huber", "bisquare"]
"""Names of the losses."""
LOSSES: tuple[str, ...] = get_args(Loss)

# In standard deviations. With these a fit to normal noise has 95 % of the efficiency of ordinary
# least squares (Holland and Welsch 1977).
_HUBER = 1.345
_BISQUARE = 4.685


def influence(loss: Loss, u: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """Return psi(u): the influence on a fit of an equation `u` standard deviations off.

    >>> import numpy as np
    >>> influence("huber", np.array([0.5, 100.0])).tolist()
    [0.5, 1.345]
    >>> influence("bisquare", np.array([100.0])).tolist()
    [0.0]
    """
    return u * weight(loss, u)


def slope(loss: Loss, u: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """Return the derivative of `influence`."""
    xp = array_namespace(u)
    match loss:
        case "squared":
            return xp.ones_like(u)
        case "huber":
            return (xp.abs(u) <= _HUBER).astype(u.dtype)
        case "bisquare":
            square = (u / _BISQUARE) ** 2
            return xp.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0)


def weight(loss: Loss, u: Float[Numbers, "..."]) -> Float[Numbers, "..."]:
    """Return psi(u) / u: what an equation's square counts for in a round, from 0 to 1."""
    xp = array_namespace(u)
    match loss:
        case "squared":
            return xp.ones_like(u)
        case "huber":
            return _HUBER / xp.maximum(xp.abs(u), _HUBER)
        case "bisquare":
            return xp.maximum(1.0 - (u / _BISQUARE) ** 2, 0.0) ** 2


def robust_scale(
    error: Float[Numbers, "samples joints"], counts: Float[Numbers, "samples joints"]
) -> Float[Numbers, " joints"]:
    """Return each joint's standard deviation of error, from the median of its modulus.

    Half of the errors may be anything without moving it far. Zero of a joint without equations.
    """
    xp = array_namespace(error, counts)
    modulus = xp.sort(xp.where(counts > 0, xp.abs(error), np.inf), axis=0)
    number = xp.sum(counts > 0, axis=0)
    # Halfway between the two middle ones where their number is even.
    low, high = xp.maximum(number - 1, 0) // 2, number // 2
    joints = np.arange(error.shape[1])
    middle = 0.5 * (modulus[low, joints] + modulus[xp.minimum(high, len(modulus) - 1), joints])
    return xp.where(number > 0, middle, 0.0) / NORMAL_MEDIAN


# Coefficients that change by less than this part of themselves have converged. Huber's rounds take
# some ten, the bisquare's some twenty.
_TOLERANCE = 1e-9
_ROUNDS = 100
# Least scale, as a part of the greatest torque: where more than half of the errors are rounding, it
# still tells outliers from them.
_LEAST_SCALE = 1e-12


def robust_fit(
    rows: Rows,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Numbers, " joints"],
    *,
    by_residual: bool,
    loss: Loss,
    rcond: float | None,
    fixed: Fixed | None = None,
) -> tuple[Solution, Float[Numbers, " joints"], Float[Numbers, "instants joints"]]:
    """Fit by iteratively reweighted least squares (Holland and Welsch 1977).

    The scale of each joint's noise is taken from the median absolute error. The search for the
    bisquare's minimum starts from Huber's, which has only one.

    To terms of higher order, a robust fit is an ordinary one to pseudo-values, whose residuals
    are psi(u) over the mean of psi'(u), times the scale (Street, Carroll and Ruppert, American
    Statistician 42, 1988): what holds for ordinary residuals holds for these.

    - `factors`: of the equations as they are.
    - `solution`: of ordinary least squares, to start from, with `weights`; with `by_residual`, one
      over the robust scales take their place.

    **Returns** the solution, the weights of joints, and the residuals of the pseudo-values.
    """
    k = solution.k
    stages: tuple[Loss, ...] = ("huber",) if loss == "huber" else ("huber", "bisquare")
    for stage in stages:
        k = _reweighted(rows, k, weights, by_residual, stage, rcond, fixed)
    error, scale = errors_and_scale(rows, k)
    weights = weights_of_scales(rows, scale) if by_residual else weights
    xp, u = array_namespace(error), error / scale[None, :]
    number = xp.maximum(xp.sum(rows.counts, axis=0), 1.0)
    steepness = xp.sum(rows.counts * slope(loss, u), axis=0) / number
    over = scale / xp.where(steepness > 0, steepness, 1.0)
    residual = rows.counts * influence(loss, u) * over[None, :]
    whole = minimum(rows.unknowns, factors, weights, rcond, fixed)
    squares = xp.sum((weights[None, :] * residual) ** 2)
    whole = whole._replace(
        k=k,
        variance=squares / xp.maximum(xp.sum(rows.counts) - whole.rank, 1.0),
        finite=whole.finite & xp.all(xp.isfinite(k)),
    )
    return whole, weights, residual


def errors_and_scale(
    rows: Rows, k: Float[Numbers, " coefficients"]
) -> tuple[Float[Numbers, "instants joints"], Float[Numbers, " joints"]]:
    """Return torque errors of the equations that take part, 0 elsewhere; and each joint's scale."""
    error = rows.residuals(k)
    xp = array_namespace(error)
    floor = _LEAST_SCALE * xp.max(xp.abs(rows.torque), axis=0)
    return error, xp.maximum(robust_scale(error, rows.counts), xp.where(floor > 0.0, floor, 1.0))


def robust_weights(
    rows: Rows, k: Float[Numbers, " coefficients"], loss: Loss
) -> tuple[Float[Numbers, "instants joints"], Float[Numbers, " joints"]]:
    """Return the roots of the weights of all equations in a round, and the scales of joints."""
    error, scale = errors_and_scale(rows, k)
    return array_namespace(error).sqrt(weight(loss, error / scale[None, :])), scale


def weights_of_scales(rows: Rows, scale: Float[Numbers, " joints"]) -> Float[Numbers, " joints"]:
    """Return weights of joints by their robust scales, as `residual_weights`."""
    xp, counts = array_namespace(rows.torque), rows.counts
    numbers = 1.0 * xp.sum(counts > 0, axis=0)
    squares = xp.sum(xp.where(counts > 0, rows.torque**2, 0.0), axis=0)
    torque = xp.sqrt(squares / xp.maximum(numbers, 1.0))
    return residual_weights(scale, numbers, torque, rows.unknowns.joint_sizes)


def _reweighted(
    rows: Rows,
    start: Float[Numbers, " coefficients"],
    weights: Float[Numbers, " joints"],
    by_residual: bool,
    loss: Loss,
    rcond: float | None,
    fixed: Fixed | None,
) -> Float[Numbers, " coefficients"]:
    """Return the coefficients of the last round of reweighting."""

    def improve(state: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        k, _, rounds = state
        root, scale = robust_weights(rows, k, loss)
        joint_weights = weights_of_scales(rows, scale) if by_residual else weights
        better = minimum_coefficients(
            rows.unknowns, rows.factors(root), joint_weights, rcond, fixed
        )
        xp = array_namespace(better)
        return better, xp.max(xp.abs(better - k)) / xp.max(xp.abs(better)), rounds + 1

    def not_converged(state: tuple[Any, Any, Any]) -> Any:
        _, change, rounds = state
        return (change > _TOLERANCE) & (rounds < _ROUNDS)

    state = (start, np.inf, 0)
    if traced((start, rows.torque)):
        return jax.lax.while_loop(not_converged, improve, state)[0]
    while not_converged(state):
        state = improve(state)
    return state[0]

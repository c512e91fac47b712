from typing import Literal, get_args

import jax.numpy as jnp
from jaxtyping import Array, Float


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

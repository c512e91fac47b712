from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float


Errors = Float[Array, "outputs patterns"]
#: Errors (o, patterns), and ones where they count and zeros elsewhere, to one number.
Cost = Callable[[Errors, Errors], Float[Array, ""]]


def mean_modulus(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """The mean error modulus, which the rates of 6.3.1 are adapted by."""
    return jnp.sum(jnp.abs(errors) * counts) / jnp.maximum(jnp.sum(counts), 1.0)


def half_rms(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """Half the root mean square of a pattern's errors, averaged over patterns: the ε of 7.5.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import half_rms
    >>> errors = jnp.asarray([[3.0, 0.0], [4.0, 1.0]])
    >>> counts = jnp.asarray([[1.0, 0.0], [1.0, 1.0]])
    >>> round(float(half_rms(errors, counts)), 4)  # (sqrt(12.5) / 2 + 1 / 2) / 2
    1.1339
    """
    each = jnp.sum(counts, axis=0)
    squares = jnp.sum(errors**2 * counts, axis=0) / jnp.maximum(each, 1.0)
    return 0.5 * jnp.sum(jnp.sqrt(squares)) / jnp.maximum(jnp.sum(each > 0), 1.0)


def half_square(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """Half the sum of a pattern's squared errors, averaged over patterns (Eqn. 3.4-2)."""
    patterns = jnp.maximum(jnp.sum(jnp.sum(counts, axis=0) > 0), 1.0)
    return 0.5 * jnp.sum(errors**2 * counts) / patterns

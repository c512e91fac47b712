"""Costs of a network's errors: mean modulus, half RMS and half square (Eqn. 3.4-2, 6.3.1, 7.5)."""

from collections.abc import Callable
from typing import NamedTuple

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
    counted_outputs = jnp.sum(counts, axis=0)
    squares = jnp.sum(errors**2 * counts, axis=0) / jnp.maximum(counted_outputs, 1.0)
    return 0.5 * jnp.sum(jnp.sqrt(squares)) / jnp.maximum(jnp.sum(counted_outputs > 0), 1.0)


def half_square(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """Half the sum of a pattern's squared errors, averaged over patterns (Eqn. 3.4-2)."""
    patterns = jnp.maximum(jnp.sum(jnp.sum(counts, axis=0) > 0), 1.0)
    return 0.5 * jnp.sum(errors**2 * counts) / patterns


class ErrorSum(NamedTuple):
    """A cost as a sum over patterns of what each pattern's errors bring, which a kernel adds up.

    **Attributes**

    - `square`: whether errors enter by their squares; otherwise by their moduli.
    - `root`: whether a pattern brings the square root of their weighed sum.
    - `shares`: from counts to the weights of that sum, (outputs, patterns).
    - `scale`: from counts to what the sum over patterns is multiplied by.
    """

    square: bool
    root: bool
    shares: Callable[[Errors], Errors]
    scale: Callable[[Errors], Float[Array, ""]]


def error_sum(cost: Cost) -> ErrorSum | None:
    """The sum that a cost is; None of a user's own."""
    return _ERROR_SUMS.get(cost)


def _counted_patterns(counts: Errors) -> Float[Array, ""]:
    return jnp.maximum(jnp.sum(jnp.sum(counts, axis=0) > 0), 1.0)


_ERROR_SUMS: dict[Cost, ErrorSum] = {
    mean_modulus: ErrorSum(
        False, False, lambda counts: counts, lambda counts: 1.0 / jnp.maximum(jnp.sum(counts), 1.0)
    ),
    half_rms: ErrorSum(
        True,
        True,
        lambda counts: counts / jnp.maximum(jnp.sum(counts, axis=0, keepdims=True), 1.0),
        lambda counts: 0.5 / _counted_patterns(counts),
    ),
    half_square: ErrorSum(
        True, False, lambda counts: counts, lambda counts: 0.5 / _counted_patterns(counts)
    ),
}

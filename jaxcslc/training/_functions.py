"""Functions of nodes and of errors: activations with their slopes (thesis 3.3), and costs.

Costs are mean modulus, half RMS and half square (Eqn. 3.4-2, 6.3.1, 7.5).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


Values = Float[Array, "..."]


@dataclass(frozen=True)
class Activation:
    """Activation of a node: a function of the sum of its weighted inputs (thesis 3.3).

    **Attributes**

    - `name`: for messages.
    - `value`: of the sum, elementwise.
    - `slope`: its derivative, as a function of the sum; `None` where there is none, as for the
      hard limiter, and then backpropagation refuses it.
    - `low`, `high`: what `value` cannot leave: targets outside can never be met.
    - `increasing`: or strictly decreasing; PERAL asks (Eqn. 6.2-1).

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import HYPERBOLIC_TANGENT
    >>> round(float(HYPERBOLIC_TANGENT.slope(jnp.asarray(0.0))), 3)
    1.0
    """

    name: str
    value: Callable[[Values], Values]
    slope: Callable[[Values], Values] | None
    low: float
    high: float
    increasing: bool = True


def _step(s: Values) -> Values:
    """Return one from zero on, and zero below (Eqn. 3.3-2)."""
    return jnp.where(s >= 0, 1.0, 0.0).astype(s.dtype)


def _identity(s: Values) -> Values:
    return s


def _logistic_slope(s: Values) -> Values:
    y = jax.nn.sigmoid(s)
    return y * (1.0 - y)


def _tanh_slope(s: Values) -> Values:
    return 1.0 - jnp.tanh(s) ** 2


INFINITE = float("inf")

HARD_LIMITER = Activation("hard limiter", _step, None, 0.0, 1.0)
"""Zero or one (Eqn. 3.3-2): the historical node, which only the perceptron rule trains."""
LINEAR_COMBINER = Activation("linear combiner", _identity, jnp.ones_like, -INFINITE, INFINITE)
"""The sum itself (3.3.2): one minimum, and all that a CSLC is made of."""
LOGISTIC = Activation("logistic", jax.nn.sigmoid, _logistic_slope, 0.0, 1.0)
"""The function 1 / (1 + exp(-s)) (3.3.3)."""
HYPERBOLIC_TANGENT = Activation("hyperbolic tangent", jnp.tanh, _tanh_slope, -1.0, 1.0)
"""The function tanh(s) (3.3.3)."""

ACTIVATIONS = {
    "hard limiter": HARD_LIMITER,
    "linear combiner": LINEAR_COMBINER,
    "logistic": LOGISTIC,
    "hyperbolic tangent": HYPERBOLIC_TANGENT,
}


@dataclass(frozen=True)
class _Mirrored:
    """f(-s), and its derivative; a class, so that equal ones are equal and compile once."""

    function: Callable[[Values], Values]
    factor: float

    def __call__(self, s: Values) -> Values:
        return self.factor * self.function(-s)


def decreasing(activation: Activation) -> Activation:
    """Return the activation of -s: strictly decreasing where the given one increases.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import LOGISTIC, decreasing
    >>> falling = decreasing(LOGISTIC)
    >>> falling.increasing, bool(falling.value(jnp.asarray(1.0)) < 0.5)
    (False, True)
    """
    return Activation(
        f"decreasing {activation.name}",
        _Mirrored(activation.value, 1.0),
        None if activation.slope is None else _Mirrored(activation.slope, -1.0),
        activation.low,
        activation.high,
        not activation.increasing,
    )


def activation_named(activation: str | Activation) -> Activation:
    """**Raises** `ValueError` for a name that is none of the four."""
    if isinstance(activation, Activation):
        return activation
    if activation not in ACTIVATIONS:
        raise ValueError(
            f"activation: expected one of {', '.join(ACTIVATIONS)}, got {activation!r}"
        )
    return ACTIVATIONS[activation]


Errors = Float[Array, "outputs patterns"]
Cost = Callable[[Errors, Errors], Float[Array, ""]]
"""Function of the errors (o, patterns), and of ones where they count and zeros elsewhere, to one
number."""


def mean_modulus(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """Return the mean error modulus, which the rates of 6.3.1 are adapted by."""
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


def _counted_patterns(counts: Errors) -> Float[Array, ""]:
    return jnp.maximum(jnp.sum(jnp.sum(counts, axis=0) > 0), 1.0)


def half_square(errors: Errors, counts: Errors) -> Float[Array, ""]:
    """Half the sum of a pattern's squared errors, averaged over patterns (Eqn. 3.4-2)."""
    return 0.5 * jnp.sum(errors**2 * counts) / _counted_patterns(counts)


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

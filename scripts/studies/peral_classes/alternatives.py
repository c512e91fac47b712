"""What a user would take in PERAL's place: optax, optimistix, and the direct solve."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, Float

from jaxcslc.adaptive import AdaptiveNetwork
from jaxcslc.training import Examples, half_square, normal_equations


MOMENTUM, ADAM, LIMITED_MEMORY = "momentum", "Adam", "L-BFGS"
LEVENBERG_MARQUARDT = "Levenberg-Marquardt"
# Of which the best in hindsight is reported, which favours the method.
LEARNING_RATES: dict[str, Sequence[float]] = {
    MOMENTUM: (1e-4, 1e-3, 1e-2, 1e-1, 1.0),
    ADAM: (3e-3, 1e-2, 3e-2, 1e-1, 3e-1),
}
_DAMPED = optimistix.LevenbergMarquardt(rtol=1e-12, atol=1e-12)


def cost_of(network: AdaptiveNetwork, patterns: Examples, weights: Array) -> Array:
    """Half the sum of a pattern's squared errors, averaged over patterns."""
    return half_square(patterns.errors(network, weights), patterns.counts)


def _optimiser(kind: str, rate: Array) -> Any:
    if kind == LIMITED_MEMORY:
        return optax.lbfgs()
    made = optax.sgd(rate, momentum=0.9) if kind == MOMENTUM else optax.adam(rate)
    return optax.with_extra_args_support(made)


def _residuals(network: AdaptiveNetwork, patterns: Examples) -> Callable[..., Any]:
    return lambda w, _: (jnp.ravel(patterns.errors(network, w)), None)


def _by_optax(
    kind: str, rate: Array, network: AdaptiveNetwork, patterns: Examples, weights: Array, steps: int
) -> tuple[Array, Array]:
    optimiser = _optimiser(kind, rate)

    def loss(w: Array) -> Array:
        return cost_of(network, patterns, w)

    # The line search of L-BFGS keeps the value and gradient of the next step.
    slope = optax.value_and_grad_from_state(loss) if kind == LIMITED_MEMORY else None

    def step(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
        w, state = carry
        value, gradient = jax.value_and_grad(loss)(w) if slope is None else slope(w, state=state)
        updates, state = optimiser.update(
            gradient, state, w, value=value, grad=gradient, value_fn=loss
        )
        return (optax.apply_updates(w, updates), state), value

    (weights, _), costs = jax.lax.scan(step, (weights, optimiser.init(weights)), None, length=steps)
    return costs, weights


def _damped(
    network: AdaptiveNetwork, patterns: Examples, weights: Array, steps: int
) -> tuple[Array, Array]:
    function = _residuals(network, patterns)
    shape = jax.ShapeDtypeStruct((patterns.targets.size,), weights.dtype)
    first = _DAMPED.init(function, weights, None, {}, shape, None, frozenset())
    dynamic, static = eqx.partition(first, eqx.is_array)

    def step(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
        w, state = carry
        cost = cost_of(network, patterns, w)
        w, state, _ = _DAMPED.step(function, w, None, {}, eqx.combine(state, static), frozenset())
        return (w, eqx.filter(state, eqx.is_array)), cost

    (weights, _), costs = jax.lax.scan(step, (weights, dynamic), None, length=steps)
    return costs, weights


@eqx.filter_jit
def costs_by_step(
    kind: str,
    rate: Array,
    network: AdaptiveNetwork,
    examples: Examples,
    starts: Float[Array, "seeds weights"],
    steps: int,
) -> tuple[Float[Array, "seeds steps"], Float[Array, "seeds weights"]]:
    """The cost before each step, for every seed, and the weights after the last.

    **Arguments**

    - `rate`: the learning rate of momentum and Adam; the others have none.
    """

    def of_seed(pair: tuple[Examples, Array]) -> tuple[Array, Array]:
        patterns, weights = pair
        if kind == LEVENBERG_MARQUARDT:
            return _damped(network, patterns, weights, steps)
        return _by_optax(kind, rate, network, patterns, weights, steps)

    return jax.lax.map(of_seed, (examples, starts))


def direct_solution(network: AdaptiveNetwork, patterns: Examples) -> Float[np.ndarray, " weights"]:
    """Least squares by the normal equations, for outputs that are linear in the weights."""
    return np.asarray(normal_equations(network, patterns).solution())

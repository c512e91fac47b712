"""Alternatives to PERAL: rules that Chapters 5 and 6 name, today's optimisers, the direct solve.

Thesis 6 names Battiti 1992 (one-step secant and conjugate gradients), Riedmiller & Braun 1993
(RPROP) and Møller 1993 (scaled conjugate gradients) as rules that PERAL has not been compared with;
3.4 and 5.3 name Fahlman 1988 (quickprop). Momentum, Adam, the one-step secant and L-BFGS are
those of optax; conjugate gradients, BFGS and Levenberg-Marquardt those of optimistix; the other
three are in `scripts.studies.peral_classes.classic_rules`.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, Float

from jaxcslc.training import AdaptiveNetwork, Examples, half_square, normal_equations
from scripts.studies.peral_classes.classic_rules import ScaledConjugateGradient, quickprop, rprop


MOMENTUM, ADAM, LIMITED_MEMORY = "momentum", "Adam", "L-BFGS"
LEVENBERG_MARQUARDT = "Levenberg-Marquardt"
RPROP, QUICKPROP, ONE_STEP_SECANT = "RPROP", "quickprop", "one-step secant"
SCALED_CONJUGATE, CONJUGATE, BFGS = "scaled conjugate gradients", "conjugate gradients", "BFGS"
# Of which the best in hindsight is reported, which favours the method. Of RPROP, the first step.
LEARNING_RATES: dict[str, Sequence[float]] = {
    MOMENTUM: (1e-4, 1e-3, 1e-2, 1e-1, 1.0),
    ADAM: (3e-3, 1e-2, 3e-2, 1e-1, 3e-1),
    RPROP: (1e-3, 1e-2, 1e-1, 1.0),
    QUICKPROP: (1e-4, 1e-3, 1e-2, 1e-1, 1.0),
}
#: Of each method, its steps at most, in parts of backpropagation's epochs.
STEPS: dict[str, float] = {
    MOMENTUM: 1.0,
    ADAM: 1.0,
    RPROP: 1.0,
    QUICKPROP: 1.0,
    ONE_STEP_SECANT: 0.5,
    CONJUGATE: 1.0,
    SCALED_CONJUGATE: 0.5,
    BFGS: 0.5,
    LIMITED_MEMORY: 0.25,
    LEVENBERG_MARQUARDT: 0.1,
}
# Their line searches read the value and gradient that the step before has kept.
_SEARCHING = (LIMITED_MEMORY, ONE_STEP_SECANT)
_TOLERANCE = 1e-12
_BY_OPTIMISTIX: dict[str, Any] = {
    LEVENBERG_MARQUARDT: optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
    CONJUGATE: optimistix.NonlinearCG(rtol=_TOLERANCE, atol=_TOLERANCE),
    BFGS: optimistix.BFGS(rtol=_TOLERANCE, atol=_TOLERANCE),
}


def cost_of(network: AdaptiveNetwork, patterns: Examples, weights: Array) -> Array:
    """Half the sum of a pattern's squared errors, averaged over patterns."""
    return half_square(patterns.errors(network, weights), patterns.counts)


def _optimiser(kind: str, rate: Array) -> Any:
    made = {
        LIMITED_MEMORY: lambda: optax.lbfgs(),
        # Battiti's direction is BFGS's from the identity and the last step alone.
        ONE_STEP_SECANT: lambda: optax.lbfgs(memory_size=1, scale_init_precond=False),
        MOMENTUM: lambda: optax.sgd(rate, momentum=0.9),
        ADAM: lambda: optax.adam(rate),
        RPROP: lambda: rprop(rate),
        QUICKPROP: lambda: quickprop(rate),
    }[kind]()
    return optax.with_extra_args_support(made)


def _by_optax(
    kind: str, rate: Array, network: AdaptiveNetwork, patterns: Examples, weights: Array, steps: int
) -> tuple[Array, Array]:
    optimiser = _optimiser(kind, rate)

    def loss(w: Array) -> Array:
        return cost_of(network, patterns, w)

    slope = optax.value_and_grad_from_state(loss) if kind in _SEARCHING else None

    def step(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
        w, state = carry
        value, gradient = jax.value_and_grad(loss)(w) if slope is None else slope(w, state=state)
        updates, state = optimiser.update(
            gradient, state, w, value=value, grad=gradient, value_fn=loss
        )
        return (optax.apply_updates(w, updates), state), value

    (weights, _), costs = jax.lax.scan(step, (weights, optimiser.init(weights)), None, length=steps)
    return costs, weights


def _by_optimistix(
    kind: str, network: AdaptiveNetwork, patterns: Examples, weights: Array, steps: int
) -> tuple[Array, Array]:
    """A step evaluates the cost once: of a line search, it may be a trial that is rejected."""
    solver = _BY_OPTIMISTIX[kind]

    def loss(w: Array, _: None) -> tuple[Array, None]:
        return cost_of(network, patterns, w), None

    def residuals(w: Array, _: None) -> tuple[Array, None]:
        return jnp.ravel(patterns.errors(network, w)), None

    function: Callable[..., Any] = residuals if kind == LEVENBERG_MARQUARDT else loss
    answer = jax.eval_shape(lambda w: function(w, None)[0], weights)
    first = solver.init(function, weights, None, {}, answer, None, frozenset())
    dynamic, static = eqx.partition(first, eqx.is_array)

    def step(carry: tuple[Array, Any], _: None) -> tuple[tuple[Array, Any], Array]:
        w, state = carry
        cost = cost_of(network, patterns, w)
        w, state, _ = solver.step(function, w, None, {}, eqx.combine(state, static), frozenset())
        return (w, eqx.filter(state, eqx.is_array)), cost

    (weights, _), costs = jax.lax.scan(step, (weights, dynamic), None, length=steps)
    return costs, weights


def _by_scaled_conjugate_gradient(
    network: AdaptiveNetwork, patterns: Examples, weights: Array, steps: int
) -> tuple[Array, Array]:
    method = ScaledConjugateGradient(lambda w: cost_of(network, patterns, w))
    state, costs = jax.lax.scan(
        lambda state, _: (method.step(state), state.cost), method.first(weights), None, length=steps
    )
    return costs, state.weights


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

    - `rate`: of the methods in `LEARNING_RATES`; the others have none.
    """

    def of_seed(pair: tuple[Examples, Array]) -> tuple[Array, Array]:
        patterns, weights = pair
        if kind in _BY_OPTIMISTIX:
            return _by_optimistix(kind, network, patterns, weights, steps)
        if kind == SCALED_CONJUGATE:
            return _by_scaled_conjugate_gradient(network, patterns, weights, steps)
        return _by_optax(kind, rate, network, patterns, weights, steps)

    return jax.lax.map(of_seed, (examples, starts))


def direct_solution(network: AdaptiveNetwork, patterns: Examples) -> Float[np.ndarray, " weights"]:
    """Least squares by the normal equations, for outputs that are linear in the weights."""
    return np.asarray(normal_equations(network, patterns).solution())

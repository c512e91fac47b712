"""RPROP, quickprop and scaled conjugate gradients, as published.

Neither optax nor optimistix has the last two. `optax.rprop` (0.2.8) moves weights by the step that
the epoch before has found: its first epoch moves nothing, and each later one is an epoch late.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float, Int


# Riedmiller & Braun 1993: a step's growth and fall, and its least length.
FASTER, SLOWER, LEAST_STEP = 1.2, 0.5, 1e-6
# Fahlman 1988: no step is longer than so many times the one before.
GROWTH = 1.75
# Møller 1993, step 1: of the scale to begin with, at most 1e-6.
FIRST_SCALE = 1e-6


class RpropState(NamedTuple):
    """The length of each weight's step, and the gradient of the epoch before."""

    length: Float[Array, " weights"]
    gradient: Float[Array, " weights"]


def rprop(length: Float[Array, ""] | float) -> optax.GradientTransformation:
    """RPROP (Riedmiller & Braun 1993), in the form that stands still where a sign has changed.

    A weight's step grows while its slope keeps its sign and halves where the sign changes; the
    slope's size does not count. The published greatest length, 50, is one of sigmoids' weights:
    there is none here.

    **Arguments**

    - `length`: of the first step.

    >>> import jax.numpy as jnp
    >>> import optax
    >>> w, rule = jnp.asarray([1.0]), rprop(0.1)
    >>> state = rule.init(w)
    >>> for _ in range(2):  # of w²/2: a step of 0.1, then one of 0.12
    ...     step, state = rule.update(w, state)
    ...     w = optax.apply_updates(w, step)
    >>> print(f"{float(w[0]):.2f}")
    0.78
    """

    def first(weights: Array) -> RpropState:
        return RpropState(jnp.full_like(weights, length), jnp.zeros_like(weights))

    def update(
        gradient: Array, state: RpropState, params: Array | None = None
    ) -> tuple[Array, RpropState]:
        del params
        same = jnp.sign(gradient) * jnp.sign(state.gradient)
        factor = jnp.where(same > 0, FASTER, jnp.where(same < 0, SLOWER, 1.0))
        length = jnp.maximum(factor * state.length, LEAST_STEP)
        gradient = jnp.where(same < 0, 0.0, gradient)
        return -jnp.sign(gradient) * length, RpropState(length, gradient)

    return optax.GradientTransformation(first, update)  # pyright: ignore[reportArgumentType]


class QuickpropState(NamedTuple):
    """The step before, and the slope (minus the gradient) that it was taken at."""

    step: Float[Array, " weights"]
    slope: Float[Array, " weights"]


def quickprop(
    rate: Float[Array, ""] | float, growth: float = GROWTH
) -> optax.GradientTransformation:
    """Quickprop (Fahlman 1988, "Faster-learning variations on back-propagation").

    Each weight by itself steps to the vertex of the parabola through its last two slopes. A step
    is at most `growth` times the one before. The gradient's own step is added while the slope
    still points the way of the step before. Weight decay is left out.

    **Arguments**

    - `rate`: of the gradient's own step.

    >>> import jax.numpy as jnp
    >>> import optax
    >>> w, rule = jnp.asarray([1.0]), quickprop(0.1)
    >>> state = rule.init(w)
    >>> for _ in range(2):  # of w²/2: a gradient step of 0.1, then 1.75 times that and 0.09
    ...     step, state = rule.update(w, state)
    ...     w = optax.apply_updates(w, step)
    >>> print(f"{float(w[0]):.3f}")
    0.635
    """

    def first(weights: Array) -> QuickpropState:
        return QuickpropState(jnp.zeros_like(weights), jnp.zeros_like(weights))

    def update(
        gradient: Array, state: QuickpropState, params: Array | None = None
    ) -> tuple[Array, QuickpropState]:
        del params
        slope, before, way = -gradient, state.step, jnp.sign(state.step)
        by_gradient = jnp.where(slope * way >= 0.0, rate * slope, 0.0)
        # The parabola's vertex lies beyond the limit, or on the other side.
        far = (slope - growth / (1.0 + growth) * state.slope) * way > 0.0
        fall = jnp.where(far | (way == 0.0), 1.0, state.slope - slope)
        parabola = before * jnp.where(far, growth, slope / fall)
        step = by_gradient + parabola
        return step, QuickpropState(step, slope)

    return optax.GradientTransformation(first, update)  # pyright: ignore[reportArgumentType]


class ScaledState(eqx.Module):
    """Where scaled conjugate gradients stand.

    **Attributes**

    - `cost`: of the weights.
    - `residual`: minus the gradient of the cost.
    - `direction`: of the next step.
    - `scale`: Møller's λ, added to the curvature along the direction.
    - `steps`: that were taken; every so many as there are weights, the direction starts anew.
    """

    weights: Float[Array, " weights"]
    cost: Float[Array, ""]
    residual: Float[Array, " weights"]
    direction: Float[Array, " weights"]
    scale: Float[Array, ""]
    steps: Int[Array, ""]


class ScaledConjugateGradient(eqx.Module):
    """Scaled conjugate gradients (Møller 1993, Neural Networks 6, 525-533): no line search.

    The length of a step comes from the curvature along the direction, with a scale added that
    grows where the cost is no parabola. Møller estimates the curvature by a difference of two
    gradients; here it is exact. A refused step computes it again, which leads to the same.

    **Attributes**

    - `cost`: a function of the weights.
    """

    cost: Callable[[Float[Array, " weights"]], Float[Array, ""]]

    def first(self, weights: Float[Array, " weights"]) -> ScaledState:
        """The state before the first step."""
        cost, gradient = jax.value_and_grad(self.cost)(weights)
        scale = jnp.asarray(FIRST_SCALE, weights.dtype)
        return ScaledState(weights, cost, -gradient, -gradient, scale, jnp.zeros((), int))

    def step(self, state: ScaledState) -> ScaledState:
        """One step, or a larger scale where the cost would rise (Møller's steps 2 to 9)."""
        direction, residual = state.direction, state.residual
        square = direction @ direction
        moves = square > 0.0  # not at the minimum already
        _, bent = jax.jvp(jax.grad(self.cost), (state.weights,), (direction,))
        curvature = direction @ bent + state.scale * square
        scale = state.scale
        # Not positive: raise the scale until it is (step 4).
        negative = curvature <= 0.0
        scale = jnp.where(negative, 2.0 * (scale - _over(curvature, square)), scale)
        curvature = jnp.where(negative, state.scale * square - curvature, curvature)

        down = direction @ residual
        weights = state.weights + _over(down, curvature) * direction
        cost, gradient = jax.value_and_grad(self.cost)(weights)
        comparison = 2.0 * curvature * _over(state.cost - cost, down**2)
        good: Bool[Array, ""] = moves & (comparison >= 0.0)

        anew = (state.steps + 1) % len(weights) == 0
        turned = _over(gradient @ gradient + gradient @ residual, down)
        following = jnp.where(anew, -gradient, -gradient + turned * direction)
        scale = jnp.where(good & (comparison >= 0.75), 0.25 * scale, scale)
        # A cost that is not finite asks for a larger scale as well.
        poor = ~(comparison >= 0.25) & moves
        lack = jnp.where(jnp.isfinite(comparison), 1.0 - comparison, 2.0)
        scale = jnp.where(poor, scale + _over(curvature * lack, square), scale)
        return ScaledState(
            weights=jnp.where(good, weights, state.weights),
            cost=jnp.where(good, cost, state.cost),
            residual=jnp.where(good, -gradient, residual),
            direction=jnp.where(good, following, direction),
            scale=scale,
            steps=state.steps + good,
        )


def _over(number: Array, by: Array) -> Array:
    """The quotient, zero where there is nothing to divide by."""
    return jnp.where(by == 0.0, 0.0, number / jnp.where(by == 0.0, 1.0, by))

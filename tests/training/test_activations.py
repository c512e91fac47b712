"""Activation functions and preprocessing: definitions, slopes against jax.grad, ranges."""

import math
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import (
    HARD_LIMITER,
    HYPERBOLIC_TANGENT,
    LINEAR_COMBINER,
    LOGISTIC,
    Activation,
    PolynomialTerms,
    RadialBasis,
    decreasing,
    fully_connected,
)


SMOOTH = [LINEAR_COMBINER, LOGISTIC, HYPERBOLIC_TANGENT]
ALL = [HARD_LIMITER, *SMOOTH]


def test_definitions() -> None:
    s = np.linspace(-4.0, 4.0, 33)
    for activation, f in (
        (HARD_LIMITER, lambda s: 1.0 if s >= 0 else 0.0),
        (LINEAR_COMBINER, lambda s: s),
        (LOGISTIC, lambda s: 1 / (1 + math.exp(-s))),
        (HYPERBOLIC_TANGENT, math.tanh),
    ):
        assert_allclose(activation.value(jnp.asarray(s)), [f(v) for v in s], rtol=1e-14)


def test_the_step_includes_zero() -> None:
    s = jnp.asarray([-1e-300, -0.0, 0.0, 1e-300])
    assert HARD_LIMITER.value(s).tolist() == [0.0, 1.0, 1.0, 1.0]
    assert HARD_LIMITER.slope is None and decreasing(HARD_LIMITER).slope is None


@pytest.mark.parametrize(
    "activation", [*SMOOTH, *map(decreasing, SMOOTH)], ids=lambda activation: activation.name
)
def test_slopes_are_derivatives(activation: Activation, rng: np.random.Generator) -> None:
    s = jnp.asarray(np.append(rng.normal(scale=3, size=50), [0.0, 40.0, -40.0, 800.0, -800.0]))
    expected = jax.jit(jax.vmap(jax.grad(activation.value)))(s)
    assert activation.slope is not None
    assert_allclose(activation.slope(s), expected, rtol=1e-12, atol=1e-15)
    sign = 1 if activation.increasing else -1
    assert bool(jnp.all(sign * activation.slope(s) >= 0))


@pytest.mark.parametrize("activation", ALL, ids=lambda activation: activation.name)
def test_ranges_and_direction(activation: Activation) -> None:
    s = jnp.asarray(np.linspace(-1000.0, 1000.0, 4001))
    for variant in (activation, decreasing(activation)):
        y = variant.value(s)
        assert bool(jnp.all((y >= variant.low) & (y <= variant.high)))
        steps = jnp.diff(y)
        assert bool(jnp.all(steps >= 0 if variant.increasing else steps <= 0))
    assert math.isinf(LINEAR_COMBINER.high) and math.isinf(LINEAR_COMBINER.low)


def test_decreasing_twice_is_what_it_was(rng: np.random.Generator) -> None:
    s = jnp.asarray(rng.normal(size=9))
    twice = decreasing(decreasing(LOGISTIC))
    assert twice.increasing and twice.slope is not None and LOGISTIC.slope is not None
    assert_array_equal(twice.value(s), LOGISTIC.value(s))
    assert_array_equal(twice.slope(s), LOGISTIC.slope(s))
    # Equal ones compile once.
    assert decreasing(LOGISTIC) == decreasing(LOGISTIC)
    assert hash(decreasing(LOGISTIC)) == hash(decreasing(LOGISTIC))
    assert decreasing(LOGISTIC) != LOGISTIC


@pytest.mark.parametrize(("inputs", "degree"), [(1, 4), (2, 2), (3, 3)])
def test_polynomial_terms_are_all_products(
    inputs: int, degree: int, rng: np.random.Generator
) -> None:
    x = rng.normal(size=(5, inputs))
    result = PolynomialTerms(degree)(jnp.asarray(x))
    powers = [p for p in product(range(degree + 1), repeat=inputs) if 1 <= sum(p) <= degree]
    expected = np.array(
        [
            [math.prod(v**p for v, p in zip(row, power, strict=True)) for power in powers]
            for row in x
        ]
    )
    assert result.shape == (5, len(powers))
    assert_allclose(np.sort(result, axis=1), np.sort(expected, axis=1), rtol=1e-12)
    assert_array_equal(result[:, :inputs], x)


def test_polynomial_terms_of_the_exclusive_or_are_the_thesis_s() -> None:
    """Fig. 3.3-3: x1, x2, x1², x1 x2, x2²."""
    assert PolynomialTerms(2)(jnp.asarray([3.0, 5.0])).tolist() == [3.0, 5.0, 9.0, 15.0, 25.0]


def test_polynomial_terms_without_a_degree_are_refused() -> None:
    with pytest.raises(ValueError, match="expected a degree of 1 or more, got 0"):
        PolynomialTerms(0)


def test_radial_basis_against_loops(rng: np.random.Generator) -> None:
    centres, widths = rng.normal(size=(4, 3)), rng.uniform(0.3, 2.0, 4)
    nodes = RadialBasis(jnp.asarray(centres), jnp.asarray(widths))
    x = rng.normal(size=(2, 5, 3))
    expected = np.zeros((2, 5, 4))
    for index in np.ndindex(2, 5):
        for node in range(4):
            distance = math.dist(x[index], centres[node])
            expected[(*index, node)] = math.exp(-(distance**2) / (2 * widths[node] ** 2))
    assert_allclose(nodes(jnp.asarray(x)), expected, rtol=1e-12)
    assert_allclose(nodes(jnp.asarray(x[0, 0])), expected[0, 0], rtol=1e-12)


def test_radial_basis_is_one_at_its_centres_and_never_more(rng: np.random.Generator) -> None:
    centres = jnp.asarray(rng.normal(scale=10, size=(20, 6)))
    y = RadialBasis(centres, jnp.full(20, 0.5))(centres)
    assert_allclose(jnp.diagonal(y), 1.0, rtol=1e-11)
    assert bool(jnp.all(y <= 1.0))


def test_an_unknown_activation_is_refused() -> None:
    with pytest.raises(ValueError) as failure:
        fully_connected([2, 1], "sigmoid")
    assert str(failure.value) == (
        "activation: expected one of hard limiter, linear combiner, logistic, hyperbolic tangent,"
        " got 'sigmoid'"
    )

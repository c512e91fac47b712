"""Weights that a subnetwork computes (3.3.5, Fig. 3.3-5): values, gradients, and what learns."""

from typing import Any

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
    PERAL,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    ContextLayer,
    FixedRates,
    IdealPERAL,
    Layer,
    Links,
    PerceptronRule,
    Plan,
    Preprocessed,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_square,
    network_order,
    normal_equations,
    train,
)
from jaxcslc.training._network import reaching_weights


PATTERNS = 6
NAMES = tuple(f"w{index}" for index in range(15))
close: Any = {"rtol": 1e-11, "atol": 1e-13}


def split(patterns: Any) -> Signals:
    """Of five columns: two to values, two to computed weights, one a context value."""
    x = jnp.moveaxis(jnp.asarray(patterns), -1, 0)
    return Signals((x[:2], x[:2]), ((x[2:4], x[4:]), ()))


def network() -> AdaptiveNetwork:
    """tanh values, weights from a logistic layer and a tanh one, then a context value and a plain
    subnetwork that shares weight 0."""
    values = Layer(Links(3, 2, [0, 1, 2, 1], [0, 0, 0, 1], [0, 1, 2, 3]), HYPERBOLIC_TANGENT, True)
    hidden = Layer(Links.full(3, 2, first=4), LOGISTIC, bias=True)
    computing = Layer(
        Links(
            3, 3, [0, 1, 1, 0, 2], [0, 0, 1, 2, 2], [10, 11, 12, 13, 0], [1.0, 1.0, -2.0, 1.0, 0.5]
        ),
        HYPERBOLIC_TANGENT,
        bias=True,
    )
    product = Subnetwork(
        "product",
        (values,),
        (
            ContextLayer(2, 2, 3, (0, 1, 0, 1), (0, 0, 1, 1), (0, 1, 2, 1), (hidden, computing)),
            ContextLayer(2, 1, 1, (0, 1), (0, 0), (0, 0)),
        ),
    )
    plain = Subnetwork("plain", (Layer(Links(2, 1, [0, 1], [0, 0], [0, 14])),))
    return AdaptiveNetwork((product, plain), split, LOGISTIC, NAMES)


def literally(k: jax.Array, x: jax.Array) -> jax.Array:
    """The output of one pattern, written out."""
    v0 = jnp.tanh(k[0] * x[0] + k[1] * x[1] + k[2])
    v1 = jnp.tanh(k[3] * x[1])
    h0 = 1.0 / (1.0 + jnp.exp(-(k[4] * x[2] + k[5] * x[3] + k[6])))
    h1 = 1.0 / (1.0 + jnp.exp(-(k[7] * x[2] + k[8] * x[3] + k[9])))
    c0 = jnp.tanh(k[10] * h0 + k[11] * h1)
    c1 = jnp.tanh(-2.0 * k[12] * h1)
    c2 = jnp.tanh(k[13] * h0 + 0.5 * k[0])
    sums = (v0 * c0 + v1 * c1) * x[4] + (v0 * c2 + v1 * c1) * x[4] + k[0] * x[0] + k[14] * x[1]
    return 1.0 / (1.0 + jnp.exp(-sums))


LINKS_OF_A_WEIGHT = np.array([3.0] + [1.0] * 14)


@pytest.fixture
def numbers(rng: np.random.Generator) -> tuple[jax.Array, np.ndarray, np.ndarray]:
    """Weights, patterns and targets."""
    k, x = rng.normal(size=15), rng.normal(size=(PATTERNS, 5))
    return jnp.asarray(k), x, rng.uniform(0.1, 0.9, (PATTERNS, 1))


Numbers = tuple[jax.Array, np.ndarray, np.ndarray]


def test_outputs(numbers: Numbers) -> None:
    k, x, _ = numbers
    outputs = network().outputs(k, x)
    assert_allclose(outputs[:, 0], jax.vmap(literally, (None, 0))(k, jnp.asarray(x)), **close)
    assert_allclose(network().outputs(k, x[2]), outputs[2], **close)


def test_names_of_layers() -> None:
    assert network().groups == (
        "product",
        "product context, layer 1",
        "product context, layer 2",
        "plain",
    )
    assert not network().linear and not network().single_adaptive_layer
    one = Layer(Links.full(1, 1))
    twice = (ContextLayer.full(1, 1, (one,)), ContextLayer.full(1, 1, (one,)))
    names = [name for name, _ in Subnetwork("s", (one, one), twice).adaptive_layers]
    assert names == ["s 1", "s 2", "s context 1", "s context 2"]


def gradient(k: jax.Array, x: np.ndarray, t: np.ndarray, counts: np.ndarray) -> jax.Array:
    def cost(k: jax.Array) -> jax.Array:
        outputs = jax.vmap(literally, (None, 0))(k, jnp.asarray(x))
        return 0.5 * jnp.sum(counts * (t[:, 0] - outputs) ** 2) / counts.sum()

    return jax.grad(cost)(k)


def test_backpropagation_is_the_gradient(numbers: Numbers) -> None:
    """Through values and computed weights, over the number of links that share a weight."""
    k, x, t = numbers
    counts = np.array([1.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    patterns = examples(network(), x, t, counts[:, None] > 0)
    change = patterns.change(network(), Backpropagation(), k, (True,) * 4)
    expected = -np.asarray(gradient(k, x, t, counts)) / LINKS_OF_A_WEIGHT
    assert_allclose(np.sum(change, axis=0), expected, **close)
    assert not np.any(change[1, :4]) and np.all(change[1, 4:10] != 0)
    # Weight 0 has a link in three layers, each of which brings its own part.
    assert_array_equal(np.asarray(change[:, 0]) != 0, [True, False, True, True])


def test_transforms(numbers: Numbers) -> None:
    k, x, t = numbers
    patterns = examples(network(), x, t)

    def change(k: jax.Array) -> jax.Array:
        return patterns.change(network(), Backpropagation(), k, (True,) * 4)

    several = jnp.stack([k, 2.0 * k])
    mapped = jax.jit(jax.vmap(change))(several)
    for one, expected in zip(mapped, several, strict=True):
        assert_allclose(one, change(expected), **close)
    by_jax = jax.vmap(jax.grad(lambda k: network().outputs(k, x).sum()))(several)
    literal = jax.grad(lambda k: jax.vmap(literally, (None, 0))(k, jnp.asarray(x)).sum())
    assert_allclose(by_jax[1], literal(several[1]), **close)


def test_an_epoch_moves_layers_by_their_rates(numbers: Numbers) -> None:
    k, x, t = numbers
    rates = np.array([0.1, 0.2, 0.3, 0.4])
    patterns = examples(network(), x, t)
    change = patterns.change(network(), Backpropagation(), k, (True,) * 4)
    plan = Plan(Backpropagation(), FixedRates(rates), cost=half_square)
    trained = train(network(), patterns, k, plan, epochs=1)
    assert_allclose(trained.weights, k + rates @ change, **close)


@pytest.mark.parametrize(
    ("frozen", "still"),
    [
        ("product context, layer 1", range(4, 10)),
        ("plain", [14]),
        ("product", range(1, 14)),
    ],
)
def test_frozen_layers(frozen: str, still: Any, numbers: Numbers) -> None:
    k, x, t = numbers
    plan = Plan(Backpropagation(), FixedRates(0.1), cost=half_square, frozen=frozen)
    trained = train(network(), examples(network(), x, t), k, plan, epochs=2)
    assert_array_equal(np.flatnonzero(np.asarray(trained.weights) == k), list(still))


def test_weights_that_reach_an_output(numbers: Numbers) -> None:
    """Those of both factors; as the derivative says."""
    assert reaching_weights(network()) == (tuple(range(15)),)
    values, weights = Layer(Links(2, 2, [0, 1], [0, 1], [0, 1])), Layer(Links.full(1, 2, first=2))
    part = Subnetwork("s", (values,), (ContextLayer(2, 2, 2, (0, 1), (0, 1), (0, 1), (weights,)),))
    two = AdaptiveNetwork((part,), split_in_two, LINEAR_COMBINER, tuple("abcd"))
    assert reaching_weights(two) == ((0, 2), (1, 3))
    k, x = numbers[0][:4], jnp.ones(3)
    assert_array_equal(
        np.asarray(jax.jacobian(two.outputs)(k, x)) != 0, [[1, 0, 1, 0], [0, 1, 0, 1]]
    )


def split_in_two(patterns: Any) -> Signals:
    x = jnp.moveaxis(jnp.asarray(patterns), -1, 0)
    return Signals((x[:2],), ((x[2:],),))


@pytest.mark.parametrize(
    ("column", "missing"),
    [(1, "w1, w3, w14"), (2, "w4, w7"), (4, "w1, w2, w3, w4, w5 and 8 more")],
)
def test_inputs_that_tell_nothing(column: int, missing: str, numbers: Numbers) -> None:
    """Behind an input of zeros, the weights of values, of computed weights, or of both."""
    _, x, t = numbers
    silent = x.copy()
    silent[:, column] = 0.0
    with pytest.raises(ValueError) as failure:
        examples(network(), silent, t)
    assert str(failure.value).startswith(f"masks leave no data for {missing}: ")


def test_a_constant_input_tells_of_a_shared_weight(numbers: Numbers) -> None:
    _, x, t = numbers
    without = np.where(np.arange(5) == 0, 0.0, x)  # weight 0 is also that of a bias
    assert float(examples(network(), without, t).patterns) == PATTERNS


def test_the_product_is_learnt_where_a_plain_network_fails(rng: np.random.Generator) -> None:
    """x1 x2 by 4 weights: x1, weighed by what x2 computes. A plain network has 9 and fails."""
    x = rng.uniform(-1.0, 1.0, (60, 2))
    y = x[:, :1] * x[:, 1:]
    values = Layer(Links.full(2, 1), bias=True)
    weights = Layer(Links.full(2, 1, first=2), bias=True)
    part = Subnetwork("product", (values,), (ContextLayer.full(1, 1, (weights,)),))
    product = AdaptiveNetwork((part,), one_and_one, LINEAR_COMBINER, tuple("abcd"))
    plain = fully_connected([2, 2, 1], ["hyperbolic tangent", "linear combiner"])
    plan = Plan(Backpropagation(), AdaptedRates(0.1), cost=half_square, patience=2000)
    lowest: list[np.ndarray] = []
    for network in (product, plain):
        starts = rng.normal(size=(8, network.size)) / 2
        trained = train(network, examples(network, x, y), starts, plan, epochs=600)
        lowest.append(np.asarray(trained.cost))
    assert np.all(lowest[0] < 1e-9)
    assert np.all(lowest[1] > 1e-4)


def one_and_one(patterns: Any) -> Signals:
    x = jnp.moveaxis(jnp.asarray(patterns), -1, 0)
    return Signals((x[:1],), ((x[1:],),))


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (PERAL(), "PERAL cannot train weights that a subnetwork computes (3.3.5)"),
        (IdealPERAL(jnp.ones(15)), "ideal PERAL is stated for one layer without context"),
        (PerceptronRule(), "the perceptron rule trains one layer only"),
    ],
)
def test_rules_that_refuse(rule: Any, said: str, numbers: Numbers) -> None:
    k, x, t = numbers
    with pytest.raises(ValueError) as failure:
        train(network(), examples(network(), x, t), k, rule, epochs=1)
    assert str(failure.value).startswith(said) and "\n" not in str(failure.value)


def test_without_a_slope_nothing_learns(numbers: Numbers) -> None:
    weights = Layer(Links.full(1, 2, first=2), HARD_LIMITER)
    values = Layer(Links(2, 2, [0, 1], [0, 1], [0, 1]))
    part = Subnetwork("s", (values,), (ContextLayer(2, 1, 2, (0, 1), (0, 0), (0, 1), (weights,)),))
    gated = AdaptiveNetwork((part,), split_in_two, LINEAR_COMBINER, tuple("abcd"))
    _, x, t = numbers
    with pytest.raises(ValueError, match="backpropagation needs a slope, and a hard limiter"):
        train(gated, examples(gated, x[:, :3], t), np.ones(4), Backpropagation(), epochs=1)


def test_refusals(numbers: Numbers) -> None:
    _, x, t = numbers
    with pytest.raises(ValueError, match=r"network order: subnetwork 'product' computes weights"):
        network_order(network())
    with pytest.raises(ValueError, match="normal equations need outputs that are linear"):
        normal_equations(network(), examples(network(), x, t))
    one, two = Layer(Links.full(1, 1)), Layer(Links.full(2, 2))
    with pytest.raises(ValueError, match="1 context values, but the layers that compute them"):
        ContextLayer.full(1, 1, (two,))
    with pytest.raises(ValueError, match="layer 1 of those that compute its weights has 1 nodes"):
        ContextLayer.full(2, 1, (one, two))
    part = Subnetwork("s", (one,), (ContextLayer.full(1, 1, (Layer(Links.full(1, 1, 3)),)),))
    with pytest.raises(ValueError, match="links use weight 3, but only 2 are named"):
        AdaptiveNetwork((part,), Preprocessed(1), LINEAR_COMBINER, ("a", "b"))

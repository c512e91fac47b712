"""Networks of layers against loops, and what they refuse."""

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
    AdaptiveNetwork,
    ContextLayer,
    Layer,
    Links,
    PolynomialTerms,
    Preprocessed,
    Signals,
    Subnetwork,
    fully_connected,
)


ACTIVATIONS = {
    "hard limiter": lambda s: np.where(s >= 0, 1.0, 0.0),
    "linear combiner": lambda s: s,
    "logistic": lambda s: 1 / (1 + np.exp(-s)),
    "hyperbolic tangent": np.tanh,
}


@pytest.mark.parametrize("kind", list(ACTIVATIONS))
@pytest.mark.parametrize("bias", [False, True])
def test_one_layer_is_a_matrix(kind: str, bias: bool, rng: np.random.Generator) -> None:
    """y = f(x W), W inputs by outputs (3.3.2, 3.4.1)."""
    network = fully_connected([3, 2], kind, bias=bias)
    k = rng.normal(size=network.size)
    x = rng.normal(size=(7, 3))
    seen = np.column_stack([x, np.ones(7)]) if bias else x
    expected = ACTIVATIONS[kind](seen @ k.reshape(2, -1).T)
    assert_allclose(network.outputs(jnp.asarray(k), x), expected, rtol=1e-13)


def test_two_layers(rng: np.random.Generator) -> None:
    network = fully_connected([3, 4, 2], ["hyperbolic tangent", "logistic"])
    k = rng.normal(size=network.size)
    first, second = k[:16].reshape(4, 4), k[16:].reshape(2, 5)
    x = rng.normal(size=(7, 3))
    hidden = np.tanh(np.column_stack([x, np.ones(7)]) @ first.T)
    s = np.column_stack([hidden, np.ones(7)]) @ second.T
    assert_allclose(network.outputs(jnp.asarray(k), x), 1 / (1 + np.exp(-s)), rtol=1e-12)
    assert network.groups == ("network 1", "network 2")
    assert not network.single_adaptive_layer and not network.linear
    assert network.names[3] == "layer 1, node 1, bias"
    assert network.names[16] == "layer 2, node 1, input 1"


def test_linear_layers_are_equal_to_one(rng: np.random.Generator) -> None:
    """Fig. 3.3-2."""
    two = fully_connected([3, 4, 2], "linear combiner", bias=False)
    one = fully_connected([3, 2], "linear combiner", bias=False)
    k = rng.normal(size=two.size)
    merged = k[12:].reshape(2, 4) @ k[:12].reshape(4, 3)
    x = rng.normal(size=(5, 3))
    assert_allclose(
        two.outputs(jnp.asarray(k), x),
        one.outputs(jnp.asarray(merged.ravel()), x),
        rtol=1e-12,
    )


def superposed() -> AdaptiveNetwork:
    """Two subnetworks that share weight 1: a context layer behind tanh nodes, and a plain one."""
    with_context = Subnetwork(
        "context",
        (
            Layer(
                Links(2, 3, [0, 1, 1], [0, 1, 2], [0, 1, 1], [1.0, 2.0, -1.0]), HYPERBOLIC_TANGENT
            ),
        ),
        (ContextLayer(3, 2, 2, (0, 1, 2), (0, 1, 1), (0, 0, 1)),),
    )
    plain = Subnetwork("plain", (Layer(Links(2, 2, [0, 1], [0, 1], [1, 2])),))

    def signals(patterns: Any) -> Signals:
        x, context = (jnp.moveaxis(jnp.asarray(part), -1, 0) for part in patterns)
        return Signals((x, x), ((context,), ()))

    return AdaptiveNetwork((with_context, plain), signals, LOGISTIC, ("a", "b", "c"))


def test_superposed_subnetworks_add_up(rng: np.random.Generator) -> None:
    network = superposed()
    a, b, c = k = rng.normal(size=3)
    x, context = rng.normal(size=(2, 6, 2))
    expected = np.zeros((6, 2))
    for p in range(6):
        hidden = [np.tanh(a * x[p, 0]), np.tanh(2 * b * x[p, 1]), np.tanh(-b * x[p, 1])]
        s = [
            hidden[0] * context[p, 0] + b * x[p, 0],
            hidden[1] * context[p, 0] + hidden[2] * context[p, 1] + c * x[p, 1],
        ]
        expected[p] = 1 / (1 + np.exp(-np.array(s)))
    assert_allclose(network.outputs(jnp.asarray(k), (x, context)), expected, rtol=1e-13)
    assert network.groups == ("context", "plain")
    assert network.single_adaptive_layer and not network.linear


@pytest.mark.parametrize("shape", [(), (1,), (5,), (2, 5), (3, 1, 4)])
def test_any_batch_of_patterns(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    network = fully_connected([3, 3, 2], "hyperbolic tangent", preprocess=PolynomialTerms(2))
    k = jnp.asarray(rng.normal(size=network.size))
    x = rng.normal(size=(*shape, 3))
    y = network.outputs(k, x)
    assert y.shape == (*shape, 2)
    for index in np.ndindex(*shape):
        assert_allclose(y[index], network.outputs(k, x[index]), rtol=1e-12)


def test_transforms(rng: np.random.Generator) -> None:
    network = superposed()
    k, x = jnp.asarray(rng.normal(size=(4, 3))), rng.normal(size=(2, 6, 2))
    patterns = (jnp.asarray(x[0]), jnp.asarray(x[1]))
    eager = network.outputs(k[0], patterns)
    assert_allclose(jax.jit(network.outputs)(k[0], patterns), eager, rtol=1e-13)
    mapped = jax.jit(jax.vmap(network.outputs, (0, None)))(k, patterns)
    assert_allclose(mapped[0], eager, rtol=1e-13)
    by_pattern = jax.jit(jax.vmap(network.outputs, (None, 0)))(k[0], patterns)
    assert_allclose(by_pattern, eager, rtol=1e-13)


def test_integers_are_taken_as_numbers() -> None:
    network = fully_connected([2, 1], "linear combiner")
    k = jnp.asarray([1.0, 2.0, 3.0])
    assert network.outputs(k, np.asarray([[1, 2]])).tolist() == [[8.0]]


@pytest.mark.parametrize(
    ("weights", "shape", "said"),
    [
        (2, (4, 2), "weights: expected shape (3,), got (2,)"),
        (4, (4, 2), "weights: expected shape (3,), got (4,)"),
        (3, (4, 3), "inputs: expected shape (..., 2), got (4, 3)"),
    ],
)
def test_wrong_shapes(weights: int, shape: tuple[int, ...], said: str) -> None:
    network = fully_connected([2, 1], "linear combiner")
    with pytest.raises(ValueError) as failure:
        network.outputs(jnp.ones(weights), np.ones(shape))
    assert str(failure.value) == said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([3], "logistic"), "sizes: expected inputs and nodes, at least [1, 1], got [3]"),
        (([3, 0], "logistic"), "sizes: expected inputs and nodes, at least [1, 1], got [3, 0]"),
        (([3, 2, 1], ["logistic"]), "activations: expected one a layer, 2, got 1"),
        (([3, 2], ["tanh"]), "activation: expected one of hard limiter, linear combiner, logistic"),
    ],
)
def test_full_networks_refused(arguments: Any, said: str) -> None:
    with pytest.raises(ValueError) as failure:
        fully_connected(*arguments)
    assert str(failure.value).startswith(said)


def test_subnetworks_refused() -> None:
    layer = Layer(Links.full(2, 3))
    with pytest.raises(ValueError, match="subnetwork 'a': expected at least one adaptive layer"):
        Subnetwork("a", ())
    with pytest.raises(ValueError, match="subnetwork 'a': layer 1 has 3 nodes, layer 2 takes 2"):
        Subnetwork("a", (layer, layer))
    with pytest.raises(ValueError, match="the last layer's nodes are outputs"):
        Subnetwork("a", (Layer(Links.full(2, 3), HARD_LIMITER),))


def test_networks_refused() -> None:
    two, three = Layer(Links.full(2, 2)), Layer(Links.full(2, 3))
    parts = (Subnetwork("a", (two,)), Subnetwork("b", (three,)))
    names = tuple("abcdef")
    with pytest.raises(ValueError, match="must have the same output nodes, got a: 2, b: 3"):
        AdaptiveNetwork(parts, Preprocessed(2), LINEAR_COMBINER, names)
    with pytest.raises(ValueError, match="must have the same output nodes, got none"):
        AdaptiveNetwork((), Preprocessed(2), LINEAR_COMBINER, names)
    with pytest.raises(ValueError, match="links use weight 5, but only 5 are named"):
        AdaptiveNetwork(parts[1:], Preprocessed(2), LINEAR_COMBINER, names[:5])


def test_preprocessing_stands_before_the_first_layer(rng: np.random.Generator) -> None:
    network = fully_connected([2, 1], "linear combiner", preprocess=PolynomialTerms(2))
    k, x = rng.normal(size=6), rng.normal(size=(4, 2))
    terms = np.column_stack([x, x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2, np.ones(4)])
    assert_allclose(network.outputs(jnp.asarray(k), x)[:, 0], terms @ k, rtol=1e-12)
    signals = network.signals(x)
    assert_array_equal(signals.inputs[0][:2], x.T)

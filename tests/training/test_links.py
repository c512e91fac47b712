"""Links and layers against loops: what does not exist, what is shared, what is refused."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import ContextLayer, Layer, Links


def random_links(rng: np.random.Generator, inputs: int, nodes: int, weights: int) -> Links:
    """About half the links, some pairs doubly linked, few weights, multiples of either sign."""
    count = inputs * nodes // 2 + 3
    multiple = rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 3.0], count)
    return Links(
        inputs,
        nodes,
        rng.integers(inputs, size=count),
        rng.integers(nodes, size=count),
        rng.integers(weights, size=count),
        multiple,
    )


@pytest.mark.parametrize("magnitude", [False, True])
def test_matrix_is_the_sum_of_its_links(rng: np.random.Generator, magnitude: bool) -> None:
    links = random_links(rng, 5, 4, 3)
    k = rng.normal(size=3)
    expected = np.zeros((4, 5))
    for source, node, weight, multiple in zip(
        links.source, links.node, links.weight, links.multiple, strict=True
    ):
        value = multiple * k[weight]
        expected[node, source] += abs(value) if magnitude else value
    result = links.matrix(jnp.asarray(k), magnitude=magnitude)
    assert_allclose(result, expected, rtol=1e-14, atol=1e-14)


def test_two_links_between_one_pair_do_not_cancel_in_magnitude() -> None:
    links = Links(1, 1, [0, 0], [0, 0], [0, 1], [0.5, -0.5])
    k = jnp.asarray([2.0, 2.0])
    assert links.matrix(k).tolist() == [[0.0]]
    assert links.matrix(k, magnitude=True).tolist() == [[2.0]]


def test_links_that_do_not_exist_pass_nothing(rng: np.random.Generator) -> None:
    links = Links(3, 2, [0, 2], [1, 0], [0, 1])
    assert links.matrix(jnp.asarray([5.0, 7.0])).tolist() == [[0.0, 0.0, 7.0], [5.0, 0.0, 0.0]]
    assert links.at_links(jnp.arange(6.0).reshape(2, 3)).tolist() == [3.0, 2.0]


def test_full_numbers_node_by_node(rng: np.random.Generator) -> None:
    links = Links.full(3, 2, first=4)
    k = rng.normal(size=10)
    assert_array_equal(links.matrix(jnp.asarray(k)), k[4:].reshape(2, 3))
    matrix = jnp.asarray(rng.normal(size=(2, 3)))
    assert_array_equal(links.at_links(matrix), matrix.reshape(-1))


def test_an_ordered_matrix_and_a_shuffled_one_agree(rng: np.random.Generator) -> None:
    full = Links.full(4, 3)
    order = rng.permutation(full.count)
    shuffled = Links(4, 3, full.source[order], full.node[order], full.weight[order])
    k = jnp.asarray(rng.normal(size=12))
    assert_array_equal(full.matrix(k), shuffled.matrix(k))
    matrix = jnp.asarray(rng.normal(size=(3, 4)))
    assert_array_equal(full.at_links(matrix)[order], shuffled.at_links(matrix))


def test_to_weights_is_the_transpose(rng: np.random.Generator) -> None:
    """<links, k at the links> = <sums over the links, k>."""
    links = random_links(rng, 5, 4, 6)
    per_link, k = rng.normal(size=links.count), rng.normal(size=6)
    sums = links.to_weights(jnp.asarray(per_link), 6)
    assert_allclose(per_link @ k[links.weight], sums @ k, rtol=1e-12)


def test_equal_links_are_equal_and_cannot_be_changed() -> None:
    one, same = Links(2, 1, [0, 1], [0, 0], [0, 1]), Links(2, 1, [0, 1], [0, 0], [0, 1])
    other = Links(2, 1, [0, 1], [0, 0], [0, 1], [1.0, 2.0])
    assert one == same and hash(one) == hash(same)
    assert one != other and one != "links"
    assert "2 to 1: 2 links, 2 weights" in repr(one)
    with pytest.raises(ValueError, match="read-only"):
        one.weight[0] = 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0, 2], [0, 0], [0, 1]), "links: source of link 1 is 2, expected 0 to 1"),
        (([0, 1], [0, 1], [0, 1]), "links: node of link 1 is 1, expected 0 to 0"),
        (([0, 1], [0, 0], [0, -1]), "links: weight of link 1 is -1, expected 0 to …"),
        (([0, 1], [0, 0], [0, 1], [1.0, 0.0]), "links: multiples must be finite and not zero"),
        (([0, 1], [0, 0], [0, 1], [1.0, np.nan]), "links: multiples must be finite and not zero"),
        (([0, 1], [0], [0, 1]), "links: source, node, weight and multiple must be lists of one"),
    ],
)
def test_links_refused(arguments: Any, said: str) -> None:
    with pytest.raises(ValueError) as failure:
        Links(2, 1, *arguments)
    assert str(failure.value).startswith(said)


def test_bias_is_a_constant_input_of_one(rng: np.random.Generator) -> None:
    layer = Layer(Links.full(3, 2), bias=True)
    assert layer.inputs == 2
    x = jnp.asarray(rng.normal(size=(2, 5)))
    assert_array_equal(layer.with_bias(x), np.concatenate([x, np.ones((1, 5))]))
    assert_array_equal(layer.with_bias(x[:, 0]), np.append(x[:, 0], 1.0))
    assert Layer(Links.full(3, 2)).with_bias(x) is x


def test_context_layer_multiplies_data_by_data(rng: np.random.Generator) -> None:
    source, node, context = (0, 1, 2, 2, 0), (0, 0, 1, 3, 3), (1, 0, 1, 1, 0)
    layer = ContextLayer(4, 4, 2, source, node, context)
    values, contexts = rng.normal(size=(4, 6)), rng.normal(size=(2, 6))
    forward, backward = np.zeros((4, 6)), np.zeros((4, 6))
    at_nodes = rng.normal(size=(4, 6))
    for s, n, c in zip(source, node, context, strict=True):
        for pattern in range(6):
            forward[n, pattern] += values[s, pattern] * contexts[c, pattern]
            backward[s, pattern] += at_nodes[n, pattern] * contexts[c, pattern]
    signals = jnp.asarray(contexts)
    assert_allclose(layer.forward(jnp.asarray(values), signals), forward, rtol=1e-14)
    assert_allclose(layer.backward(jnp.asarray(at_nodes), signals), backward, rtol=1e-14)
    assert layer.fan_out.tolist() == [2, 1, 2, 1]


def test_context_layer_backward_is_the_transpose(rng: np.random.Generator) -> None:
    layer = ContextLayer(3, 2, 2, (0, 1, 2, 2), (0, 0, 1, 0), (0, 1, 1, 0))
    context = jnp.asarray(rng.normal(size=2))
    values, at_nodes = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.normal(size=2))
    _, transpose = jax.vjp(lambda v: layer.forward(v, context), values)
    assert_allclose(layer.backward(at_nodes, context), transpose(at_nodes)[0], rtol=1e-14)


def test_a_context_layer_without_links_answers_nothing() -> None:
    layer = ContextLayer(2, 3, 1, (), (), ())
    assert layer.forward(jnp.ones((2, 4)), jnp.ones((1, 4))).tolist() == np.zeros((3, 4)).tolist()
    assert layer.fan_out.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("indices", "said"),
    [
        (((3,), (0,), (0,)), "context layer: source indices must be 0 to 2, got 3 to 3"),
        (((0,), (-1,), (0,)), "context layer: node indices must be 0 to 1, got -1 to -1"),
        (((0,), (0,), (1,)), "context layer: context indices must be 0 to 0, got 1 to 1"),
        (((0, 1), (0,), (0,)), "context layer: source, node and context must be of one length"),
    ],
)
def test_context_layers_refused(indices: Any, said: str) -> None:
    with pytest.raises(ValueError) as failure:
        ContextLayer(3, 2, 1, *indices)
    assert str(failure.value) == said

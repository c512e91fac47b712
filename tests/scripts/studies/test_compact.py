"""Networks without what is pruned: the same answers from fewer links, nodes and inputs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.network import CSLC
from jaxcslc.training import (
    HYPERBOLIC_TANGENT,
    LINEAR_COMBINER,
    LOGISTIC,
    AdaptiveNetwork,
    Backpropagation,
    ContextLayer,
    FixedRates,
    Layer,
    Links,
    Plan,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_square,
    inverse_dynamics,
    normal_equations,
    train,
)
from scripts.studies.generalisation.pruning import LinkEnds, compact, prune


close: Any = {"rtol": 1e-12, "atol": 1e-13}
PATTERNS = 7


def links(network: AdaptiveNetwork) -> int:
    return sum(layer.links.count for _, layer in network.adaptive_layers)


def nodes(network: AdaptiveNetwork) -> list[int]:
    return [layer.links.nodes for _, layer in network.adaptive_layers]


@pytest.mark.parametrize("hidden", ["hyperbolic tangent", "logistic", "linear combiner"])
@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_layered_network(hidden: str, share: float, rng: np.random.Generator) -> None:
    network = fully_connected([4, 5, 4, 2], [hidden, hidden, "logistic"])
    x = rng.normal(size=(PATTERNS, 4))
    for _ in range(3):
        k, kept = rng.normal(size=network.size), rng.uniform(size=network.size) > share
        smaller, weights = compact(network, k, kept)
        expected = network.outputs(jnp.asarray(k * kept), x)
        assert_allclose(smaller.outputs(weights, x), expected, **close)
        assert set(smaller.names) <= set(np.array(network.names)[kept])
        assert links(smaller) == smaller.size <= kept.sum()
        # Each weight that is left has an effect: nothing dead is left.
        slopes = jax.jacobian(smaller.outputs)(weights, jnp.asarray(x))
        assert np.all(np.any(np.asarray(slopes) != 0, axis=(0, 1)))


def test_all_kept_is_the_same_network(rng: np.random.Generator) -> None:
    network = fully_connected([3, 4, 2], ["hyperbolic tangent", "logistic"])
    k = rng.normal(size=network.size)
    same, weights = compact(network, k, np.ones(network.size, bool))
    assert same.subnetworks == network.subnetworks and same.names == network.names
    assert_array_equal(weights, k)


def test_a_node_goes_with_its_links() -> None:
    """One that leads nowhere, one that answers zero always, and an input that nothing reads."""
    network = fully_connected([2, 3, 1], ["hyperbolic tangent", "linear combiner"], bias=False)
    kept = np.array([0, 1, 0, 1, 0, 0, 1, 0, 1], bool)  # node 2 leads nowhere, node 3 reads nothing
    smaller, weights = compact(network, np.arange(9.0), kept)
    assert smaller.names == ("layer 1, node 1, input 2", "layer 2, node 1, input 1")
    assert_array_equal(weights, [1.0, 6.0])
    assert nodes(smaller) == [1, 1]
    assert smaller.signals(np.ones((PATTERNS, 2))).inputs[0].shape == (1, PATTERNS)


def test_a_logistic_node_without_inputs_answers_a_half() -> None:
    network = fully_connected([1, 1, 1], ["logistic", "linear combiner"], bias=False)
    smaller, weights = compact(network, np.array([5.0, 3.0]), np.array([False, True]))
    assert smaller.names == ("layer 2, node 1, input 1",)
    assert_allclose(smaller.outputs(weights, np.ones((2, 1))), [[1.5], [1.5]], **close)


def test_a_bias_alone() -> None:
    network = fully_connected([2, 3, 2], ["hyperbolic tangent", "linear combiner"])
    kept = np.array([name == "layer 2, node 1, bias" for name in network.names])
    smaller, weights = compact(network, np.arange(float(network.size)), kept)
    assert weights.tolist() == [12.0]
    assert_array_equal(smaller.outputs(weights, np.ones((3, 2))), [[12.0, 0.0]] * 3)


def computed_weights() -> AdaptiveNetwork:
    """Values times computed weights times given ones, and a subnetwork of its own."""

    def signals(patterns: Any) -> Signals:
        x = jnp.moveaxis(jnp.asarray(patterns), -1, 0)
        return Signals((x[:2], x[:3]), ((x[2:4], x[4:]), ()))

    values = Layer(Links.full(2, 3), HYPERBOLIC_TANGENT)
    hidden = Layer(Links.full(3, 3, first=6), LOGISTIC, bias=True)
    computing = Layer(Links.full(3, 6, first=15), HYPERBOLIC_TANGENT)
    product = Subnetwork(
        "product",
        (values,),
        (
            ContextLayer.full(3, 2, (hidden, computing)),
            ContextLayer(2, 2, 2, (0, 1, 1), (0, 0, 1), (0, 1, 1)),
        ),
    )
    plain = Subnetwork("plain", (Layer(Links.full(3, 2, first=33)),))
    names = tuple(f"w{index}" for index in range(39))
    return AdaptiveNetwork((product, plain), signals, LINEAR_COMBINER, names)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_computed_weights(share: float, rng: np.random.Generator) -> None:
    network = computed_weights()
    x = rng.normal(size=(PATTERNS, 6))
    for _ in range(3):
        k, kept = rng.normal(size=39), rng.uniform(size=39) > share
        smaller, weights = compact(network, k, kept)
        expected = network.outputs(jnp.asarray(k * kept), x)
        assert_allclose(smaller.outputs(weights, x), expected, **close)
        slopes = jax.jacobian(smaller.outputs)(weights, jnp.asarray(x))
        assert np.all(np.any(np.asarray(slopes) != 0, axis=(0, 1)))


def test_a_factor_that_is_zero_takes_the_other_with_it() -> None:
    kept = np.ones(39, bool)
    kept[15:33] = False  # every computed weight is tanh(0)
    smaller, _ = compact(computed_weights(), np.ones(39), kept)
    assert smaller.groups == ("plain",)
    assert smaller.names == tuple(f"w{index}" for index in range(33, 39))


def test_a_cslc_loses_the_links_of_a_coefficient(puma: CSLC, rng: np.random.Generator) -> None:
    """In mass and velocity alike; joint torques stay the derivation's, with zeros."""
    network = inverse_dynamics(puma)
    k, motion = rng.normal(size=43), tuple(rng.normal(size=(3, PATTERNS, 6)))
    going = [i for i, c in enumerate(puma.coefficients) if c.group == "dry" or c.name == "kM4"]
    kept = np.ones(43, bool)
    kept[going] = False
    smaller, weights = compact(network, k, kept)
    assert smaller.groups == ("mass", "velocity", "gravity", "viscous")
    assert smaller.names == tuple(name for i, name in enumerate(puma.names) if kept[i])
    for before, after in zip(network.subnetworks, smaller.subnetworks, strict=False):
        lost = np.isin(before.layers[0].links.weight, going).sum()
        assert after.layers[0].links.count == before.layers[0].links.count - lost
    assert_allclose(smaller.outputs(weights, motion), puma.torque(k * kept, *motion), rtol=1e-10)

    # It learns as any other: from zero weights to the torques.
    torque = np.asarray(puma.torque(jnp.asarray(k * kept), *motion))
    patterns = examples(smaller, motion, torque)
    steepest = float(np.linalg.eigvalsh(np.asarray(normal_equations(smaller, patterns).gram))[-1])
    plan = Plan(Backpropagation(), FixedRates(1.0 / steepest), cost=half_square)
    trained = train(smaller, patterns, np.zeros(smaller.size), plan, epochs=3)
    assert trained.cost < half_square(jnp.asarray(torque.T), jnp.ones(torque.T.shape))


def test_pruned_networks_are_compacted(rng: np.random.Generator) -> None:
    """`prune` finds the links of an output's second node useless; the node goes."""
    network = fully_connected([2, 2, 1], ["hyperbolic tangent", "linear combiner"], bias=False)
    k, x = np.array([1.0, 2.0, 0.5, 0.5, 3.0, 1e-6]), rng.normal(size=(20, 2))
    patterns = examples(network, x, np.asarray(network.outputs(jnp.asarray(k), x)) + 0.01)
    ends = LinkEnds(np.array([0, 1, 0, 1, 2, 3]), np.array([2, 2, 3, 3, 4, 4]))

    def cost(weights: jax.Array) -> jax.Array:
        return half_square(patterns.errors(network, weights), patterns.counts)

    pruned = prune(cost, k, ends)
    smaller, weights = pruned.compact(network)
    assert smaller.size == 3 == pruned.kept.sum() and nodes(smaller) == [1, 1]
    masked = network.outputs(jnp.asarray(pruned.weights), x)
    assert_allclose(smaller.outputs(weights, x), masked, **close)
    left = half_square(
        examples(smaller, x, patterns.targets.T).errors(smaller, weights), patterns.counts
    )
    assert_allclose(left, pruned.cost_after, rtol=1e-9)


def test_transforms(rng: np.random.Generator) -> None:
    network = computed_weights()
    k, kept = rng.normal(size=39), rng.uniform(size=39) > 0.3
    smaller, weights = compact(network, k, kept)
    x = jnp.asarray(rng.normal(size=(PATTERNS, 6)))
    eager = smaller.outputs(weights, x)
    assert_allclose(jax.jit(smaller.outputs)(weights, x), eager, **close)
    several = jax.vmap(smaller.outputs, (0, None))(jnp.stack([weights, weights]), x)
    assert_allclose(several[1], eager, **close)
    again, same = compact(smaller, weights, np.ones(smaller.size, bool))
    assert_allclose(again.outputs(same, x), eager, **close)


@pytest.mark.parametrize(
    ("weights", "kept", "said"),
    [
        (np.ones(3), np.ones(4, bool), r"expected shape \(3,\), got \(3,\) and \(4,\)"),
        (np.ones(2), np.ones(3, bool), r"expected shape \(3,\), got \(2,\) and \(3,\)"),
        (np.ones(3), np.zeros(3, bool), "no link that is left leads from an input or a bias"),
    ],
)
def test_refused(weights: np.ndarray, kept: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        compact(fully_connected([2, 1], "linear combiner"), weights, kept)

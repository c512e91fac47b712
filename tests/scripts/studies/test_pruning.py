"""Pruning: the rule against a literal transcription, nodes that go, and what is refused."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose, assert_array_equal

from scripts.studies.generalisation.pruning import LinkEnds, prune


INPUTS, HIDDEN, OUTPUTS = 4, 5, 2


def network(weights: jax.Array, x: jax.Array) -> jax.Array:
    """Tanh hidden nodes without biases, linear outputs."""
    first, second = jnp.split(weights, [INPUTS * HIDDEN])
    hidden = jnp.tanh(x @ first.reshape(INPUTS, HIDDEN))
    return hidden @ second.reshape(HIDDEN, OUTPUTS)


def cost(weights: jax.Array, x: jax.Array, target: jax.Array) -> jax.Array:
    return jnp.mean((network(weights, x) - target) ** 2)


def wiring() -> LinkEnds:
    hidden = INPUTS + np.arange(HIDDEN)
    outputs = INPUTS + HIDDEN + np.arange(OUTPUTS)
    first = np.meshgrid(np.arange(INPUTS), hidden, indexing="ij")
    second = np.meshgrid(hidden, outputs, indexing="ij")
    return LinkEnds(
        *(np.concatenate([a.ravel(), b.ravel()]) for a, b in zip(first, second, strict=True))
    )


@pytest.fixture
def trained(rng: np.random.Generator) -> tuple[np.ndarray, tuple[jax.Array, jax.Array]]:
    """Weights of which a third hardly matter, and patterns that they fit but for noise."""
    x = jnp.asarray(rng.normal(size=(80, INPUTS)))
    weights = rng.normal(size=INPUTS * HIDDEN + HIDDEN * OUTPUTS)
    weights[rng.permutation(weights.size)[:10]] *= 0.02
    target = network(jnp.asarray(weights), x) + 0.1 * rng.normal(size=(80, OUTPUTS))
    return weights, (x, target)


def literally(
    f: Callable[[np.ndarray], float], weights: np.ndarray, links: LinkEnds | None, tolerance: float
) -> tuple[list[int], float]:
    """The rule as it is stated, one cost at a time."""
    limit = (1 + tolerance) * f(weights)
    now, removed = weights.copy(), list[int]()

    def drop(start: np.ndarray, i: int) -> np.ndarray:
        left = start.copy()
        left[i] = 0.0
        while links is not None:
            dead = {
                node
                for node in set(links.source) & set(links.target)
                if not np.any(left[links.source == node])
            }
            more = [j for j in np.flatnonzero(left) if links.target[j] in dead]
            if not more:
                break
            left[more] = 0.0
        return left

    while True:
        alone = {i: f(drop(now, i)) for i in np.flatnonzero(now).tolist()}
        going = sorted((i for i in alone if alone[i] <= limit), key=lambda i: alone[i])
        if not going:
            return removed, f(now)
        for i in going:
            trial = drop(now, i)
            if now[i] != 0 and f(trial) <= limit:
                removed += [int(j) for j in np.flatnonzero((now != 0) & (trial == 0))]
                now = trial


@pytest.mark.parametrize("with_nodes", [False, True])
@pytest.mark.parametrize("tolerance", [0.0, 0.05, 1.0, 20.0])
def test_it_does_as_it_is_written(
    trained: tuple[np.ndarray, Any], with_nodes: bool, tolerance: float
) -> None:
    weights, data = trained
    links = wiring() if with_nodes else None
    f = jax.jit(cost)
    expected, after = literally(lambda w: float(f(w, *data)), weights, links, tolerance)
    result = prune(cost, weights, links, tolerance=tolerance, args=data)
    assert result.removed.tolist() == expected
    assert_allclose(result.cost_after, after, rtol=1e-12)
    assert result.finished


def test_nothing_left_can_go_alone(trained: tuple[np.ndarray, Any]) -> None:
    weights, data = trained
    result = prune(cost, weights, tolerance=0.2, args=data)
    limit = 1.2 * result.cost_before
    assert result.cost_after <= limit
    assert_array_equal(result.weights, np.where(result.kept, weights, 0.0))
    assert_array_equal(np.flatnonzero(~result.kept), np.sort(result.removed))
    assert 8 <= result.removed.size < weights.size
    for i in np.flatnonzero(result.kept):
        without = result.weights.copy()
        without[i] = 0.0
        assert cost(jnp.asarray(without), *data) > limit


def test_sensitivity_is_the_increase_of_each_alone(trained: tuple[np.ndarray, Any]) -> None:
    weights, data = trained
    result = prune(cost, weights, tolerance=0.0, args=data)
    without = weights[None] * (1 - np.eye(weights.size))
    one = np.array([cost(jnp.asarray(w), *data) for w in without])
    assert_allclose(result.sensitivity, one - result.cost_before, atol=1e-12)


def test_a_chain_of_nodes_goes_at_once() -> None:
    """0 -> 1 -> 2 -> 4, and 0 -> 3 -> 4, which alone matters."""
    links = LinkEnds(np.array([0, 1, 2, 0, 3]), np.array([1, 2, 4, 3, 4]))

    def product(w: jax.Array) -> jax.Array:
        return (w[3] * w[4] + 1e-6 * w[0] * w[1] * w[2] - 1.0) ** 2 + 1.0

    result = prune(product, np.array([5.0, 4.0, 0.1, 2.0, 0.5]), links)
    assert result.nodes == (1, 2)
    assert_array_equal(result.kept, [False, False, False, True, True])


def test_outputs_and_inputs_are_no_nodes_that_go() -> None:
    links = LinkEnds(np.array([0, 1]), np.array([2, 2]))
    result = prune(lambda w: (w[0] - 1.0) ** 2 + 1.0, np.array([1.0, 3.0]), links)
    assert_array_equal(result.kept, [True, False])
    assert result.nodes == ()


def test_what_is_not_tested_goes_with_its_node_only() -> None:
    """Two Gaussians; a centre at zero is a centre, not a link that is missing."""
    x = jnp.linspace(-1.0, 1.0, 40)

    def radial(w: jax.Array) -> jax.Array:
        parts = w[2:, None] * jnp.exp(-((x[None, :] - w[:2, None]) ** 2))
        return jnp.mean((jnp.sum(parts, axis=0) - jnp.exp(-((x - 0.01) ** 2))) ** 2) + 1e-4

    links = LinkEnds(np.array([0, 0, 1, 2]), np.array([1, 2, 3, 3]))
    tested = np.array([False, False, True, True])
    weights = np.array([0.01, 0.5, 1.0, 1e-5])
    result = prune(radial, weights, links, tested=tested)
    assert_array_equal(result.kept, [True, False, True, False])
    assert result.removed.tolist() == [3, 1]
    assert_array_equal(np.isnan(result.sensitivity), ~tested)


def test_a_pytree_by_way_of_its_flat_weights(trained: tuple[np.ndarray, Any]) -> None:
    weights, (x, target) = trained
    tree = {"hidden": jnp.asarray(weights[:20]), "output": jnp.asarray(weights[20:])}
    flat, unravel = ravel_pytree(tree)

    def of_tree(w: jax.Array) -> jax.Array:
        parts = unravel(w)
        return cost(jnp.concatenate([parts["hidden"], parts["output"]]), x, target)

    result = prune(of_tree, flat, tolerance=0.1)
    assert_array_equal(result.kept, prune(cost, weights, tolerance=0.1, args=(x, target)).kept)


def test_other_weights_and_passes_compile_nothing(trained: tuple[np.ndarray, Any]) -> None:
    weights, data = trained
    traces = 0

    def counted(w: jax.Array, x: jax.Array, target: jax.Array) -> jax.Array:
        nonlocal traces
        traces += 1
        return cost(w, x, target)

    prune(counted, weights, args=data)
    prune(counted, 2.0 * weights, args=data)
    assert traces == 1


def test_passes_can_run_out(trained: tuple[np.ndarray, Any]) -> None:
    weights, data = trained
    result = prune(cost, weights, args=data, tolerance=0.5, passes=1)
    assert (result.passes, result.finished) == (1, False)
    assert "1 passes, not finished" in str(result)


def test_a_cost_that_is_no_number_is_a_marked_increase() -> None:
    result = prune(lambda w: 1.0 + 0.0 / w[0], np.array([2.0, 1.0]))
    assert_array_equal(result.kept, [True, False])


def test_all_may_go() -> None:
    result = prune(lambda w: 1.0 + 0.0 * w[0], np.array([2.0, 1.0]))
    assert not np.any(result.kept)
    assert result.finished


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tolerance": -0.1}, "tolerance is -0.1; expected a finite number, 0 or more"),
        ({"passes": 0}, "0 passes; expected 1 or more, or None"),
        ({"links": LinkEnds(np.array([0]), np.array([1]))}, "links of 1 weights; expected 2"),
        ({"tested": np.ones(3, bool)}, "tested has 3 entries; expected 2"),
        ({"tested": np.zeros(2, bool)}, "no weight may be removed; expected some to be tested"),
    ],
)
def test_wrong_use(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError) as failure:
        prune(lambda w: jnp.sum(w**2), np.array([1.0, 2.0]), **change)
    assert str(failure.value) == said


def test_costs_that_are_no_use() -> None:
    with pytest.raises(ValueError, match=r"the cost has shape \(2,\); expected a scalar"):
        prune(lambda w: w, np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="the cost before pruning is nan; expected a finite"):
        prune(lambda w: jnp.nan * w[0], np.array([1.0, 2.0]))


def test_links_that_do_not_match() -> None:
    with pytest.raises(ValueError, match="links have 1 sources and 2 targets"):
        LinkEnds(np.array([0]), np.array([1, 1]))

"""Normal equations: what all patterns say of a linear network, beside the patterns themselves."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc import CSLC
from jaxcslc.training import (
    LINEAR_COMBINER,
    PERAL,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Layer,
    Links,
    Plan,
    Signals,
    Subnetwork,
    _examples as module,
    examples,
    fully_connected,
    half_rms,
    half_square,
    inverse_dynamics,
    normal_equations,
    train,
    with_normal_equations,
)


RULE = Backpropagation()
#: Sums over patterns in another order.
ROUNDING: Any = {"rtol": 1e-11, "atol": 1e-12}


def sharing() -> AdaptiveNetwork:
    """Two subnetworks of three weights in all, shared within and between, by known multiples."""

    def signals(patterns: Any) -> Signals:
        x = jnp.asarray(patterns).T
        return Signals((x[:2], x[2:]), ((), ()))

    first = Links(2, 2, [0, 1, 1], [0, 0, 1], [0, 1, 0], [1.0, -2.0, 0.5])
    second = Links(2, 2, [0, 1, 1], [0, 1, 1], [1, 2, 0], [3.0, 1.0, -1.0])
    parts = (Subnetwork("a", (Layer(first),)), Subnetwork("b", (Layer(second),)))
    return AdaptiveNetwork(parts, signals, LINEAR_COMBINER, ("w0", "w1", "w2"))


def patterns(rng: np.random.Generator, network: AdaptiveNetwork, samples: int) -> Examples:
    """With masks, a pattern without any output that counts among them."""
    x, t = rng.normal(size=(samples, 4)), rng.normal(size=(samples, 2))
    counts = rng.uniform(size=t.shape) < 0.7
    counts[1] = False
    return examples(network, x, t, counts)


def assert_says_the_same(network: AdaptiveNetwork, training_set: Examples, w: Any) -> None:
    made = normal_equations(network, training_set)
    (cost,) = training_set.costs(network, w, half_square)
    assert_allclose(made.cost(w), cost, **ROUNDING)
    learns = len(network.groups)
    for learning in {(True,) * learns, (True,) + (False,) * (learns - 1)}:
        change = training_set.change(network, RULE, w, learning)
        assert_allclose(made.change(network, w, learning), change, **ROUNDING)


def test_cost_and_change_are_the_patterns(rng: np.random.Generator) -> None:
    for network in (sharing(), fully_connected([4, 2], "linear combiner")):
        training_set = patterns(rng, network, 40)
        w = jnp.asarray(rng.normal(size=network.size))
        assert_says_the_same(network, training_set, w)


def test_trials_cost_what_the_patterns_say(rng: np.random.Generator) -> None:
    network = sharing()
    training_set = patterns(rng, network, 40)
    made, w = with_normal_equations(network, training_set), jnp.asarray(rng.normal(size=3))
    change = training_set.change(network, RULE, w, (True, True))
    trials = jnp.asarray(rng.uniform(0, 1, (5, 2)))
    expected = training_set.trial_costs(network, w, change, trials, half_square)
    assert_allclose(made.trial_costs(network, w, change, trials, half_square), expected, **ROUNDING)


@pytest.mark.parametrize("samples", [21, 22, 28])
def test_in_blocks(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, samples: int) -> None:
    """Three blocks of seven patterns, or four of which the last is filled up."""
    monkeypatch.setattr(module, "_BLOCK", 7)
    network = sharing()
    assert_says_the_same(network, patterns(rng, network, samples), jnp.asarray([0.3, -0.8, 0.5]))


def test_the_gram_matrix_is_the_regressor_s(rng: np.random.Generator) -> None:
    """Gradient and Hessian of the half square, by `jax`: the right side and the matrix."""
    network = sharing()
    training_set = patterns(rng, network, 40)
    made = normal_equations(network, training_set)

    def cost(w: jax.Array) -> jax.Array:
        return training_set.costs(network, w, half_square)[0]

    hessian, gradient = jax.jit(jax.hessian(cost)), jax.jit(jax.grad(cost))
    assert_allclose(made.gram, hessian(jnp.zeros(3)), **ROUNDING)
    assert_allclose(made.moment, -gradient(jnp.zeros(3)), **ROUNDING)
    assert_allclose(jnp.sum(made.layered_gram, axis=0), made.gram, **ROUNDING)
    assert_allclose(jnp.sum(made.layered_moment, axis=0), made.moment, **ROUNDING)


def test_trained_as_on_the_patterns(rng: np.random.Generator) -> None:
    """History and all, one layer frozen; the end is the least squares' solution."""
    network = sharing()
    training_set, start = patterns(rng, network, 40), np.array([1.0, -1.0, 0.5])
    made = with_normal_equations(network, training_set)
    for frozen in ((), ("b",)):
        plan = Plan(RULE, AdaptedRates(0.05), cost=half_square, frozen=frozen)
        one, other = (
            train(network, x, start, plan, epochs=30, chunk=30) for x in (made, training_set)
        )
        assert_allclose(one.history.cost, other.history.cost, rtol=1e-9)
        assert_allclose(one.history.rates, other.history.rates, rtol=1e-9)
        assert_allclose(one.weights, other.weights, rtol=1e-7, atol=1e-9)


def test_the_minimum_is_the_direct_solve_s(puma: CSLC, rng: np.random.Generator) -> None:
    """The PUMA 560, sixty samples, noise, a fifth masked."""
    q, qd, qdd = rng.uniform(-2, 2, (3, 60, 6))
    k = jnp.asarray(rng.normal(size=puma.size))
    torque = np.asarray(puma.torque(k, q, qd, qdd)) + rng.normal(size=(60, 6))
    counts = rng.uniform(size=(60, 6)) < 0.8
    network = inverse_dynamics(puma)
    training_set = examples(network, (q, qd, qdd), torque, counts)
    made = normal_equations(network, training_set)
    everything = np.ones(counts.shape, bool)
    recording = jc.Patterns(np.arange(60.0), q, qd, qdd, torque, counts, everything)
    solved = jc.LeastSquares(joint_weights="equal", errors="independent").fit(puma, recording).k
    minimum = jnp.linalg.solve(made.gram, made.moment)
    # The Gram matrix squares the condition number.
    assert_allclose(minimum, solved, rtol=1e-6, atol=1e-8)
    move = made.change(network, solved, (True,) * 5)
    first = made.change(network, jnp.zeros(puma.size), (True,) * 5)
    total, start = np.abs(np.sum(move, axis=0)), np.abs(np.sum(first, axis=0))
    assert np.max(total) < 1e-10 * np.max(start)  # no layer's move but the others undo it
    assert_allclose(made.cost(solved), training_set.costs(network, solved, half_square)[0])


def test_vmap_over_recordings(rng: np.random.Generator) -> None:
    network = sharing()
    one_set = [patterns(rng, network, 40) for _ in range(3)]
    recordings: Examples = jax.tree.map(lambda *parts: jnp.stack(parts), *one_set)
    made = jax.jit(jax.vmap(lambda training_set: normal_equations(network, training_set)))(
        recordings
    )
    assert made.gram.shape == (3, 3, 3)
    for at, training_set in enumerate(one_set):
        single = normal_equations(network, training_set)
        for name in ("gram", "moment", "square", "layered_gram", "layered_moment"):
            assert_allclose(getattr(made, name)[at], getattr(single, name), **ROUNDING)


def test_other_rules_and_costs_are_by_the_patterns(rng: np.random.Generator) -> None:
    """PERAL, a cost that is no half square, patterns one at a time: nothing else with equations."""
    network = fully_connected([4, 2], "linear combiner")
    training_set = patterns(rng, network, 40)
    made = with_normal_equations(network, training_set)
    for plan in (
        Plan(PERAL(), FixedRates(0.1), cost=half_square),
        Plan(RULE, FixedRates(0.01), cost=half_square, order="sequential"),
        Plan(RULE, FixedRates(0.1), cost=half_rms),
    ):
        one, other = (
            train(network, x, np.ones(10), plan, epochs=5, chunk=5) for x in (made, training_set)
        )
        assert_allclose(one.history.cost, other.history.cost, rtol=1e-9)
        assert_allclose(one.weights, other.weights, rtol=1e-9)


@pytest.mark.parametrize("sizes", [[4, 2], [4, 3, 2]])
def test_networks_that_are_not_linear_are_refused(
    rng: np.random.Generator, sizes: list[int]
) -> None:
    """Two layers of linear combiners are not linear in their weights either."""
    kind = "logistic" if len(sizes) == 2 else "linear combiner"
    network = fully_connected(sizes, kind)
    training_set = examples(network, rng.normal(size=(9, 4)), rng.uniform(0, 1, (9, 2)))
    with pytest.raises(ValueError, match=r"^normal equations need outputs that are linear"):
        normal_equations(network, training_set)

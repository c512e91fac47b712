"""The perceptron rule: its equation, its convergence, and what preprocessing makes possible."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.training import (
    HARD_LIMITER,
    OUTCOMES,
    AdaptiveNetwork,
    ContextLayer,
    FixedRates,
    Layer,
    Links,
    PerceptronRule,
    Plan,
    PolynomialTerms,
    Preprocessed,
    Subnetwork,
    decreasing,
    examples,
    fully_connected,
    mean_modulus,
    train,
)
from tests.training import _transcription as thesis


XOR = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
XOR_TARGETS = np.array([[0.0], [1.0], [1.0], [0.0]])


def plan(rate: float = 1.0) -> Plan:
    """Sequential, until every pattern is classified correctly."""
    return Plan(
        PerceptronRule(),
        FixedRates(rate),
        order="sequential",
        cost=mean_modulus,
        patience=100_000,
        divergence=1e6,
    )


@pytest.mark.parametrize("nodes", [1, 3])
def test_equation(nodes: int, rng: np.random.Generator) -> None:
    """Eqn. 3.4-1, batch: the mean over patterns."""
    network = fully_connected([4, nodes], "hard limiter")
    W, x = rng.normal(size=(5, nodes)), rng.normal(size=(20, 4))
    t = rng.integers(2, size=(20, nodes)).astype(float)
    seen = np.column_stack([x, np.ones(20)])
    expected = np.mean([thesis.eqn_3_4_1(seen[p], t[p], W) for p in range(20)], axis=0)
    training_set = examples(network, x, t)
    result = PerceptronRule().change(
        network,
        jnp.asarray(W.T.ravel()),
        training_set.signals,
        training_set.targets,
        training_set.counts,
        (True,),
    )
    assert_allclose(result[0].reshape(nodes, 5).T / 20, expected, rtol=1e-12, atol=1e-15)


def test_what_is_told_right_moves_nothing(rng: np.random.Generator) -> None:
    network = fully_connected([4, 2], "hard limiter")
    k, x = jnp.asarray(rng.normal(size=10)), rng.normal(size=(20, 4))
    training_set = examples(network, x, network.outputs(k, x))
    result = PerceptronRule().change(
        network, k, training_set.signals, training_set.targets, training_set.counts, (True,)
    )
    assert not np.any(result)


def test_a_thousand_separable_problems_end(rng: np.random.Generator) -> None:
    """Rosenblatt's theorem (3.4.1), from any weights, and within Novikoff's bound.

    A step adds at least the margin along the separating direction, and at most the square of the
    largest input to the squared length of the weights. From weights of length a, that leaves
    (R² + 2 a m) / m² steps; an epoch that is not the last has one at least.
    """
    trainings, patterns, inputs = 1000, 20, 3
    direction = rng.normal(size=(trainings, inputs + 1))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    x = rng.normal(size=(trainings, patterns, inputs))
    seen = np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=2)
    distance = np.einsum("tpi,ti->tp", seen, direction)

    network = fully_connected([inputs, 1], "hard limiter")
    t = (distance >= 0).astype(float)[..., None]
    training_set = jax.vmap(lambda x, t: examples(network, x, t))(jnp.asarray(x), jnp.asarray(t))
    start = rng.normal(size=(trainings, network.size))
    training = train(network, training_set, start, plan(), epochs=20_000, keep_weights=False)
    assert bool(jnp.all(training.outcome == OUTCOMES.reached))
    answers = jax.vmap(network.outputs)(training.weights, jnp.asarray(x))
    assert bool(jnp.all(answers == t))

    margin = np.abs(distance).min(axis=1)
    largest = np.linalg.norm(seen, axis=2).max(axis=1)
    steps = (largest**2 + 2 * np.linalg.norm(start, axis=1) * margin) / margin**2
    assert np.all(np.asarray(training.epochs) - 1 <= steps)


def test_the_exclusive_or_by_a_single_node() -> None:
    """Fig. 3.3-3: with x1², x1 x2 and x2² among its inputs."""
    network = fully_connected([2, 1], "hard limiter", preprocess=PolynomialTerms(2))
    assert network.size == 6  # five inputs and a bias
    training_set = examples(network, XOR, XOR_TARGETS)
    training = train(network, training_set, jnp.zeros(6), plan(), epochs=500)
    assert bool(training.outcome == OUTCOMES.reached)
    assert network.outputs(training.weights, XOR).tolist() == XOR_TARGETS.tolist()


def test_the_exclusive_or_without_preprocessing_fails(rng: np.random.Generator) -> None:
    """Minsky and Papert's: from no start does it end, and one pattern at least stays wrong."""
    network = fully_connected([2, 1], "hard limiter")
    starts = rng.normal(size=(20, 3))
    training = train(network, examples(network, XOR, XOR_TARGETS), starts, plan(), epochs=500)
    assert bool(jnp.all(training.outcome == OUTCOMES.running))
    assert float(np.min(training.history.cost)) >= 0.25


def test_what_it_refuses() -> None:
    rule = PerceptronRule()
    one = "the perceptron rule trains one layer only: hidden nodes have no target (3.4.1)"
    assert rule.check_network(fully_connected([2, 2, 1], "hard limiter")) == one
    context = ContextLayer(2, 1, 1, (0, 1), (0, 0), (0, 0))
    part = Subnetwork("a", (Layer(Links.full(2, 2)),), (context,))
    behind = AdaptiveNetwork((part,), Preprocessed(2), HARD_LIMITER, tuple("abcd"))
    assert rule.check_network(behind) == one
    said = "the perceptron rule trains hard limiters, not a"
    assert rule.check_network(fully_connected([2, 1], "logistic")) == f"{said} logistic"
    falling = fully_connected([2, 1], decreasing(HARD_LIMITER))
    assert rule.check_network(falling) == f"{said} decreasing hard limiter"
    assert rule.check_network(fully_connected([2, 1], "hard limiter")) is None
    with pytest.raises(ValueError, match=f"{said} logistic"):
        network = fully_connected([2, 1], "logistic")
        train(network, examples(network, XOR, XOR_TARGETS), jnp.zeros(3), plan())

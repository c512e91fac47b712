"""Ideal PERAL (thesis 6.1): its equation, where it leads to the optimum, and where it does not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.training import (
    LINEAR_COMBINER,
    OUTCOMES,
    AdaptiveNetwork,
    ContextLayer,
    FixedRates,
    IdealPERAL,
    Layer,
    Links,
    Plan,
    Preprocessed,
    Subnetwork,
    check_sign_rank,
    examples,
    fully_connected,
    mean_modulus,
    train,
)
from tests.training import _transcription as thesis


def contraction(x: np.ndarray, optimum: np.ndarray) -> np.ndarray:
    """The matrix A by which a batch step at rate r takes (w* - w) / |w*| to (1 - r A) of it.

    Patterns' signs s and shares u (the moduli |x_m w*_m| over their sum, with the signs of x):
    A is the mean of s u', each of which is a projection, since u's = 1.
    """
    shares = np.abs(x * optimum)
    signed = np.sign(x) * shares / shares.sum(axis=1, keepdims=True)
    return np.sign(x).T @ signed / len(x)


def step(x: np.ndarray, optimum: np.ndarray, w: np.ndarray) -> np.ndarray:
    """What the library moves one node's weights by, in batch form."""
    network = fully_connected([x.shape[1], 1], "linear combiner", bias=False)
    training_set = examples(network, x, (x @ optimum)[:, None])
    rule = IdealPERAL(jnp.asarray(optimum))
    result = rule.change(
        network,
        jnp.asarray(w),
        training_set.signals,
        training_set.targets,
        training_set.counts,
        (True,),
    )
    return np.asarray(result[0]) / len(x)


def test_equation(rng: np.random.Generator) -> None:
    x, optimum, w = rng.normal(size=(8, 4)), rng.normal(size=4), rng.normal(size=4)
    x[2, 1] = 0.0
    rows = [thesis.eqn_6_1_3(row, optimum, w, row @ optimum) for row in x]
    assert_allclose(step(x, optimum, w), np.mean(rows, axis=0), rtol=1e-11, atol=1e-14)


def test_equation_with_shared_weights_and_several_nodes(rng: np.random.Generator) -> None:
    source, node, weight = [0, 1, 2, 0, 1, 1], [0, 0, 0, 1, 1, 1], [0, 1, 0, 2, 1, 0]
    links = Links(3, 2, source, node, weight, [1.0, -2.0, 0.5, 1.0, 1.0, -1.0])
    part = Subnetwork("a", (Layer(links),))
    network = AdaptiveNetwork((part,), Preprocessed(3), LINEAR_COMBINER, tuple("abc"))
    x, t = rng.normal(size=(6, 3)), rng.normal(size=(6, 2))
    optimum, w = rng.normal(size=3), rng.normal(size=3)
    rows = zip(links.source, links.node, links.weight, links.multiple, strict=True)
    literal = thesis.Subnetwork(
        [(2, [thesis.Link(int(s), int(n), int(k), m) for s, n, k, m in rows], thesis.IDENTITY)]
    )
    moves = [
        thesis.peral([literal], thesis.IDENTITY, [x[p]], [[]], t[p], w, optimum=optimum)
        for p in range(6)
    ]
    expected = thesis.average_over_links(
        [literal], thesis.mean_over_patterns(moves), 3, by_chain_rule=False
    )
    training_set = examples(network, x, t)
    result = IdealPERAL(jnp.asarray(optimum)).change(
        network,
        jnp.asarray(w),
        training_set.signals,
        training_set.targets,
        training_set.counts,
        (True,),
    )
    assert_allclose(result / 6, expected, rtol=1e-11, atol=1e-14)


def test_a_pattern_alone_is_met_at_once(rng: np.random.Generator) -> None:
    """6.1: an adjustment that causes a zero error in response to that pattern."""
    x, optimum, w = rng.normal(size=(1, 5)), rng.normal(size=5), rng.normal(size=5)
    assert_allclose(x @ (w + step(x, optimum, w)), x @ optimum, rtol=1e-12, atol=1e-14)


def test_one_input_is_optimal_after_a_step(rng: np.random.Generator) -> None:
    """6.1's trivial case: with n = 1 all patterns ask for the same."""
    x, optimum, w = rng.normal(size=(6, 1)), rng.normal(size=1), rng.normal(size=1)
    assert_allclose(w + step(x, optimum, w), optimum, rtol=1e-12)


def test_a_step_is_linear_in_what_is_missing(rng: np.random.Generator) -> None:
    x, optimum, w = rng.normal(size=(9, 4)), rng.normal(size=4), rng.normal(size=4)
    missing = (optimum - w) / np.abs(optimum)
    expected = np.abs(optimum) * (contraction(x, optimum) @ missing)
    assert_allclose(step(x, optimum, w), expected, rtol=1e-11, atol=1e-14)


def test_it_reaches_the_optimum_from_any_start(rng: np.random.Generator) -> None:
    """Noise-free patterns, ten a weight, of full sign rank; 16 sets of them with a start each."""
    n, sets = 4, 16
    optimum = rng.normal(size=n)
    network = fully_connected([n, 1], "linear combiner", bias=False)
    x = rng.normal(size=(sets, 10 * n, n))
    for rows in x:
        check_sign_rank(rows)
    training_set = jax.vmap(lambda x: examples(network, x, (x @ optimum)[:, None]))(jnp.asarray(x))
    plan = Plan(IdealPERAL(jnp.asarray(optimum)), FixedRates(1.0), cost=mean_modulus, target=1e-9)
    start = 10 * rng.normal(size=(sets, n))
    training = train(network, training_set, start, plan, epochs=2000, keep_weights=False)
    assert bool(jnp.all(training.outcome == OUTCOMES.reached))
    assert_allclose(training.weights, np.broadcast_to(optimum, (sets, n)), rtol=0, atol=1e-7)


def test_two_weights_always_converge(rng: np.random.Generator) -> None:
    """For n = 2 the claim of 6.1 holds: A has trace 1 and, with full sign rank, a determinant in
    (0, 1/2], so that both eigenvalues of 1 - A are inside the unit circle."""
    for _ in range(500):
        x, optimum = rng.normal(size=(rng.integers(2, 8), 2)), rng.normal(size=2)
        if np.linalg.matrix_rank(np.sign(x)) < 2:
            continue
        A = contraction(x, optimum)
        assert_allclose(np.trace(A), 1.0, rtol=1e-12)
        assert 0 < np.linalg.det(A) <= 0.5 + 1e-12
        assert np.abs(1 - np.linalg.eigvals(A)).max() < 1


def test_three_weights_may_diverge_with_full_sign_rank() -> None:
    """The claim of 6.1 does not hold for n > 2: signs and inputs have full rank here, yet the step
    leads away from the optimum, at any rate.

    With as many patterns as weights, det A is det(signs) det(shares) over n to the n; the second
    may have the sign that the first has not, and then one eigenvalue of A is negative.
    """
    x = np.array([[3.0, 1.0, 1.0], [1.0, 3.0, -1.0], [1.0, -1.0, 3.0]])
    optimum = np.ones(3)
    check_sign_rank(x)
    assert np.linalg.matrix_rank(x) == 3
    eigenvalues, vectors = np.linalg.eig(contraction(x, optimum))
    worst = int(np.argmin(np.real(eigenvalues)))
    assert np.imag(eigenvalues[worst]) == 0.0
    negative, away = float(np.real(eigenvalues[worst])), np.real(vectors[:, worst])
    assert negative < -0.05
    for rate in (1.0, 0.01):
        w = optimum + 1e-3 * away
        for _ in range(10):
            w = w + rate * step(x, optimum, w)
        grown = (1 - rate * negative) ** 10
        assert_allclose(w - optimum, 1e-3 * grown * away, rtol=1e-6)
        assert np.linalg.norm(w - optimum) > np.linalg.norm(1e-3 * away)


def test_many_patterns_make_it_converge(rng: np.random.Generator) -> None:
    """Of inputs with independent signs, the mean of projections tends to a positive diagonal."""
    n = 6
    diverging = {few: 0 for few in (1, 20)}
    for few in diverging:
        for _ in range(50):
            x, optimum = rng.normal(size=(few * n, n)), rng.normal(size=n)
            largest = np.abs(1 - np.linalg.eigvals(contraction(x, optimum))).max()
            diverging[few] += bool(largest >= 1)
    assert diverging[1] > 0 and diverging[20] == 0


def test_without_rank_something_is_never_told(rng: np.random.Generator) -> None:
    """6.1: patterns whose signs depend on each other leave a direction that no step changes."""
    x = rng.uniform(0.5, 2.0, size=(30, 3)) * np.array([1.0, -1.0, 1.0])
    optimum = rng.normal(size=3)
    with pytest.raises(ValueError, match="input signs have rank 1, expected 3"):
        check_sign_rank(x)
    w = rng.normal(size=3)
    kept = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, -1.0]]) / np.abs(optimum)  # orthogonal to signs
    moved = w + step(x, optimum, w)
    assert_allclose(kept @ moved, kept @ w, rtol=1e-12)
    assert np.linalg.norm(moved - w) > 1e-3


def test_a_weight_that_is_zero_at_the_optimum_never_moves(rng: np.random.Generator) -> None:
    """The exception of 6.1, a product of weights that is zero, is of the optimum's weights."""
    x, optimum = rng.normal(size=(20, 3)), np.array([1.0, 0.0, -2.0])
    moved = step(x, optimum, np.array([0.0, 3.0, 0.0]))
    assert moved[1] == 0.0 and np.all(moved[[0, 2]] != 0.0)


def test_rank_refusals_name_what_is_left_together(rng: np.random.Generator) -> None:
    x = rng.normal(size=(50, 4))
    check_sign_rank(x)
    x[:, 3] = -2 * x[:, 1]
    with pytest.raises(ValueError) as failure:
        check_sign_rank(x)
    assert str(failure.value) == (
        "input signs have rank 3, expected 4, one a weight: over all patterns, the signs of"
        " inputs 2, 4 are not independent (thesis 6.1); record patterns that differ in them"
    )
    x[:, 3] = 0.0  # an input that is never there
    with pytest.raises(ValueError, match=r"the signs of inputs 4 are not"):
        check_sign_rank(x)
    with pytest.raises(ValueError, match="input signs have rank 3, expected 4"):
        check_sign_rank(rng.normal(size=(3, 4)))
    with pytest.raises(ValueError, match="input signs have rank 0, expected 4"):
        check_sign_rank(np.zeros((0, 4)))


def test_networks_refused() -> None:
    rule = IdealPERAL(jnp.ones(2))
    context = ContextLayer(2, 1, 1, (0, 1), (0, 0), (0, 0))
    part = Subnetwork("a", (Layer(Links(1, 2, [0, 0], [0, 1], [0, 1])),), (context,))
    behind = AdaptiveNetwork((part,), Preprocessed(1), LINEAR_COMBINER, tuple("ab"))
    assert rule.check_network(behind) == (
        "ideal PERAL is stated for one layer without context-sensitive weights (6.1)"
    )
    assert rule.check_network(fully_connected([1, 1, 1], "logistic")) is not None
    assert rule.check_network(fully_connected([2, 1], "logistic")) == (
        "ideal PERAL needs the optimum of all 3 weights, got shape (2,)"
    )
    assert rule.check_network(fully_connected([1, 1], "logistic")) is None


def test_starts_refused() -> None:
    network = fully_connected([2, 1], "linear combiner", bias=False)
    rule = IdealPERAL(jnp.asarray([1.0, 0.0]))
    assert rule.check_start(network, np.array([5.0, 0.0]), (True,)) is None
    assert rule.check_start(network, np.array([5.0, 1.0]), (True,)) == (
        "ideal PERAL cannot move layer 1, node 1, input 2: it is zero at the optimum, so that no"
        " error is allocated to it (6.1); start it at zero"
    )

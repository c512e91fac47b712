"""Backpropagation and PERAL: each equation against the literal transcription, to rounding."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import (
    HYPERBOLIC_TANGENT,
    LINEAR_COMBINER,
    LOGISTIC,
    PERAL,
    Activation,
    Backpropagation,
    ContextLayer,
    Layer,
    Links,
    PerceptronRule,
    Subnetwork,
    decreasing,
    examples,
    fully_connected,
)
from jaxcslc.training._examples import Examples
from jaxcslc.training._rules import AbstractRule, links_per_weight
from tests.training import _transcription as thesis
from tests.training._problems import (
    FUNCTIONS,
    Problem,
    change,
    five_subnetworks,
    one_context_layer,
    one_sparse_layer,
    problem,
    summed,
    two_adaptive_and_a_context,
)


by_name: Any = {"ids": lambda activation: activation.name}


def matrix(change: np.ndarray, inputs: int, nodes: int) -> np.ndarray:
    """The thesis's matrix, inputs by outputs, of a fully connected layer's change."""
    return change.reshape(nodes, inputs).T


# One fully connected layer: the equations as they are printed.


@pytest.mark.parametrize("f", list(FUNCTIONS), **by_name)
def test_one_layer(f: Activation, rng: np.random.Generator) -> None:
    network = fully_connected([4, 3], f, bias=False)
    W, x = rng.normal(size=(4, 3)), rng.normal(size=(6, 4))
    t = rng.uniform(max(f.low, -1.0), 1.0, size=(6, 3))
    S, literal = x @ W, FUNCTIONS[f]
    training_set = examples(network, x, t)
    expected = np.mean([thesis.eqn_3_4_3(x[p], S[p], t[p], literal) for p in range(6)], axis=0)
    result = change(Backpropagation(), network, W.T.ravel(), training_set)
    assert_allclose(matrix(result[0], 4, 3), expected, rtol=1e-11, atol=1e-14)

    per_pattern: list[np.ndarray] = []
    for p in range(6):
        dS = [thesis.eqn_6_2_1(t[p, l], literal.f(S[p, l]), literal) for l in range(3)]
        per_pattern.append(thesis.eqn_6_2_6(x[p], W, dS))
        assert_allclose(per_pattern[-1], thesis.eqn_6_2_7(x[p], W, np.array(dS)), rtol=1e-13)
    result = change(PERAL(), network, W.T.ravel(), training_set)
    assert_allclose(matrix(result[0], 4, 3), np.mean(per_pattern, axis=0), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("f_A", list(FUNCTIONS), **by_name)
@pytest.mark.parametrize("f_B", [LINEAR_COMBINER, LOGISTIC, HYPERBOLIC_TANGENT], **by_name)
def test_two_adaptive_layers(f_A: Activation, f_B: Activation, rng: np.random.Generator) -> None:
    """Eqns. 3.4-3 and 3.4-8, a bias before each layer."""
    network = fully_connected([3, 4, 2], [f_A, f_B])
    A, B = FUNCTIONS[f_A], FUNCTIONS[f_B]
    W_A, W_B, x = rng.normal(size=(4, 4)), rng.normal(size=(5, 2)), rng.normal(size=(5, 3))
    t = rng.uniform(max(f_B.low, -1.0), 1.0, size=(5, 2))
    dA, dB = np.zeros((4, 4)), np.zeros((5, 2))
    for p in range(5):
        seen = [*x[p], 1.0]
        S_A = [thesis.eqn_3_3_1(seen, W_A[:, k]) for k in range(4)]
        hidden = [*(A.f(s) for s in S_A), 1.0]
        S_B = [thesis.eqn_3_3_1(hidden, W_B[:, l]) for l in range(2)]
        dB += thesis.eqn_3_4_3(hidden, S_B, t[p], B) / 5
        dA += thesis.eqn_3_4_8(seen, S_A, S_B, W_B[:4], t[p], A, B) / 5
    k = np.concatenate([W_A.T.ravel(), W_B.T.ravel()])
    result = change(Backpropagation(), network, k, examples(network, x, t))
    close: Any = {"rtol": 1e-11, "atol": 1e-14}
    assert_allclose(matrix(result[0, :16], 4, 4), dA, **close)
    assert_allclose(matrix(result[1, 16:], 5, 2), dB, **close)
    # Every layer moves its own weights only: a rate for each.
    assert not np.any(result[0, 16:]) and not np.any(result[1, :16])


PROBLEMS: dict[str, Callable[[np.random.Generator], Problem]] = {
    "sparse, linear": lambda rng: one_sparse_layer(rng, LINEAR_COMBINER),
    "sparse, tanh": lambda rng: one_sparse_layer(rng, HYPERBOLIC_TANGENT),
    "sparse, falling": lambda rng: one_sparse_layer(rng, decreasing(HYPERBOLIC_TANGENT)),
    "context": lambda rng: one_context_layer(rng, LINEAR_COMBINER, LINEAR_COMBINER),
    "context, tanh inside": lambda rng: one_context_layer(rng, HYPERBOLIC_TANGENT, LOGISTIC),
    "context, falling inside": lambda rng: one_context_layer(
        rng, decreasing(LOGISTIC), decreasing(HYPERBOLIC_TANGENT)
    ),
    "five subnetworks": lambda rng: five_subnetworks(rng, LINEAR_COMBINER),
    "five subnetworks, tanh": lambda rng: five_subnetworks(rng, HYPERBOLIC_TANGENT),
}
DEEP: dict[str, Callable[[np.random.Generator], Problem]] = {
    "two adaptive layers and a context layer": lambda rng: two_adaptive_and_a_context(
        rng, HYPERBOLIC_TANGENT
    ),
    **PROBLEMS,
}
close: Any = {"rtol": 1e-11, "atol": 1e-13}


@pytest.mark.parametrize("name", list(DEEP))
def test_backpropagation_literally(name: str, rng: np.random.Generator) -> None:
    """Eqn. 3.4-9, means over patterns (3.4), averages over links (5.2.6)."""
    case = DEEP[name](rng)
    result = change(Backpropagation(), case.network, case.k, case.training_set())
    assert_allclose(result, case.literally(thesis.backpropagation), **close)


@pytest.mark.parametrize("name", list(DEEP))
def test_backpropagation_is_the_gradient_over_the_number_of_links(
    name: str, rng: np.random.Generator
) -> None:
    """Eqn. 3.4-2 through `jax.grad`, which knows nothing of layers."""
    case = DEEP[name](rng)
    training_set = case.training_set()

    @jax.jit
    def gradient(k: jax.Array) -> jax.Array:
        def cost(k: jax.Array) -> jax.Array:
            errors = training_set.targets - case.network.activation.value(
                case.network.forward(k, training_set.signals).total
            )
            return 0.5 * jnp.sum(errors**2) / len(case.t)

        return jax.grad(cost)(k)

    links = [layer.links for _, layer in case.network.adaptive_layers]
    shared = links_per_weight(links, len(case.k), (True,) * len(links))
    result = change(Backpropagation(), case.network, case.k, training_set).sum(axis=0)
    assert_allclose(result, -np.asarray(gradient(jnp.asarray(case.k))) / shared, **close)


@pytest.mark.parametrize("name", list(PROBLEMS))
def test_peral_literally(name: str, rng: np.random.Generator) -> None:
    case = PROBLEMS[name](rng)
    result = change(PERAL(), case.network, case.k, case.training_set())
    assert np.any(result != 0, axis=1).all()
    assert_allclose(result, case.literally(thesis.peral), **close)


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: rule.name)
def test_masks(rule: AbstractRule, rng: np.random.Generator) -> None:
    """Masked pairs move nothing, and patterns without any pair do not count (7.5)."""
    case = five_subnetworks(rng, LINEAR_COMBINER)
    counts = (rng.uniform(size=case.t.shape) < 0.6).astype(float)
    counts[2] = 0.0
    literal = thesis.peral if isinstance(rule, PERAL) else thesis.backpropagation
    result = change(rule, case.network, case.k, case.training_set(counts))
    assert_allclose(result, case.literally(literal, counts=counts), **close)
    # What a masked target says does not matter.
    case.t[counts == 0] = 1e3
    again = change(rule, case.network, case.k, case.training_set(counts))
    assert_array_equal(result, again)


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: rule.name)
def test_layers_that_do_not_learn_leave_the_average(
    rule: AbstractRule, rng: np.random.Generator
) -> None:
    """5.2.6: the velocity subnetwork left out, averages are over the mass subnetwork's links."""
    case = five_subnetworks(rng, LINEAR_COMBINER)
    learning = (True, False, True, True, False)
    literal = thesis.peral if isinstance(rule, PERAL) else thesis.backpropagation
    result = change(rule, case.network, case.k, case.training_set(), learning)
    assert_allclose(result, case.literally(literal, learning), **close)
    assert not result[1].any() and not result[4].any()
    assert np.any(
        np.abs(result[0] - change(rule, case.network, case.k, case.training_set())[0]) > 1e-6
    )


# Eqns. 6.2-2 to 6.2-4 as printed: fully connected, all contexts.


@pytest.mark.parametrize("f_A", list(FUNCTIONS), **by_name)
def test_peral_of_fig_6_2_1(f_A: Activation, rng: np.random.Generator) -> None:
    i, h, o = 4, 5, 3
    adaptive = Layer(Links.full(i, h), f_A)
    full = [(k, l, k * o + l) for k in range(h) for l in range(o)]
    source, node, context = zip(*full, strict=True)
    follows = ContextLayer(h, o, h * o, source, node, context)
    f_B = HYPERBOLIC_TANGENT
    case = problem(rng, [Subnetwork("a", (adaptive,), (follows,))], f_B, i * h)
    W_A, A, B = case.k.reshape(h, i).T, FUNCTIONS[f_A], FUNCTIONS[f_B]
    expected = np.zeros((i, h))
    for p in range(7):
        x, W_B = case.xs[0][p], case.contexts[0][0][p].reshape(h, o)
        hidden = np.array([A.f(s) for s in x @ W_A])
        dS_B = [thesis.eqn_6_2_1(case.t[p, l], B.f(hidden @ W_B[:, l]), B) for l in range(o)]
        wanted = thesis.eqn_6_2_3(hidden, W_B, dS_B)
        if np.abs(W_B).any(axis=0).all():
            assert_allclose(thesis.eqn_6_2_4(hidden, W_B, np.array(dS_B)), wanted, **close)
        dS_A = [thesis.eqn_6_2_5(per_pattern, A) for per_pattern in wanted]
        expected += thesis.eqn_6_2_6(x, W_A, dS_A) / 7
    result = change(PERAL(), case.network, case.k, case.training_set())
    assert_allclose(matrix(result[0], i, h), expected, **close)


# Batch and sequential.


@pytest.mark.parametrize(
    "rule", [Backpropagation(), PERAL(), PerceptronRule()], ids=lambda r: r.name
)
def test_batch_is_the_mean_of_the_sequential_steps_from_one_state(
    rule: AbstractRule, rng: np.random.Generator
) -> None:
    if isinstance(rule, PerceptronRule):
        network = fully_connected([5, 3], "hard limiter")
        x, t = rng.normal(size=(9, 5)), rng.integers(2, size=(9, 3)).astype(float)
        training_set, k = examples(network, x, t), rng.normal(size=network.size)
    else:
        case = five_subnetworks(rng, HYPERBOLIC_TANGENT)
        network, training_set, k = case.network, case.training_set(), case.k
    patterns = training_set.targets.shape[1]
    learning = (True,) * len(network.groups)
    steps = [
        summed(rule, network, jnp.asarray(k), only, learning)
        for only in (
            jax.tree.map(lambda x, p=p: x[:, p : p + 1], training_set) for p in range(patterns)
        )
    ]
    assert_allclose(
        change(rule, network, k, training_set), np.mean(steps, axis=0), rtol=1e-12, atol=1e-14
    )


# Where PERAL divides by nothing.


def test_peral_without_anything_to_divide_among(rng: np.random.Generator) -> None:
    """Zero inputs, zero contexts, zero weights: no move, and no NaN."""
    case = five_subnetworks(rng, LINEAR_COMBINER)
    for x in case.xs:
        x[0] = 0.0
    for subnetwork_contexts in case.contexts:
        for context in subnetwork_contexts:
            context[1] = 0.0
    case.k[:6] = 0.0
    result = change(PERAL(), case.network, case.k, case.training_set())
    assert np.isfinite(result).all()
    assert_allclose(result, case.literally(thesis.peral), **close)
    assert not result[:, :6].any()  # a weight of zero stays
    nothing = case.training_set(np.zeros(case.t.shape))
    assert not change(PERAL(), case.network, case.k, nothing).any()
    assert not change(PERAL(), case.network, np.zeros(15), case.training_set()).any()


def test_peral_meets_a_single_pattern_at_once(rng: np.random.Generator) -> None:
    """One linear layer, a rate of one: the shares add up to the error (Eqn. 6.1-2)."""
    network = fully_connected([5, 3], "linear combiner")
    x, t, k = rng.normal(size=(1, 5)), rng.normal(size=(1, 3)), rng.normal(size=network.size)
    moved = k + change(PERAL(), network, k, examples(network, x, t)).sum(axis=0)
    assert_allclose(network.outputs(jnp.asarray(moved), x), t, rtol=1e-12, atol=1e-14)


def test_peral_keeps_signs_below_a_share_of_one(rng: np.random.Generator) -> None:
    """A change is in proportion to the modulus of the weight."""
    network = fully_connected([4, 1], "linear combiner", bias=False)
    x, k = rng.normal(size=(8, 4)), rng.normal(size=4)
    training_set = examples(network, x, rng.normal(size=(8, 1)))
    result = change(PERAL(), network, k, training_set)[0] / np.abs(k)
    scaled = change(PERAL(), network, 2 * k, examples(network, x / 2, training_set.targets.T))[0]
    assert_allclose(scaled / np.abs(2 * k), result, rtol=1e-12)


# Transforms.


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: rule.name)
def test_transforms(rule: AbstractRule, rng: np.random.Generator) -> None:
    case = five_subnetworks(rng, HYPERBOLIC_TANGENT)
    training_set, learning = case.training_set(), (True,) * 5
    k = jnp.asarray(rng.normal(size=(3, 15)))

    def one(k: jax.Array, training_set: Examples = training_set) -> jax.Array:
        return rule.change(
            case.network,
            k,
            training_set.signals,
            training_set.targets,
            training_set.counts,
            learning,
        )

    eager = jnp.stack([one(per_pattern) for per_pattern in k])
    close: Any = {"rtol": 1e-11, "atol": 1e-13}
    assert_allclose(jnp.stack([jax.jit(one)(per_pattern) for per_pattern in k]), eager, **close)
    assert_allclose(jax.jit(jax.vmap(one))(k), eager, **close)
    stacked = jax.tree.map(lambda x: jnp.stack([x, 0.5 * x, 0 * x]), training_set)
    mapped = jax.jit(jax.vmap(one))(k, stacked)
    assert_allclose(mapped[0], eager[0], **close)
    assert bool(jnp.all(jnp.isfinite(mapped)))


# What rules refuse.


def test_peral_refuses_what_it_cannot_train() -> None:
    two = fully_connected([2, 3, 1], "hyperbolic tangent")
    assert PERAL().check_network(two) == (
        "PERAL trains one adaptive layer only: it has no estimate of the error of a node that"
        " precedes another (6.2)"
    )
    hard = fully_connected([2, 1], "hard limiter")
    assert PERAL().check_network(hard) == (
        "PERAL needs continuous activations (6.2), and a hard limiter is not"
    )
    assert PERAL().check_network(fully_connected([2, 1], "logistic")) is None


def test_peral_refuses_to_start_from_nothing() -> None:
    network = fully_connected([2, 1], "linear combiner")
    said = "PERAL cannot start from weights that are all zero"
    one = PERAL().check_start(network, np.zeros(3), (True,))
    assert one is not None and one.startswith(f"{said}: a link's share of the error")
    many = PERAL().check_start(network, np.array([[1.0, 0, 0], [0, 0, 0]]), (True,))
    assert many is not None and many.startswith(f"{said} (training 2):")
    assert PERAL().check_start(network, np.array([0.0, 0.0, 1e-9]), (True,)) is None


def test_peral_refuses_to_start_where_what_learns_is_zero(rng: np.random.Generator) -> None:
    case = five_subnetworks(rng, LINEAR_COMBINER)
    k = np.zeros(15)
    k[12:] = 1.0  # dry friction only
    assert PERAL().check_start(case.network, k, (True,) * 5) is None
    frozen = PERAL().check_start(case.network, k, (True, True, True, True, False))
    assert frozen is not None and frozen.startswith("PERAL cannot start from weights that are all")


def test_backpropagation_refuses_a_hard_limiter() -> None:
    expected = (
        "backpropagation needs a slope, and a hard limiter has none; train it by the perceptron"
        " rule, or take a sigmoid"
    )
    for kinds in (["logistic", "hard limiter"], ["hard limiter", "logistic"]):
        assert Backpropagation().check_network(fully_connected([2, 2, 1], kinds)) == expected
    assert Backpropagation().check_network(fully_connected([2, 2, 1], "logistic")) is None

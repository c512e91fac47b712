"""Examples: what trains a network, what it costs, and what is refused."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc import CSLC
from jaxcslc.training import (
    LINEAR_COMBINER,
    AdaptiveNetwork,
    ContextLayer,
    Layer,
    Links,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_rms,
    half_square,
    inverse_dynamics,
    mean_modulus,
)
from jaxcslc.training._examples import covered
from jaxcslc.training._network import reaching_weights


def motion(rng: np.random.Generator, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd = rng.uniform(-2, 2, (3, samples, 6))
    return q, qd, qdd


def test_units_first_patterns_last(rng: np.random.Generator) -> None:
    network = fully_connected([3, 2], "linear combiner")
    x, t = rng.normal(size=(7, 3)), rng.normal(size=(7, 2))
    mask = rng.uniform(size=(7, 2)) < 0.5
    mask[0], mask[1] = True, False
    training_set = examples(network, x, t, mask)
    assert_array_equal(training_set.signals.inputs[0], x.T)
    assert_array_equal(training_set.counts, mask.T.astype(float))
    assert_array_equal(training_set.targets, np.where(mask, t, 0.0).T)
    assert float(training_set.patterns) == mask.any(axis=1).sum()
    k = jnp.asarray(rng.normal(size=network.size))
    errors = np.where(mask, t - network.outputs(k, x), 0.0).T
    assert_allclose(training_set.errors(network, k), errors, rtol=1e-13)


def test_condensed_totals_are_the_network_s(puma: CSLC, rng: np.random.Generator) -> None:
    """What an epoch knows a cost by: the regressor, rows that are always zero left out."""
    network = inverse_dynamics(puma)
    patterns = motion(rng, 5)
    training_set = examples(network, patterns, rng.normal(size=(5, 6)))
    assert training_set.condensed is not None
    k = jnp.asarray(rng.normal(size=puma.size))
    expected = puma.torque(k, *patterns).T
    assert_allclose(training_set.totals(network, k), expected, rtol=1e-10, atol=1e-10)
    assert reaching_weights(network) == puma.support
    regressor = np.asarray(puma.regressor(*patterns))
    for joint, (support, rows) in enumerate(
        zip(reaching_weights(network), training_set.condensed, strict=True)
    ):
        assert_allclose(rows, regressor[:, joint, list(support)].T, rtol=1e-10, atol=1e-12)


def test_not_condensed_where_nothing_is_gained() -> None:
    for network in (
        fully_connected([2, 1], "linear combiner"),
        fully_connected([2, 1], "logistic"),
    ):
        assert examples(network, np.ones((3, 2)), np.zeros((3, 1))).condensed is None


def test_reach_goes_through_layers() -> None:
    first = Links(2, 3, [0, 1, 1], [0, 1, 2], [0, 1, 2])
    second = Links(3, 2, [0, 1], [0, 1], [3, 4])
    part = Subnetwork("a", (Layer(first), Layer(second)))

    def signals(patterns: Any) -> Signals:
        return Signals((jnp.asarray(patterns).T,), ((),))

    network = AdaptiveNetwork((part,), signals, LINEAR_COMBINER, tuple("abcde"))
    assert reaching_weights(network) == ((0, 3), (1, 4))
    # Weight 2's node leads nowhere.
    x = network.signals(np.ones((4, 2)))
    assert covered(network, x, jnp.ones((2, 4))).tolist() == [True, True, False, True, True]
    assert covered(network, x, jnp.zeros((2, 4))).tolist() == [False] * 5
    with pytest.raises(ValueError, match="leave no data for c: of every pattern"):
        examples(network, np.ones((4, 2)), np.ones((4, 2)))


def test_moduli_do_not_cancel_where_data_determine_weights() -> None:
    """Two links of opposite sign that share a weight, and contexts of opposite sign."""
    part = Subnetwork(
        "a",
        (Layer(Links(2, 2, [0, 1], [0, 1], [0, 0], [1.0, -1.0])),),
        (ContextLayer(2, 1, 1, (0, 1), (0, 0), (0, 0)),),
    )

    def signals(patterns: Any) -> Signals:
        x, c = (jnp.asarray(column).T for column in patterns)
        return Signals((x,), ((c,),))

    network = AdaptiveNetwork((part,), signals, LINEAR_COMBINER, ("a",))
    x, c = np.array([[1.0, 2.0], [1.0, 2.0]]), np.array([[1.0], [-1.0]])
    assert float(examples(network, (x, c), np.zeros((2, 1))).patterns) == 2.0
    with pytest.raises(ValueError, match="leave no data for a"):
        examples(network, (x, 0 * c), np.zeros((2, 1)))


def test_masks_that_leave_a_coefficient_without_data(puma: CSLC, rng: np.random.Generator) -> None:
    network = inverse_dynamics(puma)
    patterns, t = motion(rng, 6), rng.normal(size=(6, 6))
    mask = np.ones((6, 6), bool)
    mask[:, 5] = False  # M66 and friction are joint 6's alone
    with pytest.raises(ValueError) as failure:
        examples(network, patterns, t, mask)
    assert str(failure.value) == (
        "masks leave no data for kM6, kv6, kd6: of every pattern that could tell, the output is"
        " masked or the input zero"
    )
    with pytest.raises(ValueError, match=r"for kM1, kM2, kM3, kM4, kM5 and 38 more: of every"):
        examples(network, patterns, t, np.zeros((6, 6), bool))
    mask[2, 5] = True
    assert float(examples(network, patterns, t, mask).patterns) == 6.0
    # A joint that never moves leaves its friction undetermined.
    patterns[1][:, 0] = 0.0
    with pytest.raises(ValueError, match="masks leave no data for kv1, kd1:"):
        examples(network, patterns, t)


@pytest.mark.parametrize(
    ("kind", "value", "said"),
    [
        ("hyperbolic tangent", 1.5, "is 1.5, but a hyperbolic tangent answers -1 to 1 only"),
        ("logistic", -1.0, "is -1, but a logistic answers 0 to 1 only"),
        ("hard limiter", 2.0, "is 2, but a hard limiter answers 0 to 1 only"),
        ("linear combiner", np.nan, "is nan, expected a finite number or a mask"),
        ("linear combiner", np.inf, "is inf, expected a finite number or a mask"),
    ],
)
def test_targets_out_of_reaching_weights(kind: str, value: float, said: str) -> None:
    network = fully_connected([2, 2], kind)
    x, t = np.ones((4, 2)), np.zeros((4, 2))
    t[2, 1] = value
    with pytest.raises(ValueError) as failure:
        examples(network, x, t)
    assert str(failure.value) == f"targets: output 2 of pattern 3 {said}"
    # Masked, it may be anything.
    mask = np.ones((4, 2), bool)
    mask[2, 1] = False
    training_set = examples(network, x, t, mask)
    assert bool(jnp.all(jnp.isfinite(training_set.targets)))
    assert bool(jnp.all(jnp.isfinite(training_set.errors(network, jnp.ones(6)))))


def test_targets_at_the_ends_of_the_range_are_wanted() -> None:
    """6.3.1's targets are -1 and 1, which a hyperbolic tangent never quite answers."""
    network = fully_connected([2, 2], "hyperbolic tangent")
    examples(network, np.ones((2, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]]))


@pytest.mark.parametrize(
    ("x", "t", "counts", "said"),
    [
        ((5, 2), (4, 1), None, "targets: expected shape (5, 1), one row a pattern and one column"),
        ((5, 2), (5, 2), None, "targets: expected shape (5, 1), one row a pattern and one column"),
        ((2,), (1, 1), None, "targets: expected shape (patterns, 1), one row a pattern"),
        ((5, 3), (5, 1), None, "inputs: expected shape (..., 2), got (5, 3)"),
        (
            (5, 2),
            (5, 1),
            (4, 1),
            "counts: expected shape (5, 1), or (1, 5, 1) for masks by subnetwork, got (4, 1)",
        ),
    ],
)
def test_wrong_shapes(x: Any, t: Any, counts: Any, said: str) -> None:
    network = fully_connected([2, 1], "linear combiner")
    plain = getattr(examples, "__wrapped__", examples)  # past the check of axes' names
    with pytest.raises(ValueError) as failure:
        plain(network, np.ones(x), np.ones(t), None if counts is None else np.ones(counts, bool))
    assert str(failure.value).startswith(said)


def test_inputs_that_are_no_numbers(puma: CSLC, rng: np.random.Generator) -> None:
    network = fully_connected([2, 1], "linear combiner")
    x = np.ones((3, 2))
    x[1, 0] = np.nan
    with pytest.raises(ValueError, match="inputs: subnetwork 'network' is given NaN or infinite"):
        examples(network, x, np.ones((3, 1)))


@pytest.mark.parametrize("which", [0, 1, 2])
def test_motion_that_is_no_number(puma: CSLC, rng: np.random.Generator, which: int) -> None:
    patterns = motion(rng, 3)
    patterns[which][1, 4] = np.inf
    with pytest.raises(ValueError, match="is given NaN or infinite numbers"):
        examples(inverse_dynamics(puma), patterns, np.ones((3, 6)))


def test_transforms(puma: CSLC, rng: np.random.Generator) -> None:
    network = inverse_dynamics(puma)
    q, qd, qdd = (jnp.asarray(x) for x in motion(rng, 8))
    t = jnp.asarray(rng.normal(size=(8, 6)))
    halves = jax.tree.map(lambda x: x.reshape(2, 4, 6), ((q, qd, qdd), t))
    k = jnp.asarray(rng.normal(size=43))
    whole = examples(network, (q, qd, qdd), t)

    def errors(patterns: Any, t: jax.Array) -> jax.Array:
        return examples(network, patterns, t).errors(network, k)

    close: Any = {"rtol": 1e-10, "atol": 1e-10}
    expected = whole.errors(network, k)
    assert_allclose(jax.jit(errors)((q, qd, qdd), t), expected, **close)
    column = jax.jit(jax.vmap(errors))(*halves)
    assert_allclose(jnp.concatenate(list(column), axis=1), expected, **close)


def test_costs_against_loops(rng: np.random.Generator) -> None:
    counts = (rng.uniform(size=(6, 9)) < 0.7).astype(float)
    counts[:, 4] = 0.0
    errors = rng.normal(size=(6, 9)) * counts
    moduli, halves, squares = [], [], []
    for p in range(9):
        counted = [errors[o, p] for o in range(6) if counts[o, p]]
        if counted:
            moduli += [abs(e) for e in counted]
            halves.append(0.5 * np.sqrt(np.mean(np.square(counted))))
            squares.append(0.5 * np.sum(np.square(counted)))
    arrays = jnp.asarray(errors), jnp.asarray(counts)
    assert_allclose(mean_modulus(*arrays), np.mean(moduli), rtol=1e-13)
    assert_allclose(half_rms(*arrays), np.mean(halves), rtol=1e-13)
    assert_allclose(half_square(*arrays), np.mean(squares), rtol=1e-13)
    nothing = jnp.zeros((6, 9))
    for cost in (mean_modulus, half_rms, half_square):
        assert float(cost(nothing, nothing)) == 0.0

"""One training: its history beside a literal loop, the order of patterns, ends, frozen layers."""

import io
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc import CSLC
from jaxcslc.training import (
    LINEAR_COMBINER,
    OUTCOMES,
    PERAL,
    AbstractRates,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Layer,
    Links,
    Plan,
    Schedule,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_rms,
    half_square,
    inverse_dynamics,
    mean_modulus,
    train,
    with_normal_equations,
)
from tests.training.conftest import Problem


def side_by_side(name: str, inputs: int, nodes: int, first: int) -> Subnetwork:
    return Subnetwork(name, (Layer(Links.full(inputs, nodes, first)),))


@pytest.fixture
def two_parts(rng: np.random.Generator) -> Problem:
    """Two linear combiners superposed, of two and three inputs, a rate for each; some masked."""

    def signals(patterns: Any) -> Signals:
        x = jnp.asarray(patterns).T
        return Signals((x[:2], x[2:]), ((), ()))

    parts = (side_by_side("a", 2, 2, 0), side_by_side("b", 3, 2, 4))
    network = AdaptiveNetwork(parts, signals, LINEAR_COMBINER, tuple("abcdefghij"))
    x = rng.normal(size=(30, 5)) * [1.0, 0.5, 2.0, 1.0, 0.3]
    t = network.outputs(jnp.asarray(rng.normal(size=10)), x) + 0.2 * rng.normal(size=(30, 2))
    counts = rng.uniform(size=(30, 2)) < 0.85
    return Problem(network, examples(network, x, t, counts), rng.normal(size=10))


def numpy_cost(name: str, errors: np.ndarray, counts: np.ndarray) -> float:
    """Costs pattern by pattern, from (outputs, patterns)."""
    per_epoch: list[float] = []
    for e, c in zip(errors.T, counts.T > 0, strict=True):
        if c.any():
            squares = e[c] ** 2
            per_epoch.append(
                0.5 * np.sqrt(np.mean(squares)) if name == "half_rms" else 0.5 * np.sum(squares)
            )
    if name == "mean_modulus":
        return float(np.mean(np.abs(errors[counts > 0])))
    return float(np.mean(per_epoch))


def literally(
    problem: Problem,
    rule: AbstractRule,
    rates: AbstractRates,
    cost_name: str,
    epochs: int,
    sequences: list[np.ndarray] | None = None,
) -> tuple[list[float], list[np.ndarray], list[np.ndarray]]:
    """Costs, rates and weights of a loop over `rule.change`; in turn if there are sequences."""
    network, training_set, start = problem
    learning = (True,) * len(network.groups)
    moves = jax.jit(lambda w, signals, t, c: rule.change(network, w, signals, t, c, learning))
    counts, targets = np.asarray(training_set.counts), np.asarray(training_set.targets)
    signals = [np.asarray(x) for x in training_set.signals.inputs]
    bias = np.ones((1, targets.shape[1]))

    def cost(weights: np.ndarray) -> float:
        total = np.zeros(targets.shape)
        for (_, layer), x in zip(network.adaptive_layers, signals, strict=True):
            seen = np.concatenate([x, bias]) if layer.bias else x
            total += np.asarray(layer.links.matrix(jnp.asarray(weights))) @ seen
        return numpy_cost(cost_name, targets - total, counts)

    def after(weights: np.ndarray, at: np.ndarray, epoch: int) -> np.ndarray:
        if sequences is None:
            whole = moves(weights, training_set.signals, training_set.targets, training_set.counts)
            return weights + at @ np.asarray(whole) / np.sum((counts > 0).any(axis=0))
        for pattern in sequences[epoch]:
            one: Any = jax.tree.map(
                lambda x, p=pattern: x[:, p : p + 1],
                (training_set.signals, training_set.targets, training_set.counts),
            )
            weights = weights + at @ np.asarray(moves(weights, *one))
        return weights

    weights = start
    now = np.broadcast_to(np.asarray(rates.start), (len(network.groups),)).astype(float)
    costs, rates_by_epoch, weights_by_epoch = list[float](), list[np.ndarray](), list[np.ndarray]()
    for epoch in range(epochs):
        costs.append(cost(weights))
        weights_by_epoch.append(weights)
        stable = True
        if isinstance(rates, AdaptedRates):
            trials = np.asarray(rates.trials(jnp.asarray(now)))
            reached = [cost(after(weights, trial, epoch)) for trial in trials]
            result = np.asarray(
                rates.adapted(jnp.asarray(now), jnp.asarray(costs[-1]), jnp.asarray(reached))
            )
            if cost(after(weights, result, epoch)) <= costs[-1]:
                now = result
            elif reached[0] > costs[-1]:  # neither those nor the present ones are stable
                now, stable = 0.9 * np.minimum(now, result), False
        rates_by_epoch.append(now)
        weights = after(weights, now, epoch) if stable else weights
    return costs, rates_by_epoch, weights_by_epoch


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: rule.name)
@pytest.mark.parametrize("cost", [half_rms, mean_modulus, half_square])
def test_history_is_the_literal_loop_s(
    two_parts: Problem, rule: AbstractRule, cost: Callable[..., jax.Array]
) -> None:
    network, training_set, start = two_parts
    rates = AdaptedRates(np.array([0.05, 0.2]))
    history = train(network, training_set, start, Plan(rule, rates, cost=cost), epochs=25).history
    costs, rates_by_epoch, weights_by_epoch = literally(two_parts, rule, rates, cost.__name__, 25)
    assert_allclose(history.cost, costs, rtol=1e-8)
    assert_array_equal(history.measure, history.cost)
    assert_allclose(history.rates, rates_by_epoch, rtol=1e-9)
    assert_allclose(np.asarray(history.weights), weights_by_epoch, rtol=1e-7, atol=1e-9)
    assert np.isnan(history.stop_cost).all()
    if isinstance(rule, Backpropagation):  # each for itself
        assert len(np.unique(np.round(history.rates[:, 0] / history.rates[:, 1], 9))) > 1


# One pattern after the other.


def shuffled(key: jax.Array, patterns: int, epochs: int) -> list[np.ndarray]:
    per_epoch = [
        jax.random.permutation(jax.random.fold_in(key, n), patterns) for n in range(epochs)
    ]
    return [np.asarray(sequence) for sequence in per_epoch]


@pytest.mark.parametrize("rates", [FixedRates(0.03), AdaptedRates(0.02)], ids=["fixed", "adapted"])
def test_sequential_is_the_literal_loop_s(line: Problem, rates: AbstractRates) -> None:
    key, rule = jax.random.key(7), Backpropagation()
    plan = Plan(rule, rates, order="sequential")
    result = train(line.network, line.training_set, line.start, plan, epochs=6, key=key)
    sequences = shuffled(key, 20, 6)
    costs, rates_by_epoch, weights_by_epoch = literally(line, rule, rates, "half_rms", 6, sequences)
    assert_allclose(result.history.cost, costs, rtol=1e-10)
    assert_allclose(result.history.rates, rates_by_epoch, rtol=1e-10)
    assert_allclose(np.asarray(result.history.weights), weights_by_epoch, rtol=1e-9)


def test_the_order_is_the_key_s_alone(line: Problem) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(0.03), order="sequential")

    def weights(seed: int | None, start: np.ndarray = start, chunk: int = 6) -> np.ndarray:
        key = None if seed is None else jax.random.key(seed)
        result = train(network, training_set, start, plan, epochs=6, key=key, chunk=chunk)
        return np.asarray(result.history.weights)

    first = weights(1)
    assert_array_equal(weights(1), first)
    assert_allclose(weights(1, chunk=3), first, rtol=1e-12)  # not how epochs are cut up
    assert not np.allclose(weights(2)[1:], first[1:])
    assert_array_equal(weights(None), weights(0))
    # Every epoch's sequence is another one: from one state they lead to different places.
    sequences = shuffled(jax.random.key(1), 20, 6)
    assert len({tuple(sequence) for sequence in sequences}) == 6
    assert all(sorted(sequence) == list(range(20)) for sequence in sequences)


# Ends.


def test_target(line: Problem) -> None:
    """Ends at the first weights whose measure is at most the target, and keeps them."""
    network, training_set, start = line
    free = train(network, training_set, start, Plan(Backpropagation(), FixedRates(0.2)), epochs=50)
    errors = [
        np.abs(training_set.errors(network, jnp.asarray(w)))
        for w in np.asarray(free.history.weights)
    ]
    modulus = np.mean(np.reshape(errors, (50, -1)), axis=1)
    for target in (1.5 * modulus[0], modulus[9] * (1 + 1e-9), 0.5 * (modulus[9] + modulus[10])):
        plan = Plan(Backpropagation(), FixedRates(0.2), target=target, measure=mean_modulus)
        result = train(network, training_set, start, plan, epochs=50)
        at = int(np.argmax(modulus <= target))
        assert bool(result.outcome == OUTCOMES.reached)
        assert int(result.epochs) == at
        assert_array_equal(result.weights, np.asarray(free.history.weights)[at])
        assert_allclose(result.history.measure[: at + 1], modulus[: at + 1], rtol=1e-10)
        assert_array_equal(result.history.cost[: at + 1], free.history.cost[: at + 1])
        # From there on, entries repeat.
        assert_array_equal(result.history.rule, np.where(np.arange(50) < at, 0, -1))
        for name in ("cost", "measure", "rates", "weights"):
            entries = getattr(result.history, name)[at:]
            assert_array_equal(entries, np.broadcast_to(entries[0], entries.shape))
        assert float(result.cost) == result.history.cost[at]


def test_entries_repeat_also_where_a_turn_would_change(line: Problem) -> None:
    schedule = Schedule((Backpropagation(), PERAL()), 1e9, 1, 10.0, 1)
    rates = (AdaptedRates(0.01), AdaptedRates(0.3))
    result = train(*line[:2], line.start, Plan(schedule, rates), epochs=12)
    assert bool(result.outcome == OUTCOMES.no_further_reduction)
    at = int(result.epochs)
    assert at == 3
    assert_array_equal(
        result.history.rates[at:], np.repeat(result.history.rates[at:][:1], 12 - at, 0)
    )


def overtrained(rng: np.random.Generator) -> tuple[Problem, Examples]:
    """Ten weights, twelve noisy patterns, and a stop set whose cost falls, then rises."""
    network = fully_connected([9, 1], "linear combiner")
    w = rng.normal(size=(9, 1))
    x, other = rng.normal(size=(12, 9)), rng.normal(size=(40, 9))
    training_set = examples(network, x, x @ w + 2.0 * rng.normal(size=(12, 1)))
    return Problem(network, training_set, np.zeros(10)), examples(network, other, other @ w)


def test_stop_set(rng: np.random.Generator) -> None:
    """The weights of its lowest cost, and `stop_patience` epochs spent beyond (3.6.1)."""
    problem, stop_set = overtrained(rng)
    network, training_set, start = problem
    rates = FixedRates(0.05)
    for patience in (1, 20):
        plan = Plan(Backpropagation(), rates, stop_patience=patience)
        result = train(network, training_set, start, plan, epochs=300, chunk=300, stop_set=stop_set)
        assert bool(result.outcome == OUTCOMES.stop_set)
        end = int(result.epochs)
        costs = result.history.stop_cost[: end + 1]
        best = int(np.argmin(costs))
        assert 0 < best == end - patience
        assert_array_equal(result.weights, np.asarray(result.history.weights)[best])
        (again,) = stop_set.costs(network, result.weights, half_rms)
        assert_allclose(costs[best], again, rtol=1e-12)
        assert_array_equal(result.history.rule[end:], -1)
        # It is the training patterns' cost that is shown as the cost, and it still falls.
        assert result.history.cost[end] < result.history.cost[best]


def test_diverges_by_name(line: Problem) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(5.0))
    with pytest.raises(RuntimeError, match="diverged: the cost grew beyond all bounds") as raised:
        train(network, training_set, start, plan, epochs=50)
    assert "\n" not in str(raised.value)
    result = train(network, training_set, start, plan, epochs=50, throw=False)
    assert bool(result.outcome == OUTCOMES.diverged)
    assert result.outcomes() == {"diverged": 1}
    costs = result.history.cost[: int(result.epochs) + 1]
    assert costs[-1] > 1e3 * costs[0]
    assert np.all(costs[:-1] <= 1e3 * costs[0])
    assert_array_equal(result.weights, np.asarray(result.history.weights)[int(np.argmin(costs))])
    assert np.all(np.isfinite(result.weights))


def test_an_infinite_cost_diverges_at_once(line: Problem) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(1e200))
    result = train(network, training_set, start, plan, epochs=50, throw=False)
    assert bool(result.outcome == OUTCOMES.diverged)
    assert int(result.epochs) == 1
    assert_array_equal(result.weights, start)


def test_stalls_by_name(line: Problem) -> None:
    """At a rate of zero nothing moves; too large a rate, within bounds, goes back and forth."""
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(0.0), patience=7)
    with pytest.raises(RuntimeError, match="stalled: no new lowest cost"):
        train(network, training_set, start, plan, epochs=50)
    result = train(network, training_set, start, plan, epochs=50, throw=False)
    assert bool(result.outcome == OUTCOMES.stalled)
    assert int(result.epochs) == 7
    assert_array_equal(result.weights, start)


def test_adapted_rates_settle_where_fixed_ones_diverge(line: Problem) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), AdaptedRates(5.0), divergence=1e9)
    result = train(network, training_set, start, plan, epochs=200, throw=False)
    assert result.history.cost[-1] < 0.2 * result.history.cost[0]


def test_no_epochs_and_no_weights_kept(line: Problem) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(0.2))
    none = train(network, training_set, start, plan, epochs=0)
    assert_array_equal(none.weights, start)
    assert none.history.cost.shape == (0,)
    assert none.outcomes() == {"not ended": 1}
    kept = train(network, training_set, start, plan, epochs=50)
    other = train(network, training_set, start, plan, epochs=50, keep_weights=False)
    assert other.history.weights is None
    assert_array_equal(other.history.cost, kept.history.cost)
    assert_array_equal(other.weights, kept.weights)
    assert repr(other) == "Training(1 of 4 weights: 1 not ended)"


# Frozen layers (5.2.4).


def test_frozen_weights_stay_bit_for_bit(two_parts: Problem) -> None:
    network, training_set, start = two_parts
    for rule in (Backpropagation(), PERAL()):
        plan = Plan(rule, AdaptedRates(0.05), frozen=["a"])
        result = train(network, training_set, start, plan, epochs=30)
        assert_array_equal(np.asarray(result.history.weights)[:, :4], np.tile(start[:4], (30, 1)))
        assert_array_equal(result.history.rates[:, 0], 0.0)
        assert result.history.cost[-1] < result.history.cost[0]


def test_frozen_layers_do_not_count_in_averages(rng: np.random.Generator) -> None:
    """5.2.6: 'the average of the relevant elements of dW^M, rather than of both'."""

    def signals(patterns: Any) -> Signals:
        x = jnp.asarray(patterns).T
        return Signals((x[:2], x[2:]), ((), ()))

    parts = (side_by_side("mass", 2, 1, 0), side_by_side("velocity", 2, 1, 0))
    network = AdaptiveNetwork(parts, signals, LINEAR_COMBINER, ("a", "b"))
    x, w = rng.normal(size=(25, 4)), np.array([0.4, -0.7])
    training_set = examples(network, x, x[:, :2] @ w[:, None] + x[:, 2:] @ w[:, None])
    plan = Plan(Backpropagation(), FixedRates(0.3), frozen=["velocity"])
    start = np.array([1.0, 1.0])
    history = train(network, training_set, start, plan, epochs=2).history
    errors = np.asarray(training_set.errors(network, jnp.asarray(start)))[0]
    assert_allclose(np.asarray(history.weights)[1], start + 0.3 * x[:, :2].T @ errors / 25)


def test_friction_alone_is_relearnt(
    puma: CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    """Bearings cleaned: other friction, re-identified with all else frozen (5.2.4)."""
    network = inverse_dynamics(puma)
    patterns = tuple(rng.uniform(-2, 2, (3, 60, 6)))
    k = np.asarray(puma_k)
    friction = np.array([name.startswith(("kv", "kd")) for name in puma.names])
    cleaned = np.where(friction, k * rng.uniform(0.3, 0.8, k.size), k)
    targets = puma.torque(jnp.asarray(cleaned), *patterns)
    training_set = examples(network, patterns, targets)
    plan = Plan(
        Backpropagation(),
        FixedRates(0.5),
        cost=half_square,
        frozen=("mass", "velocity", "gravity"),
        target=-1.0,  # all epochs: of a cost from normal equations, rounding leaves 1e-13 or less
    )
    solvable = with_normal_equations(network, training_set)
    result = train(network, solvable, k, plan, epochs=400, chunk=400)
    assert_array_equal(np.asarray(result.weights)[~friction], k[~friction])
    assert_allclose(np.asarray(result.weights)[friction], cleaned[friction], rtol=1e-6)
    assert_array_equal(result.history.rates[:, :3], 0.0)


# Seen from outside.


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_goes_to_standard_error_alone(
    line: Problem, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    network, training_set, start = line
    plan = Plan(Backpropagation(), FixedRates(0.2))
    train(network, training_set, start, plan, epochs=50)
    assert capfd.readouterr() == ("", "")
    screen, page = Screen(), Screen()
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setattr("sys.stdout", page)
    train(network, training_set, start, plan, epochs=50)
    assert (screen.getvalue(), page.getvalue()) == ("", "")
    train(network, training_set, start, plan, epochs=50, progress=True)
    assert "50/50" in screen.getvalue()
    assert "cost=" in screen.getvalue()
    assert page.getvalue() == ""

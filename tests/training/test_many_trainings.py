"""Many trainings at once: each as if it were alone, whatever the others do; compiled once."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import (
    OUTCOMES,
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Plan,
    Presentation,
    Schedule,
    Training,
    TrainingState,
    examples,
    fully_connected,
    half_square,
    mean_modulus,
    train,
    training_steps,
    with_normal_equations,
)


#: Products of matrices of other shapes add up in another order.
ROUNDING: Any = {"rtol": 1e-9, "atol": 1e-11}
EPOCHS = 60
BOTH = (Backpropagation(), PERAL())


class Problem(NamedTuple):
    network: AdaptiveNetwork
    training_set: Examples
    starts: np.ndarray


@pytest.fixture
def problem(rng: np.random.Generator) -> Problem:
    """A linear combiner of four inputs and a bias to two nodes, noise, and five starts."""
    network = fully_connected([4, 2], "linear combiner")
    x = rng.normal(size=(25, 4))
    t = x @ rng.normal(size=(4, 2)) + 0.1 * rng.normal(size=(25, 2))
    return Problem(network, examples(network, x, t), rng.normal(size=(5, 10)))


def plan_of(
    hand_over: Any = 1.0,
    target: Any = 0.0,
    least_reduction: Any = -float("inf"),
    rates: Any = (0.02, 0.2),
    **options: Any,
) -> Plan:
    """Its numbers compile nothing: most of what follows shares two compiled functions."""
    schedule = Schedule(BOTH, hand_over, 6, least_reduction, 2)
    adapted = [AdaptedRates(rate) for rate in rates]
    return Plan(schedule, adapted, target=target, measure=mean_modulus, **options)


def run(problem: Problem, plan: Plan, **options: Any) -> Training:
    settings: dict[str, Any] = {"epochs": EPOCHS, "chunk": 20, "throw": False, **options}
    return train(problem.network, problem.training_set, problem.starts, plan, **settings)


def assert_same(many: Training, at: int, single: Training) -> None:
    """One of many and the single training, as far as that one's history goes."""
    assert np.asarray(many.outcome == single.outcome)[at]
    assert int(many.epochs[at]) == int(single.epochs)
    assert_allclose(many.weights[at], single.weights, **ROUNDING)
    assert_allclose(many.rates[at], single.rates, **ROUNDING)
    assert_allclose(many.cost[at], single.cost, **ROUNDING)
    for name in ("cost", "measure", "stop_cost", "rule", "rates", "weights"):
        one = np.asarray(getattr(single.history, name))
        assert_allclose(getattr(many.history, name)[at][: len(one)], one, **ROUNDING)
        # Waiting changes nothing: what follows is its last entry.
        remainder = getattr(many.history, name)[at][len(one) :]
        assert_array_equal(remainder, np.broadcast_to(remainder[:1], remainder.shape))


def test_starts(problem: Problem) -> None:
    """They end at different times, in different ways, and those that ended wait."""
    plan = plan_of(target=0.15, least_reduction=3e-3)
    starts = problem.starts * np.array([0.3, 1.0, 3.0, 30.0, 1e-3])[:, None]
    starts[3] = 1e308
    many = run(problem._replace(starts=starts), plan)
    assert len(set(np.asarray(many.epochs).tolist())) > 2
    assert len(many.outcomes()) > 1
    for at, start in enumerate(starts):
        assert_same(many, at, run(problem._replace(starts=start), plan))
        waiting = np.asarray(many.history.weights)[at, int(many.epochs[at]) :]
        assert_array_equal(waiting, np.broadcast_to(waiting[:1], waiting.shape))


def test_one_that_diverges_leaves_the_others(problem: Problem) -> None:
    """And many never raise: their outcomes say which failed."""
    starts = problem.starts.copy()
    starts[3] = 1e308
    many = run(problem._replace(starts=starts), plan_of(), throw=True)
    assert many.outcomes() == {"not ended": 4, "diverged": 1}
    assert repr(many) == "Training(5 of 10 weights: 4 not ended, 1 diverged)"
    for at in (2, 4):
        assert_same(many, at, run(problem._replace(starts=starts[at]), plan_of()))


def test_targets_and_hand_overs(problem: Problem) -> None:
    """Numbers of the plan, one for each training."""
    hand_overs = jnp.asarray([2.0, 0.8, 0.5, 0.3, 0.0])
    targets = jnp.asarray([0.1, 0.5, 0.2, 0.0, 0.3])
    least = jnp.asarray([-jnp.inf, -jnp.inf, 1e-3, 5e-3, 1e-2])
    start = problem.starts[0]
    single_sets = problem._replace(starts=np.tile(start, (5, 1)))
    many = run(single_sets, plan_of(hand_overs, targets, least))
    firsts: set[int] = set()
    for at in range(5):
        plan = plan_of(float(hand_overs[at]), float(targets[at]), float(least[at]))
        assert_same(many, at, run(problem._replace(starts=start), plan))
        firsts.add(int(np.argmax(np.append(np.asarray(many.history.rule[at]) == 1, True))))
    assert len(firsts) > 2


def stacked(problem: Problem, rng: np.random.Generator) -> tuple[Examples, list[Examples]]:
    single_sets: list[Examples] = []
    for _ in range(5):
        x, t = rng.normal(size=(25, 4)), rng.normal(size=(25, 2))
        single_sets.append(examples(problem.network, x, t, rng.uniform(size=(25, 2)) < 0.9))
    return jax.tree.map(lambda *parts: jnp.stack(parts), *single_sets), single_sets


def test_recordings_and_stop_sets(problem: Problem, rng: np.random.Generator) -> None:
    """A recording for each, stop sets for each or for all, from one start or several."""
    recordings, single_sets = stacked(problem, rng)
    stop_sets, single_stop_sets = stacked(problem, rng)
    network, plan = problem.network, plan_of(stop_patience=4)
    options: Any = {"epochs": EPOCHS, "chunk": 20}
    for starts in (problem.starts[0], problem.starts):
        many = train(network, recordings, starts, plan, stop_set=stop_sets, **options)
        assert "stop set" in many.outcomes()
        for at in (0, 3):
            start_of = np.broadcast_to(starts, (5, 10))[at]
            single = train(
                network, single_sets[at], start_of, plan, stop_set=single_stop_sets[at], **options
            )
            assert_same(many, at, single)
    many = train(network, recordings, problem.starts, plan, stop_set=single_stop_sets[0], **options)
    start_of = problem.starts[2]
    single = train(network, single_sets[2], start_of, plan, stop_set=single_stop_sets[0], **options)
    assert_same(many, 2, single)


def test_recordings_by_vmap_of_examples(problem: Problem, rng: np.random.Generator) -> None:
    x, t = rng.normal(size=(5, 25, 4)), rng.normal(size=(5, 25, 2))
    made = jax.vmap(lambda x, t: examples(problem.network, x, t))(jnp.asarray(x), jnp.asarray(t))
    assert made.trainings == 5
    start = problem.starts[0]
    many = run(problem._replace(training_set=made, starts=start), plan_of())
    training_set = examples(problem.network, x[1], t[1])
    assert_allclose(made.targets[1], training_set.targets)
    assert_same(many, 1, run(problem._replace(training_set=training_set, starts=start), plan_of()))


def test_seeds(problem: Problem) -> None:
    """A key for each; a single key is split."""
    plan = Plan(Backpropagation(), FixedRates(0.02), order="sequential")
    key = jax.random.key(3)
    keys = jax.random.split(key, 5)
    short: Any = {"epochs": 6, "chunk": 6}
    split = run(problem, plan, key=key, **short)
    single_sets = run(problem, plan, key=keys, **short)
    assert_array_equal(split.weights, single_sets.weights)
    alone = problem._replace(starts=problem.starts[2])
    assert_same(single_sets, 2, run(alone, plan, key=keys[2], **short))
    same_start = problem._replace(starts=np.tile(problem.starts[0], (5, 1)))
    weights = np.asarray(run(same_start, plan, key=key, **short).weights)
    assert len(np.unique(weights[:, 0])) == 5


@pytest.mark.parametrize("cut", [{"block": 2}, {"block": 64}, {"chunk": 30}], ids=str)
def test_blocks_and_chunks_are_no_part_of_the_result(problem: Problem, cut: dict[str, int]) -> None:
    """Five trainings in two blocks and one left over, or in one that is not filled."""
    plan = plan_of(target=0.2)
    whole, result = run(problem, plan), run(problem, plan, **cut)
    assert_array_equal(result.epochs, whole.epochs)
    assert_allclose(result.weights, whole.weights, **ROUNDING)
    passed = min(result.history.cost.shape[1], whole.history.cost.shape[1])
    assert passed > int(jnp.max(whole.epochs)) or passed == EPOCHS
    for name in ("cost", "rule", "rates", "weights"):
        one, other = (
            getattr(single_sets.history, name)[:, :passed] for single_sets in (result, whole)
        )
        assert_allclose(one, other, **ROUNDING)


def test_training_steps_under_vmap(problem: Problem) -> None:
    """Over whatever the program likes: here over starts, rates and noise of the targets."""
    network, training_set = problem.network, problem.training_set
    rates, noise = jnp.asarray([0.05, 0.1, 0.2]), jnp.asarray([0.0, 0.5, 1.0])
    starts = jnp.asarray(problem.starts[:3])

    def disturbed(noise: Array) -> Examples:
        targets = training_set.targets + noise * jnp.sign(training_set.targets)
        return Examples(training_set.signals, targets, training_set.counts, None)

    def several(start: Array, rate: Array, noise: Array) -> Any:
        plan = plan_of(rates=(rate, rate))
        state = TrainingState.first(network, plan, start, jax.random.key(0))
        return training_steps(network, plan, disturbed(noise), None, state, 20)

    states, records = jax.jit(jax.vmap(several))(starts, rates, noise)
    assert records.cost.shape == (3, 20)
    assert records.weights is None
    for at in range(3):
        start_of = problem._replace(training_set=disturbed(noise[at]), starts=starts[at])
        single = run(start_of, plan_of(rates=(rates[at], rates[at])), epochs=20)
        assert_allclose(states.weights[at], single.weights, **ROUNDING)
        assert_allclose(records.cost[at], single.history.cost, **ROUNDING)
    assert bool(jnp.all(states.outcome == OUTCOMES.running))


def test_normal_equations_side_by_side(problem: Problem, rng: np.random.Generator) -> None:
    recordings, single_sets = stacked(problem, rng)
    network, start = problem.network, problem.starts[0]
    plan = Plan(Backpropagation(), AdaptedRates(0.1), cost=half_square)
    made = jax.jit(jax.vmap(lambda training_set: with_normal_equations(network, training_set)))(
        recordings
    )
    assert made.trainings == 5
    many = train(network, made, start, plan, epochs=EPOCHS, chunk=60)
    for at in (0, 4):
        alone = with_normal_equations(network, single_sets[at])
        single = train(network, alone, start, plan, epochs=EPOCHS, chunk=60)
        assert_same(many, at, single)


# Compiled once.

TRACES: list[str] = []


class Traced(AbstractRule):
    """Backpropagation that notes every tracing of itself."""

    @property
    def name(self) -> str:
        return "traced"

    def check_network(self, network: AdaptiveNetwork) -> str | None:
        return None

    def moves(self, shown: Presentation) -> Sequence[Array]:
        TRACES.append(self.name)
        return Backpropagation().moves(shown)


def test_nothing_compiles_twice(problem: Problem, rng: np.random.Generator) -> None:
    """Not for other starts, patterns, hand-overs, targets, rates or keys, nor more chunks."""
    rules = (Traced(), Backpropagation())
    TRACES.clear()
    plan = Plan(Schedule(rules, 0.5), (AdaptedRates(0.05), FixedRates(0.1)), target=0.1)
    options: Any = {"keep_weights": False}
    for starts in (problem.starts[0], problem.starts):
        run(problem._replace(starts=starts), plan, **options)
    first = len(TRACES)
    assert 0 < first < 6  # bodies of two scans, and not once for each epoch or chunk
    plan = Plan(Schedule(rules, 0.7), (AdaptedRates(0.01), FixedRates(0.2)), target=0.0)
    network = fully_connected([4, 2], "linear combiner")  # an equal one
    training_set = examples(network, rng.normal(size=(25, 4)), rng.normal(size=(25, 2)))
    for starts in (2.0 * problem.starts[1], 2.0 * problem.starts):
        other = Problem(network, training_set, starts)
        run(other, plan, epochs=2 * EPOCHS, key=jax.random.key(9), **options)
    assert len(TRACES) == first


# Failures.


def test_refused(problem: Problem, rng: np.random.Generator) -> None:
    recordings, single_sets = stacked(problem, rng)
    rule, network = Backpropagation(), problem.network
    with pytest.raises(ValueError, match=r"^weights: 4 starts, but 5 sets of patterns"):
        train(network, recordings, problem.starts[:4], rule)
    with pytest.raises(ValueError, match=r"^stop_set: expected one, got shape \(5,\)"):
        train(network, single_sets[0], problem.starts[0], rule, stop_set=recordings)
    with pytest.raises(ValueError, match=r"^stop_set: expected one, or for each of 4"):
        train(network, single_sets[0], problem.starts[:4], rule, stop_set=recordings)
    with pytest.raises(ValueError, match=r"^key: expected one, or for each of 5 trainings"):
        train(
            network,
            single_sets[0],
            problem.starts,
            rule,
            key=jax.random.split(jax.random.key(0), 4),
        )
    starts = problem.starts * np.array([1.0, 1.0, 0.0, 1.0, 1.0])[:, None]
    with pytest.raises(ValueError, match=r"PERAL cannot start .* all zero \(training 3\)"):
        train(network, single_sets[0], starts, PERAL())

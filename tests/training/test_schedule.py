"""Schedules (7.5): whose turn it is, beside a literal bookkeeping; alone, and in trainings."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from jaxcslc.training import (
    OUTCOMES,
    PERAL,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Plan,
    Schedule,
    Training,
    examples,
    fully_connected,
    train,
)
from jaxcslc.training._plan import Turn


INF = float("inf")
BOTH = (Backpropagation(), PERAL())


def literally(
    costs: Sequence[float],
    rules: int,
    hand_over: float,
    bout: int,
    least_reduction: float,
    tolerated: int,
    *,
    from_lowest: bool = False,
) -> list[int]:
    """Which rule learns in every epoch, -1 once none gains enough, from costs before them.

    With `from_lowest`, as in a training: a rule takes over at the weights of the lowest cost.
    """
    taken = [0]
    rule, in_bout, little, gave_away = 0, 0, 0, 0
    by_turns = ended = fruitful = False
    before = lowest = costs[0]
    for cost in costs[1:]:
        if ended:
            taken.append(-1)
            continue
        reduction, before, lowest = before - cost, cost, min(lowest, cost)
        give = False
        if not by_turns:
            give = by_turns = rules == 1 or cost < hand_over
        else:
            in_bout += 1
            if reduction >= least_reduction:
                little = gave_away = 0
                fruitful = True
            elif reduction != 0:  # at zero it was the rates that changed
                little += 1
            if little == tolerated or (in_bout == bout and not fruitful):
                gave_away += 1
                give = True
            give = give or in_bout == bout
            ended = gave_away == rules
        if give:
            rule, in_bout, little, fruitful = (rule + 1) % rules, 0, 0, False
            before = lowest if from_lowest and rules > 1 else before
        taken.append(-1 if ended else rule)
    return taken


def turns(schedule: Schedule, costs: np.ndarray) -> np.ndarray:
    """The library's, for the same costs."""

    def step(turn: Turn, pair: jax.Array) -> tuple[Turn, jax.Array]:
        later = turn.next(schedule, pair[1], pair[0] - pair[1])
        ended = turn.ended(schedule) | later.ended(schedule)
        later = jax.tree.map(
            lambda old, new: jnp.where(turn.ended(schedule), old, new), turn, later
        )
        return later, jnp.where(ended, -1, later.rule)

    pairs = jnp.stack([jnp.asarray(costs[:-1]), jnp.asarray(costs[1:])], axis=1)
    _, taken = jax.lax.scan(step, Turn.first(), pairs)
    return np.concatenate([[0], np.asarray(taken)])


@pytest.mark.parametrize("rules", [1, 2, 3])
@pytest.mark.parametrize(("bout", "tolerated"), [(5, 2), (3, 3), (1, 1), (25, 5)])
def test_whose_turn_it_is(rng: np.random.Generator, rules: int, bout: int, tolerated: int) -> None:
    some: Any = (BOTH * 2)[:rules]
    for hand_over in (INF, 7.0, 0.0):
        schedule = Schedule(some, hand_over, bout, 0.01, tolerated)
        # Gains that become rare, and now and then a loss.
        likely = np.linspace(0.9, 0.1, 120)
        costs = 10.0 - np.cumsum(np.where(rng.uniform(size=120) < likely, 0.08, -0.01))
        result = turns(schedule, costs)
        expected = literally(list(costs), rules, hand_over, bout, 0.01, tolerated)
        assert_array_equal(result, expected)
        assert (hand_over == 0.0 and rules > 1) == (not result.any())


def test_the_epoch_of_the_hand_over_is_the_first_rule_s() -> None:
    costs = np.array([5.0, 4.0, 3.0, 1.9, 1.8, 1.7, 1.6, 1.5])
    assert_array_equal(turns(Schedule(BOTH, 2.0, bout=2), costs), [0, 0, 0, 1, 1, 0, 0, 1])


def test_a_cost_that_rises_again_does_not_take_the_turns_back() -> None:
    costs = np.array([5.0, 1.0, 5.0, 6.0, 7.0])
    assert_array_equal(turns(Schedule(BOTH, 2.0, bout=2), costs), [0, 1, 1, 0, 0])


def test_a_rule_that_gains_too_little_gives_its_turn_away() -> None:
    costs = np.array([5.0, 1.0, 0.9999, 0.9998, 0.9, 0.8, 0.7999, 0.7998, 0.7997, 0.7996])
    schedule = Schedule(BOTH, 2.0, bout=25, least_reduction=0.01, tolerated=2)
    # Two poor epochs of the second; two good of the first, then two poor; two poor: the end.
    assert_array_equal(turns(schedule, costs), [0, 1, 1, 0, 0, 0, 0, 1, 1, -1])


def test_bouts_shorter_than_what_is_tolerated_end_too() -> None:
    schedule = Schedule(BOTH, INF, bout=2, least_reduction=0.01, tolerated=5)
    result = turns(schedule, np.full(8, 1.0))
    assert_array_equal(result, [0, 1, 1, 0, 0, -1, -1, -1])


def test_epochs_that_move_nothing_are_not_counted() -> None:
    costs = np.array([5.0, 1.0, 0.9, 0.9, 0.9, 0.9, 0.8999, 0.8998, 0.8997])
    schedule = Schedule(BOTH, 2.0, bout=25, least_reduction=0.01, tolerated=2)
    assert_array_equal(turns(schedule, costs), [0, 1, 1, 1, 1, 1, 1, 0, 0])


# In trainings.


@pytest.fixture
def noisy(rng: np.random.Generator) -> tuple[AdaptiveNetwork, Examples, np.ndarray]:
    """A linear combiner whose targets it cannot quite meet, and a start of no small weights."""
    network = fully_connected([4, 2], "linear combiner")
    x = rng.normal(size=(40, 4))
    t = x @ rng.normal(size=(4, 2)) + 1.0 + 0.3 * rng.normal(size=(40, 2))
    return network, examples(network, x, t), rng.normal(size=10)


def trained(noisy: Any, schedule: Schedule, **options: Any) -> Training:
    network, training_set, start = noisy
    plan = Plan(schedule, (AdaptedRates(0.01), AdaptedRates(0.1)), patience=10_000)
    return train(network, training_set, start, plan, epochs=400, chunk=400, **options)


def test_by_turns_until_neither_gains(noisy: Any) -> None:
    """The same compiled training for three schedules: numbers compile nothing."""
    first = float(noisy[1].costs(noisy[0], jnp.asarray(noisy[2]), Plan(PERAL()).cost)[0])
    for hand_over, least in ((0.5 * first, 1e-3), (0.9 * first, 1e-2), (0.0, 1e-3)):
        result = trained(noisy, Schedule(BOTH, hand_over, 7, least, 3))
        costs = result.history.cost
        expected = literally(list(costs), 2, hand_over, 7, least, 3, from_lowest=True)
        assert_array_equal(result.history.rule, expected)
        if hand_over == 0.0:  # Never handed over: nothing ends it.
            assert_array_equal(result.history.rule, 0)
            assert result.outcomes() == {"not ended": 1}
            continue
        begun = int(np.argmax(costs < hand_over))
        assert not result.history.rule[:begun].any()
        assert result.history.rule[begun] == 1
        assert set(result.history.rule) == {0, 1, -1}
        assert bool(result.outcome == OUTCOMES.no_further_reduction)
        assert int(result.epochs) == np.sum(result.history.rule >= 0)
        # Each has rates of its own, which wait while the other learns.
        rates = result.history.rates[:, 0]
        for rule, first_rate in ((0, 0.01), (1, 0.1)):
            steps = np.concatenate([[first_rate], rates[result.history.rule == rule]])
            factors = steps[1:] / steps[:-1]
            assert np.all(
                np.min(np.abs(factors[:, None] - np.array([0.81, 0.9, 1.0, 1.1])), 1) < 1e-12
            )
            assert float(result.rates[rule, 0]) == steps[-1]


def test_one_rule_alone(noisy: Any) -> None:
    network, training_set, start = noisy
    alone = Schedule((Backpropagation(),), least_reduction=1e-3, tolerated=4)
    result = train(
        network, training_set, start, Plan(alone, FixedRates(0.3)), epochs=200, chunk=200
    )
    assert bool(result.outcome == OUTCOMES.no_further_reduction)
    costs, epochs = result.history.cost, int(result.epochs)
    assert_array_equal(result.history.rule, literally(list(costs), 1, INF, 25, 1e-3, 4))
    assert not result.history.rule[:epochs].any()
    gains = costs[:-1] - costs[1:]
    assert np.all(gains[epochs - 4 : epochs] < 1e-3)


def test_a_rule_is_a_plan_and_a_plan_a_schedule() -> None:
    plan = Plan(Backpropagation())
    assert plan.schedule.rules == (Backpropagation(),)
    assert plan.schedule.least_reduction == -INF


def test_refused() -> None:
    with pytest.raises(ValueError, match="schedule: expected at least one rule"):
        Schedule(())
    with pytest.raises(ValueError, match="a bout must have an epoch at least, got 0"):
        Schedule(BOTH, bout=0)
    with pytest.raises(ValueError, match="tolerated must be an epoch at least, got 0"):
        Schedule(BOTH, tolerated=0)
    with pytest.raises(ValueError, match=r"^rates: expected one for each of 2 rules, got 3$"):
        Plan(Schedule(BOTH), [FixedRates(0.1)] * 3)

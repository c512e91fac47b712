"""Turns in step (7.5, side by side): a literal loop, many next to one, resumed runs, equations."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import (
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Plan,
    Schedule,
    SwitchWhen,
    Training,
    examples,
    fully_connected,
    half_square,
    train,
    with_normal_equations,
)


BOTH = (Backpropagation(), PERAL())
RATES = (0.05, 0.3)
BOUTS = (6, 3)
# Sums over patterns are taken in another order.
ROUNDING = 1e-9


@pytest.fixture
def network() -> AdaptiveNetwork:
    return fully_connected([4, 2], "linear combiner")


@pytest.fixture
def several(rng: np.random.Generator, network: AdaptiveNetwork) -> tuple[Examples, np.ndarray]:
    """Three sets of patterns whose targets no weights meet, and a start for each."""
    x = rng.normal(size=(3, 40, 4))
    t = x @ rng.normal(size=(3, 4, 2)) + 1.0 + 0.3 * rng.normal(size=(3, 40, 2))
    sets = jax.vmap(lambda x, t: examples(network, x, t))(jnp.asarray(x), jnp.asarray(t))
    return sets, rng.normal(size=(3, 10))


def plan(hand_over: Any, least_reduction: float, rates: Any = None, **options: Any) -> Plan:
    schedule = Schedule(BOTH, hand_over, BOUTS, least_reduction, in_step=True, **options)
    fixed = tuple(FixedRates(rate) for rate in RATES)
    return Plan(schedule, rates or fixed, cost=half_square, patience=10_000)


def trained(
    network: AdaptiveNetwork, sets: Any, start: Any, plan: Plan, **options: Any
) -> Training:
    arguments: dict[str, Any] = {"epochs": 120, "chunk": 4, "throw": False} | options
    return train(network, sets, start, plan, **arguments)


def literally(
    network: AdaptiveNetwork,
    patterns: Examples,
    weights: np.ndarray,
    hand_over: float,
    least: float,
    epochs: int,
) -> tuple[list[int], list[float]]:
    """Which rule learns in every epoch, and the cost before it."""

    def cost_of(weights: np.ndarray) -> float:
        return float(patterns.costs(network, jnp.asarray(weights), half_square)[0])

    def moved(rule: AbstractRule, rate: float, weights: np.ndarray) -> np.ndarray:
        change = patterns.change(network, rule, jnp.asarray(weights), (True,))
        return weights + rate * np.asarray(change)[0]

    taken: list[int] = []
    costs: list[float] = []
    lowest, best = np.inf, weights

    def learn(rule: int, weights: np.ndarray, first_of_bout: bool) -> np.ndarray:
        nonlocal lowest, best
        cost = cost_of(weights)
        if cost < lowest:
            lowest, best = cost, weights
        if first_of_bout:
            weights = best
        taken.append(rule)
        costs.append(cost)
        return moved(BOTH[rule], RATES[rule], weights)

    # A look at the cost of every epoch comes after that epoch, in looks of four or two (bouts of
    # six in chunks of four).
    handed_over, looks = False, (4, 4)
    look = 0
    while not handed_over:
        for _ in range(looks[look % 2]):
            weights = learn(0, weights, False)
            handed_over |= costs[-1] < hand_over
        look += 1
    while len(taken) < epochs:
        before = lowest
        for rule in (1, 0):
            for number in range(BOUTS[rule]):
                weights = learn(rule, weights, number == 0)
        if before - lowest < least * sum(BOUTS):
            break
    return taken, costs


def test_against_a_literal_loop(
    network: AdaptiveNetwork, several: tuple[Examples, np.ndarray]
) -> None:
    sets, starts = several
    alone = jax.tree.map(lambda x: x[0], sets)
    first = float(alone.costs(network, jnp.asarray(starts[0]), half_square)[0])
    result = trained(network, alone, starts[0], plan(0.6 * first, 1e-3))
    taken, costs = literally(network, alone, starts[0], 0.6 * first, 1e-3, 120)
    epochs = int(result.epochs)
    assert result.outcomes() == {"no further reduction": 1}
    assert_array_equal(result.history.rule[:epochs], taken)
    assert_allclose(result.history.cost[:epochs], costs, rtol=ROUNDING)
    assert {0, 1} == set(taken)


def test_side_by_side_as_alone(
    network: AdaptiveNetwork, several: tuple[Examples, np.ndarray]
) -> None:
    """Together they begin rounds when the last is handed over; until then, as alone."""
    sets, starts = several
    result = trained(network, sets, starts, plan(np.inf, 1e-3))
    assert result.outcomes() == {"no further reduction": 3}
    for number in range(3):
        alone = jax.tree.map(lambda x, number=number: x[number], sets)
        one = trained(network, alone, starts[number], plan(np.inf, 1e-3))
        assert int(one.epochs) == int(result.epochs[number])
        assert_allclose(one.weights, result.weights[number], rtol=ROUNDING)


def test_none_begins_before_all_are_handed_over(
    network: AdaptiveNetwork, several: tuple[Examples, np.ndarray]
) -> None:
    sets, starts = several
    result = trained(network, sets, starts, plan(jnp.array([np.inf, 1.0, 0.0]), 0.0), epochs=20)
    assert_array_equal(result.history.rule, 0)


def test_with_normal_equations(
    network: AdaptiveNetwork, several: tuple[Examples, np.ndarray]
) -> None:
    """Backpropagation and costs by the equations; PERAL by the patterns: the same training."""
    sets, starts = several
    both = jax.vmap(lambda part: with_normal_equations(network, part))(sets)
    rates = (AdaptedRates(0.05), FixedRates(0.3))
    results = [trained(network, part, starts, plan(np.inf, 1e-3, rates)) for part in (sets, both)]
    assert_array_equal(results[0].history.rule, results[1].history.rule)
    assert_allclose(results[0].history.cost, results[1].history.cost, rtol=ROUNDING)
    assert_allclose(results[0].weights, results[1].weights, rtol=1e-6)


def test_a_resumed_run_takes_the_same_turns(
    network: AdaptiveNetwork, several: tuple[Examples, np.ndarray], tmp_path: Path
) -> None:
    sets, starts = several
    whole = trained(network, sets, starts, plan(np.inf, 1e-3))
    file = tmp_path / "training.npz"
    for epochs in (5, 8, 120):
        resumed = trained(network, sets, starts, plan(np.inf, 1e-3), epochs=epochs, checkpoint=file)
    assert_array_equal(resumed.history.rule, whole.history.rule)
    assert_array_equal(resumed.weights, whole.weights)


def test_one_rule_in_step(network: AdaptiveNetwork, several: tuple[Examples, np.ndarray]) -> None:
    sets, starts = several
    schedule = Schedule((Backpropagation(),), bout=10, least_reduction=1e-3, in_step=True)
    alone = Plan(schedule, FixedRates(0.05), cost=half_square)
    result = trained(network, sets, starts, alone, epochs=2000)
    assert result.outcomes() == {"no further reduction": 3}
    assert set(np.unique(result.history.rule)) <= {0, -1}
    assert np.all(np.asarray(result.epochs) % 10 == 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bout": (3,)}, "one for each of 2 rules"),
        ({"bout": (3, 0)}, "a bout must have an epoch"),
        ({"in_step": True, "switch": SwitchWhen()}, "in step, or by a switch"),
    ],
)
def test_refusals(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Schedule(BOTH, **options)

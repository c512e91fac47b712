"""The indicator of when to switch (8.2.2): gains against what epochs do, and whole trainings."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
    SwitchWhen,
    Training,
    examples,
    fully_connected,
    half_square,
    train,
)
from jaxcslc.training._plan import line_gain, promise


RULES = (Backpropagation(), PERAL())
SHARE = 4 / 13  # of the best rate: as high as a rate of a parabolic cost rises
LEARNING = (True,)
Noisy = tuple[AdaptiveNetwork, Examples, np.ndarray]


@pytest.fixture
def noisy(rng: np.random.Generator) -> Noisy:
    """A linear combiner with inputs of different size, whose targets it cannot quite meet."""
    network = fully_connected([4, 2], "linear combiner")
    x = rng.normal(size=(40, 4)) * [1.0, 0.5, 0.3, 0.1]
    t = x @ rng.normal(size=(4, 2)) + 1.0 + 0.1 * rng.normal(size=(40, 2))
    return network, examples(network, x, t), rng.normal(size=10)


def cost(noisy: Noisy, weights: Any) -> float:
    network, training_set, _ = noisy
    return float(training_set.costs(network, jnp.asarray(weights), half_square)[0])


def test_gain_along_a_line(rng: np.random.Generator) -> None:
    """What is left of the squares at the best multiple, and no multiple leaves less."""
    for _ in range(20):
        errors, moved = rng.normal(size=(2, 3, 7))
        moved *= 10.0 ** rng.uniform(-3, 3)
        gain, multiple = (float(x) for x in line_gain(jnp.asarray(errors), jnp.asarray(moved)))
        if np.sum(errors * moved) <= 0:
            assert gain == multiple == 0.0
            continue

        def left(m: float, errors: np.ndarray = errors, moved: np.ndarray = moved) -> float:
            return float(np.sum((errors - m * moved) ** 2) / np.sum(errors**2))

        assert_allclose(left(multiple), 1.0 - gain, rtol=1e-12)
        assert min(left(0.99 * multiple), left(1.01 * multiple)) > left(multiple)


@pytest.mark.parametrize("fill", [0.0, np.nan, np.inf])
def test_a_step_that_is_none_promises_nothing(fill: float) -> None:
    errors = jnp.ones((1, 3))
    assert [float(x) for x in line_gain(errors, jnp.full((1, 3), fill))] == [0.0, 0.0]
    assert [float(x) for x in line_gain(0.0 * errors, errors)] == [0.0, 0.0]


def test_a_promise_is_kept_where_outputs_are_linear(noisy: Noisy) -> None:
    """Exactly, for every rule, whatever the scale of the rates."""
    network, training_set, start = noisy
    weights = jnp.asarray(start)
    for scale in (1e-6, 1.0, 1e3):
        rates = jnp.full((2, 1), scale)
        gains, best = promise(network, Plan(Schedule(RULES)), training_set, weights, rates)
        for rule, gain, at in zip(RULES, gains, best, strict=True):
            change = training_set.change(network, rule, weights, LEARNING)
            after = cost(noisy, weights + at @ change)
            assert_allclose(after / cost(noisy, start), 1.0 - float(gain), rtol=1e-10)
            assert 0.0 < float(gain) < 1.0


def test_a_promise_of_sigmoids_is_first_order(rng: np.random.Generator) -> None:
    """Near targets that can be met, the part that it says remains, to the size of the errors."""
    network = fully_connected([3, 2], "hyperbolic tangent")
    x, optimum = rng.normal(size=(30, 3)), 0.5 * rng.normal(size=8)
    met = examples(network, x, network.outputs(jnp.asarray(optimum), x))
    for distance in (1e-2, 1e-4):
        weights = jnp.asarray(optimum + distance * rng.normal(size=8))
        gains, best = promise(network, Plan(Schedule(RULES)), met, weights, jnp.ones((2, 1)))
        for rule, gain, at in zip(RULES, gains, best, strict=True):
            moved = weights + at @ met.change(network, rule, weights, LEARNING)
            before, after = (met.costs(network, w, half_square)[0] for w in (weights, moved))
            assert_allclose(after / before, 1.0 - float(gain), atol=20 * distance)


def trained(noisy: Noisy, schedule: Schedule, **options: Any) -> Training:
    network, training_set, start = noisy
    rates = (AdaptedRates(0.1), AdaptedRates(0.1))
    plan = Plan(schedule, rates, cost=half_square, patience=10_000)
    start = options.pop("start", start)
    return train(network, training_set, start, plan, epochs=60, chunk=60, **options)


def test_turns_go_to_the_greatest_promise(noisy: Noisy) -> None:
    """Look by look, from the weights and rates of the history; nothing changes in between. Looks
    that change nothing are ever rarer.
    """
    network, training_set, _ = noisy
    rules = RULES[::-1]
    switch = SwitchWhen(every=3, margin=1.1)
    history = trained(noisy, Schedule(rules, switch=switch)).history
    assert history.weights is not None
    rule, lowest, lowest_weights = 0, np.inf, history.weights[0]
    switches, next_look, interval = 0, 0, 0
    for epoch, weights in enumerate(history.weights):
        if history.cost[epoch] < lowest:
            lowest, lowest_weights = history.cost[epoch], weights
        if epoch == next_look:
            interval = 2 * interval or 3
            steps = [training_set.change(network, r, jnp.asarray(weights), LEARNING) for r in rules]
            errors = np.asarray(training_set.errors(network, jnp.asarray(weights)))
            # Outputs are linear: the change of outputs is that of the errors.
            moved = [
                errors - np.asarray(training_set.errors(network, weights + step[0]))
                for step in steps
            ]
            cosines = [
                max(np.sum(errors * m), 0.0) / np.linalg.norm(errors) / np.linalg.norm(m)
                for m in moved
            ]
            worth = np.square(cosines)
            other = 1 - rule
            if worth[other] > 1.1 * worth[rule]:
                rule, switches, interval = other, switches + 1, 3
                best = np.sum(errors * moved[rule]) / np.sum(moved[rule] ** 2)
                # It takes over at the lowest weights; its first epoch adapts the rate once.
                if epoch + 1 < len(history.weights):
                    step = np.asarray(
                        training_set.change(
                            network, rules[rule], jnp.asarray(lowest_weights), LEARNING
                        )
                    )[0]
                    gone = history.weights[epoch + 1] - lowest_weights
                    assert_allclose(gone, history.rates[epoch, 0] * step, atol=1e-12)
                factor = history.rates[epoch, 0] / (SHARE * best)
                assert np.min(np.abs(factor - np.array([0.81, 0.9, 1.0, 1.1]))) < 1e-9
            next_look += interval
        assert history.rule[epoch] == rule, epoch
    assert switches >= 1


def test_a_margin_that_nothing_exceeds_is_backpropagation_alone(noisy: Noisy) -> None:
    never = trained(noisy, Schedule(RULES, switch=SwitchWhen(margin=1e12)))
    network, training_set, start = noisy
    alone = Plan(RULES[0], AdaptedRates(0.1), cost=half_square, patience=10_000)
    expected = train(network, training_set, start, alone, epochs=60, chunk=60)
    # Two programs: their rounding grows with every comparison by which rates are adapted.
    assert_allclose(never.history.cost[:20], expected.history.cost[:20], rtol=1e-9)
    assert_array_equal(never.history.rule, 0)


def test_fixed_rates_stay(noisy: Noisy) -> None:
    network, training_set, start = noisy
    plan = Plan(
        Schedule(RULES, switch=SwitchWhen(every=1, margin=1e-6)),
        (FixedRates(0.1), FixedRates(0.2)),
        cost=half_square,
    )
    history = train(network, training_set, start, plan, epochs=6, chunk=6).history
    # A margin below one gives the turn away at every look to the greatest promise.
    assert_array_equal(history.rates[:, 0], np.where(history.rule == 0, 0.1, 0.2))


def test_the_least_reduction_ends_it(noisy: Noisy) -> None:
    schedule = Schedule(RULES, least_reduction=0.02, tolerated=4, switch=SwitchWhen(every=2))
    result = trained(noisy, schedule)
    assert bool(result.outcome == OUTCOMES.no_further_reduction)
    last = int(result.epochs)
    assert np.all(-np.diff(result.history.cost[last - 4 : last + 1]) < 0.02)


def test_side_by_side_as_alone(noisy: Noisy, rng: np.random.Generator) -> None:
    starts = rng.normal(size=(3, 10))
    schedule = Schedule(RULES, switch=SwitchWhen(every=3, margin=1.2))
    several = trained(noisy, schedule, start=starts)
    for number, start in enumerate(starts):
        one = trained(noisy, schedule, start=start)
        assert_array_equal(several.history.rule[number], one.history.rule)
        assert_allclose(several.history.cost[number], one.history.cost, rtol=1e-9)


def test_preference_needs_the_margin() -> None:
    switch = SwitchWhen(margin=2.0)
    for present, gains, expected in (
        (0, (0.1, 0.19), 0),
        (0, (0.1, 0.21), 1),
        (1, (0.1, 0.06), 1),
        (1, (0.1, 0.04), 0),
        (0, (0.0, 0.0), 0),
        (0, (0.0, 1e-9), 1),
    ):
        result = jax.jit(switch.preferred)(jnp.asarray(present), jnp.asarray(gains))
        assert int(result) == expected, (present, gains)


def test_refused(noisy: Noisy) -> None:
    with pytest.raises(ValueError, match=r"^schedule: a switch needs two rules or more, got one$"):
        Schedule(RULES[:1], switch=SwitchWhen())
    with pytest.raises(ValueError, match="an epoch or more between looks, got 0"):
        SwitchWhen(every=0)
    with pytest.raises(ValueError, match=r"a margin above zero, got 0\.0"):
        SwitchWhen(margin=0.0)

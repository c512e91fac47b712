"""Rates: 6.3.1 number by number, what a parabola makes of it, and trials that come to nothing."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import AdaptedRates, Backpropagation, FixedRates, Plan


NAN, INF = float("nan"), float("inf")
CostAt = Callable[[np.ndarray], float]


def literally(
    cost: CostAt, rates: Sequence[float], step: float = 0.1, gain: float = 0.08
) -> list[float]:
    """6.3.1 for one rate after the other, each by the reduction that it brings about itself."""
    adapted: list[float] = []
    for layer in range(len(rates)):

        def with_rate(rate: float, layer: int = layer) -> float:
            trial = np.array(rates)
            trial[layer] = rate
            return cost(trial)

        now = rates[layer]
        reduction = with_rate(0.0) - with_rate(now)
        further = with_rate(now) - with_rate(now + step * now)
        if reduction > 0 and further >= gain * reduction:
            adapted.append(now * (1 + step))
        elif with_rate(now - step * now) < with_rate(now):
            adapted.append(now * (1 - step))
        else:
            adapted.append(now)
    return adapted


def adapted(rates: AdaptedRates, cost: CostAt, now: Sequence[float]) -> np.ndarray:
    """The library's, given the costs of the trials that it asks for."""
    present = jnp.asarray(now)
    after = [cost(np.asarray(trial)) for trial in rates.trials(present)]
    before = cost(np.zeros(len(now)))
    return np.asarray(rates.adapted(present, jnp.asarray(before), jnp.asarray(after)))


def bowl(rng: np.random.Generator, groups: int) -> CostAt:
    """A quadratic cost of the steps, coupled between layers, downhill from zero in most."""
    factor = rng.normal(size=(groups, groups))
    curvature = factor @ factor.T + 0.1 * np.eye(groups)
    slope = rng.uniform(-0.3, 2.0, groups)
    return lambda rates: float(7.0 - slope @ rates + rates @ curvature @ rates)


@pytest.mark.parametrize("groups", [1, 5])
@pytest.mark.parametrize(("step", "gain"), [(0.1, 0.08), (0.3, 0.2)])
def test_the_literal_rule(rng: np.random.Generator, groups: int, step: float, gain: float) -> None:
    seen: set[str] = set()
    for _ in range(60):
        cost, now = bowl(rng, groups), list(10 ** rng.uniform(-2.5, 0.5, groups))
        expected = literally(cost, now, step, gain)
        assert_allclose(adapted(AdaptedRates(1.0, step, gain), cost, now), expected, rtol=1e-14)
        seen |= {
            "up" if b > a else "down" if b < a else "stays"
            for a, b in zip(now, expected, strict=True)
        }
    assert seen == {"up", "down", "stays"}


def test_each_layer_by_its_own_gain() -> None:
    """Of five layers that gain the same, none adds 8 % to the whole; each adds it to its own."""

    def cost(rates: np.ndarray) -> float:
        return float(np.sum((1.0 - rates) ** 2))

    assert_allclose(adapted(AdaptedRates(1.0), cost, [0.1] * 5), [0.11] * 5)
    # One of them alone is where the others are not.
    now = [0.1, 1.5, 0.5, 0.0, 0.1]
    assert_allclose(adapted(AdaptedRates(1.0), cost, now), [0.11, 1.35, 0.5, 0.0, 0.11])


def test_a_parabola_s_bounds() -> None:
    """Up to 31 % of the best rate, down from 105 %: 4 / 13 and 20 / 19 exactly."""
    up, down = 4 / 13, 20 / 19
    best = 3.0

    def factor(part: float) -> float:
        def cost(rates: np.ndarray) -> float:
            return float(5.0 + (rates[0] / best - 1.0) ** 2)

        return float(adapted(AdaptedRates(1.0), cost, [part * best])[0]) / (part * best)

    for part, expected in (
        (0.01, 1.1),
        (up - 1e-6, 1.1),
        (up + 1e-6, 1.0),
        (1.0, 1.0),
        (down - 1e-6, 1.0),
        (down + 1e-6, 0.9),
        (3.0, 0.9),
    ):
        assert_allclose(factor(part), expected, rtol=1e-12, err_msg=f"at {part} of the best")


def test_trials_of_one_layer_and_of_several() -> None:
    assert_allclose(AdaptedRates(1.0).trials(jnp.asarray([2.0]))[:, 0], [2.0, 2.2, 1.8])
    trials = np.asarray(AdaptedRates(1.0).trials(jnp.asarray([1.0, 2.0])))
    assert_allclose(trials[0], [1.0, 2.0])  # the present ones first
    assert_allclose(trials[1:3], [[1.1, 2.0], [1.0, 2.2]])
    assert_allclose(trials[3:5], [[0.9, 2.0], [1.0, 1.8]])
    assert_allclose(trials[5:], [[0.0, 2.0], [1.0, 0.0]])  # each without its own part


@pytest.mark.parametrize(
    ("present", "higher", "lower", "expected"),
    [
        (1.0, NAN, 0.9, 0.9),  # a trial that is no number gains nothing
        (1.0, INF, 1.1, 1.0),
        (1.0, 0.5, NAN, 1.1),
        (1.0, NAN, NAN, 1.0),
        (NAN, NAN, NAN, 0.9),  # too large already
        (INF, INF, INF, 0.9),
        (NAN, 0.5, 0.5, 0.9),
        (3.0, 2.0, 3.5, 1.0),  # a step that gains nothing is no ground to go up
    ],
)
def test_trials_that_are_no_numbers(
    present: float, higher: float, lower: float, expected: float
) -> None:
    after = jnp.asarray([present, higher, lower])
    result = AdaptedRates(1.0).adapted(jnp.asarray([1.0]), jnp.asarray(2.0), after)
    assert_allclose(result, [expected])


def test_one_layer_s_nan_leaves_the_others() -> None:
    def cost(rates: np.ndarray) -> float:
        return NAN if rates[0] > 1.05 else float(np.sum((rates - 1.0) ** 2))

    assert_allclose(adapted(AdaptedRates(1.0), cost, [1.0, 0.1]), [1.0, 0.11])


def test_a_layer_that_does_not_learn_keeps_its_zero(rng: np.random.Generator) -> None:
    result = adapted(AdaptedRates(1.0), bowl(rng, 3), [0.0, 0.01, 0.0])
    assert_array_equal(result[[0, 2]], [0.0, 0.0])


@pytest.mark.parametrize(
    ("with_present", "jointly", "expected", "moves"),
    [
        (1.5, 1.9, [1.1, 0.9], True),  # gains at once: as adapted
        (1.5, 2.0, [1.1, 0.9], True),
        (1.5, 2.1, [1.0, 1.0], True),  # each for itself would gain, all at once not
        (1.5, NAN, [1.0, 1.0], True),
        (2.1, 2.1, [0.9, 0.81], False),  # neither: wait until rates are lower
    ],
)
def test_rates_that_are_stable_together(
    with_present: float, jointly: float, expected: list[float], moves: bool
) -> None:
    def costs_after(trials: jax.Array) -> jax.Array:
        if len(trials) == 1:
            assert_allclose(trials, [[1.1, 0.9]])
            return jnp.asarray([jointly])
        # The first rate gains by going up, the second by going down; both gain as they are.
        return with_present + jnp.asarray([0.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])

    at, moved = AdaptedRates(1.0).choose(jnp.ones(2), jnp.asarray(2.0), costs_after)
    assert_allclose(at, expected)
    assert bool(moved) == moves


@pytest.mark.parametrize("nothing", [NAN, INF])
def test_rates_without_a_cost_wait_lower(nothing: float) -> None:
    at, moved = AdaptedRates(1.0).choose(
        jnp.ones(2), jnp.asarray(2.0), lambda trials: jnp.full(len(trials), nothing)
    )
    assert_allclose(at, [0.81, 0.81])  # down for their own sake and down together
    assert not bool(moved)


@pytest.mark.parametrize(
    ("present", "lower", "expected", "moves"),
    [
        (2.1, 2.2, 1.0, True),  # 5 % more than before
        (2.2, 2.1, 0.9, True),  # 10 % more, and a lower rate 5 %
        (2.2, 2.3, 0.9, False),  # more than 8 % at every rate: wait until it is lower
        (2.3, 2.2, 0.81, False),
        (NAN, NAN, 0.81, False),
    ],
)
def test_one_rate_may_raise_the_cost_a_little(
    present: float, lower: float, expected: float, moves: bool
) -> None:
    """PERAL does not follow the slope of the cost, nor the gradient that of every cost."""
    after = jnp.asarray([present, 2.4, lower])
    at, moved = AdaptedRates(1.0).choose(jnp.ones(1), jnp.asarray(2.0), lambda trials: after)
    assert_allclose(at, [expected])
    assert bool(moved) == moves


def test_one_rate_alone_stays_stable(rng: np.random.Generator) -> None:
    """Gradient descent down a narrow valley: the rate outgrows the steep direction's limit."""
    curvature = np.array([1.0, 1e-3])
    weights, rate, costs = rng.normal(size=2), jnp.asarray([1e-2]), []
    for _ in range(400):
        slope = curvature * weights

        def after(trials: jax.Array, weights: np.ndarray = weights) -> jax.Array:
            moved = weights - np.asarray(trials) * (curvature * weights)
            return jnp.asarray(0.5 * np.sum(curvature * moved**2, axis=1))

        costs.append(float(after(jnp.zeros((1, 1)))[0]))
        rate, moves = AdaptedRates(1e-2).choose(rate, jnp.asarray(costs[-1]), after)
        weights = weights - float(rate[0]) * slope if bool(moves) else weights
    assert max(np.array(costs[1:]) / np.array(costs[:-1])) <= 1.08 + 1e-12
    assert costs[-1] < 0.2 * costs[0]


def test_no_rate_falls_below_its_floor() -> None:
    rates, now = AdaptedRates(np.array([1.0, 2.0]), floor=0.01), jnp.asarray([0.01, 0.0202])
    adapted = rates.adapted(now, jnp.asarray(1.0), jnp.full(7, NAN))
    assert_allclose(adapted, [0.01, 0.02])
    waiting, _ = rates.choose(now, jnp.asarray(1.0), lambda trials: jnp.full(len(trials), 2.0))
    assert_allclose(waiting, [0.01, 0.02])


def test_fixed_rates() -> None:
    rates, present = FixedRates(0.3), jnp.asarray([0.3, 0.4])
    training_set, moves = rates.choose(present, jnp.asarray(1.0), lambda trials: trials[:, 0] * NAN)
    assert_array_equal(training_set, present)
    assert bool(moves)


def test_transforms(rng: np.random.Generator) -> None:
    """Eager, jit and vmap agree."""
    rates = AdaptedRates(1.0)
    now, before = jnp.asarray(rng.uniform(0.1, 1, (4, 2))), jnp.asarray(rng.uniform(2, 3, 4))
    after = jnp.asarray(rng.uniform(0, 3, (4, 7)))
    rule_rates = [rates.adapted(*row) for row in zip(now, before, after, strict=True)]
    assert_array_equal(jax.jit(jax.vmap(rates.adapted))(now, before, after), jnp.stack(rule_rates))


def test_a_plan_s_rates() -> None:
    """A tenth up, a tenth down and 8 % by default; one set for every rule, or one for each."""
    plan = Plan(Backpropagation())
    (only,) = plan.rates
    assert isinstance(only, AdaptedRates)
    assert (only.step, only.gain) == (0.1, 0.08)

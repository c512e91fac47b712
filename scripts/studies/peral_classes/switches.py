"""Backpropagation, PERAL, PERAL from many epochs of backpropagation on, and the indicator."""

import dataclasses
import time
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxcslc.training import (
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    History,
    Plan,
    Schedule,
    SwitchWhen,
    TrainingState,
    half_square,
    training_steps,
)
from scripts.studies.peral_classes.classes import Problem


# Both rules start with a share of the rate that gains most in their first epoch: as high as 6.3.1's
# rule raises the rate of a parabolic cost.
LADDER, STABLE = tuple(2.0**power for power in range(-16, 10)), 4 / 13
RULES: tuple[AbstractRule, AbstractRule] = (Backpropagation(), PERAL())
FIRST_SWITCH, GROWTH = 2, 1.45
REPEATS = 7
EPOCHS_TIMED = 20


@dataclasses.dataclass(frozen=True)
class Curves:
    """Costs before each epoch, of every seed.

    - `backpropagation`: alone, from the start.
    - `after`: of PERAL after each of `switches`, (seeds, switches, epochs).
    """

    backpropagation: Float[np.ndarray, "seeds epochs"]
    switches: Int[np.ndarray, " switches"]
    after: Float[np.ndarray, "seeds switches tuning"]


@dataclasses.dataclass(frozen=True)
class Guided:
    """Trainings that an indicator leads: cost before, and rule of, each epoch."""

    cost: Float[np.ndarray, "seeds epochs"]
    rule: Int[np.ndarray, "seeds epochs"]


def switch_epochs(epochs: int) -> Int[np.ndarray, " switches"]:
    """Return the epochs of switches: dense at first, and ever rarer up to half of the epochs."""
    powers = GROWTH ** np.arange(100)
    rounded = np.unique(np.round(FIRST_SWITCH * powers).astype(int))
    return np.concatenate([[0], rounded[rounded <= epochs // 2]])


def plan_of(rule: AbstractRule) -> Plan:
    """One rule alone."""
    return Plan(rule, AdaptedRates(jnp.asarray(1.0)), cost=half_square, patience=10**6)


def guided_plan(switch: SwitchWhen) -> Plan:
    """Return both rules, led by an indicator."""
    schedule = Schedule(RULES, switch=jax.tree.map(jnp.asarray, switch))
    rates = tuple(AdaptedRates(jnp.asarray(1.0)) for _ in RULES)
    return Plan(schedule, rates, cost=half_square, patience=10**6)


@eqx.filter_jit
def first_rates(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    examples: Examples,
    weights: Float[Array, "seeds trainings weights"],
) -> Float[Array, "seeds trainings"]:
    """The share `STABLE` of the rate that leaves the cost lowest after an epoch."""
    learning = (True,) * len(network.groups)

    def one(patterns: Examples, w: Array) -> Array:
        change = jnp.sum(patterns.change(network, rule, w, learning), axis=0)

        def after(rate: Array) -> Array:
            return patterns.costs(network, w + rate * change, half_square)[0]

        costs = jax.lax.map(after, jnp.asarray(LADDER))
        lowest = jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf))
        return STABLE * jnp.asarray(LADDER)[lowest]

    return jax.lax.map(
        lambda pair: jax.vmap(lambda w: one(pair[0], w))(pair[1]), (examples, weights)
    )


def states(
    network: AdaptiveNetwork,
    plan: Plan,
    weights: Float[Array, "seeds trainings weights"],
    rates: Float[Array, "seeds trainings rules"],
) -> TrainingState:
    """Trainings before their first epoch, with first rates of each rule."""
    lead = weights.shape[:2]
    flat = weights.reshape(-1, weights.shape[-1])
    keys = jax.random.split(jax.random.key(0), len(flat))
    state = jax.vmap(lambda w, key: TrainingState.first(network, plan, w, key))(flat, keys)
    rows = jnp.broadcast_to(rates.reshape(len(flat), -1, 1), state.rates.shape)
    state = eqx.tree_at(lambda s: s.rates, state, rows)
    return jax.tree.map(lambda x: x.reshape(*lead, *x.shape[1:]), state)


@eqx.filter_jit
def side_by_side(
    network: AdaptiveNetwork,
    plan: Plan,
    examples: Examples,
    state: TrainingState,
    epochs: int,
    keep_weights: bool,
) -> History:
    """Every seed's trainings side by side, (seeds, trainings, epochs)."""

    def of_seed(pair: tuple[Examples, TrainingState]) -> History:
        patterns, several = pair
        return jax.vmap(
            lambda one: training_steps(network, plan, patterns, None, one, epochs, keep_weights)[1]
        )(several)

    return jax.lax.map(of_seed, (examples, state))


def alone(
    problem: Problem, rule: AbstractRule, weights: Array, epochs: int, *, keep_weights: bool = False
) -> History:
    """One rule from weights of every seed, (seeds, trainings, weights)."""
    network, plan = problem.network, plan_of(rule)
    rates = first_rates(network, rule, problem.examples, weights)[..., None]
    state = states(network, plan, weights, rates)
    return side_by_side(network, plan, problem.examples, state, epochs, keep_weights)


def curves(problem: Problem, epochs: int, tuning: int) -> Curves:
    """Backpropagation, and PERAL from every switch on."""
    record = alone(problem, RULES[0], problem.starts[:, None], epochs, keep_weights=True)
    assert record.weights is not None
    switches = switch_epochs(epochs)
    at_switches = jnp.asarray(record.weights[:, 0, switches])
    after = alone(problem, RULES[1], at_switches, tuning)
    return Curves(np.asarray(record.cost)[:, 0], switches, np.asarray(after.cost))


def backpropagation_curve(problem: Problem, epochs: int) -> Float[np.ndarray, "seeds epochs"]:
    """The costs of backpropagation alone, where PERAL cannot follow."""
    return np.asarray(alone(problem, RULES[0], problem.starts[:, None], epochs).cost)[:, 0]


def guided(problem: Problem, switch: SwitchWhen, epochs: int) -> Guided:
    """Return both rules from the start, led by an indicator."""
    network, plan = problem.network, guided_plan(switch)
    rates = jnp.stack(
        [first_rates(network, rule, problem.examples, problem.starts[:, None]) for rule in RULES],
        axis=-1,
    )
    state = states(network, plan, problem.starts[:, None], rates)
    record = side_by_side(network, plan, problem.examples, state, epochs, False)
    return Guided(np.asarray(record.cost)[:, 0], np.asarray(record.rule)[:, 0])


def seconds_of(problem: Problem) -> dict[str, float]:
    """Time of an epoch of one training alone, by rule, and of a look of the indicator [s].

    The quickest of several, taken by turns, so that other work on the machine slows all alike.
    """
    network, patterns = problem.network, problem.of_seed(0)
    always = SwitchWhen(every=1, margin=1e30)
    plans = {rule.name: plan_of(rule) for rule in RULES if not rule.check_network(network)}
    if len(plans) == 2:
        # Looks after 0, 1, 3, 7 and 15 epochs, and no switch.
        plans["look"] = guided_plan(always)
    calls = {name: _timed(network, plan, patterns, problem) for name, plan in plans.items()}
    least = quickest(calls)
    seconds = {name: value / EPOCHS_TIMED for name, value in least.items() if name != "look"}
    if "look" in least:
        looks = int(np.log2(EPOCHS_TIMED)) + 1
        seconds["look"] = max(0.0, least["look"] - least[RULES[0].name]) / looks
    return seconds


def _timed(
    network: AdaptiveNetwork, plan: Plan, patterns: Examples, problem: Problem
) -> Callable[[], object]:
    rates = jnp.full((1, 1, len(plan.schedule.rules)), 1e-9)  # too small to change anything
    state = states(network, plan, problem.starts[:1, None], rates)
    one = jax.tree.map(lambda x: x[0, 0], state)
    return lambda: training_steps(network, plan, patterns, None, one, EPOCHS_TIMED)


def quickest(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """The shortest time of each call, taken by turns [s]."""
    for call in calls.values():
        jax.block_until_ready(call())
    least = dict.fromkeys(calls, np.inf)
    for _ in range(REPEATS):
        for name, call in calls.items():
            start = time.perf_counter()
            jax.block_until_ready(call())
            least[name] = min(least[name], time.perf_counter() - start)
    return least


def first_at_most(
    cost: Float[np.ndarray, "*lead epochs"], goal: Float[np.ndarray, "*lead"]
) -> Float[np.ndarray, "*lead"]:
    """Epochs until each cost is at its goal or below for the first time, or infinity."""
    reached = cost <= goal[..., None]
    return np.where(reached.any(axis=-1), np.argmax(reached, axis=-1), np.inf)


def look_count(epochs: float, every: int, rule: Sequence[int]) -> int:
    """How many looks an indicator took before an epoch: rarer and rarer while the rule stays."""
    wait = interval = 0
    looks, present = 0, 0
    for epoch in range(int(epochs)):
        if wait == 0:
            looks += 1
            changed = rule[epoch] != present
            present = rule[epoch]
            interval = every if changed or interval == 0 else 2 * interval
            wait = interval
        wait -= 1
    return looks

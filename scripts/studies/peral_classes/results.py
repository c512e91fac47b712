"""Rows of a class and a noise: epochs to goals by method, and what an epoch takes."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxcslc.training import (
    PERAL,
    Backpropagation,
    FixedRates,
    PerceptronRule,
    Plan,
    SwitchWhen,
    mean_modulus,
    train,
)
from scripts.studies.peral_classes import alternatives
from scripts.studies.peral_classes.classes import Problem
from scripts.studies.peral_classes.switches import (
    backpropagation_curve,
    curves,
    first_at_most,
    guided,
    look_count,
    quickest,
    seconds_of,
)


BACKPROPAGATION, PERAL_RULE = "backpropagation", "PERAL"
DIRECT, PERCEPTRON = "direct solve", "perceptron rule"
# Error beyond the least, root mean square, in parts of the targets' standard deviation.
GOALS = (0.3, 0.1, 0.03)


def least_costs(problem: Problem) -> Float[np.ndarray, " seeds"]:
    """The least cost of every seed: of the direct solve, or of Levenberg-Marquardt from the weights
    that meet the targets without noise.
    """
    network = problem.network
    if problem.linear:
        sets = [problem.of_seed(seed) for seed in range(len(problem.starts))]
        best = [alternatives.direct_solution(network, patterns) for patterns in sets]
        costs = [
            alternatives.cost_of(network, patterns, jnp.asarray(weights))
            for patterns, weights in zip(sets, best, strict=True)
        ]
        return np.array([float(cost) for cost in costs])
    assert problem.optima is not None
    costs, _ = alternatives.costs_by_step(
        alternatives.LEVENBERG_MARQUARDT,
        jnp.zeros(()),
        network,
        problem.examples,
        problem.optima,
        30,
    )
    return np.min(np.asarray(costs), axis=1)


def goals_of(problem: Problem) -> Float[np.ndarray, "goals seeds"]:
    """Costs that the goals ask for."""
    variance = 0.5 * problem.network.outputs_count * problem.deviation**2
    return least_costs(problem) + np.square(GOALS)[:, None] * variance


def rule_row(problem: Problem, epochs: int, tuning: int) -> dict[str, Any]:
    """Epochs of both rules, and of PERAL after every switch, to the goals."""
    goals = goals_of(problem)
    seconds = seconds_of(problem)
    reason = PERAL().check_network(problem.network)
    if reason is not None:
        cost = backpropagation_curve(problem, epochs)
        reached = [first_at_most(cost, goal).tolist() for goal in goals]
        return {"refused": reason, "seconds": seconds, BACKPROPAGATION: reached}
    of_rules = curves(problem, epochs, tuning)
    count = of_rules.after.shape[1]
    return {
        "refused": "",
        "seconds": seconds,
        BACKPROPAGATION: [first_at_most(of_rules.backpropagation, g).tolist() for g in goals],
        "switches": of_rules.switches.tolist(),
        # (goals, seeds, switches)
        "after": [
            first_at_most(of_rules.after, np.repeat(goal[:, None], count, 1)).tolist()
            for goal in goals
        ],
    }


def guided_row(problem: Problem, switch: SwitchWhen, epochs: int) -> dict[str, Any]:
    """Epochs by rule, and looks, that the indicator takes to the goals: (goals, seeds, 3)."""
    if PERAL().check_network(problem.network) is not None:
        return {"guided": None}
    led = guided(problem, switch, epochs)
    reached = [first_at_most(led.cost, goal) for goal in goals_of(problem)]
    return {"guided": [guided_counts(led.rule, r, int(switch.every)) for r in reached]}


def guided_counts(
    rule: np.ndarray, reached: Float[np.ndarray, " seeds"], every: int
) -> list[list[float]]:
    """Epochs of both rules and looks to a goal, infinite where it was not reached."""
    counts: list[list[float]] = []
    for of_seed, epochs in zip(rule, reached, strict=True):
        if not np.isfinite(epochs):
            counts.append([np.inf, np.inf, np.inf])
            continue
        used = of_seed[: int(epochs)]
        looks = look_count(epochs, every, of_seed.tolist())
        counts.append([float(np.sum(used == 0)), float(np.sum(used == 1)), float(looks)])
    return counts


def alternative_row(problem: Problem, epochs: int) -> dict[str, Any]:
    """Steps of other methods to the goals, seconds a step, and the best learning rates."""
    network, goals = problem.network, goals_of(problem)
    row: dict[str, Any] = {"steps": {}, "seconds": {}, "rates": {}}
    one = jax.tree.map(lambda x: x[:1], problem.examples)
    calls: dict[str, Callable[[], object]] = {}
    count: dict[str, int] = {}
    for kind, share in alternatives.STEPS.items():
        steps = count[kind] = max(2, round(share * epochs))
        rates = alternatives.LEARNING_RATES.get(kind, (0.0,))
        by_rate = {
            rate: np.asarray(
                alternatives.costs_by_step(
                    kind, jnp.asarray(rate), network, problem.examples, problem.starts, steps
                )[0]
            )
            for rate in rates
        }
        to_goals = {
            rate: [first_at_most(cost, goal) for goal in goals] for rate, cost in by_rate.items()
        }
        best = [
            min(rates, key=lambda rate, i=i: _rank(to_goals[rate][i])) for i in range(len(goals))
        ]
        row["steps"][kind] = [to_goals[rate][i].tolist() for i, rate in enumerate(best)]
        row["rates"][kind] = best
        calls[kind] = lambda kind=kind, rate=best[1], steps=steps: alternatives.costs_by_step(
            kind, jnp.asarray(rate), network, one, problem.starts[:1], steps
        )
    if problem.linear:
        patterns = problem.of_seed(0)
        calls[DIRECT] = lambda: alternatives.direct_solution(network, patterns)
        row["steps"][DIRECT] = np.ones(goals.shape).tolist()
    least = quickest(calls)
    row["seconds"] = {kind: value / count.get(kind, 1) for kind, value in least.items()}
    return row


def _rank(steps: Float[np.ndarray, " seeds"]) -> tuple[float, float]:
    """Rank by median; among equals, by how many never arrive."""
    return float(np.median(steps)), float(np.sum(np.isinf(steps)))


def hard_limiter_row(problem: Problem, epochs: int) -> dict[str, Any]:
    """Epochs of the perceptron rule until no pattern is wrong, in random order."""
    plan = Plan(
        PerceptronRule(), FixedRates(0.5), cost=mean_modulus, order="sequential", patience=epochs
    )
    training = train(
        problem.network, problem.examples, problem.starts, plan, epochs=epochs, keep_weights=False
    )
    ended = np.asarray(training.cost) == 0.0
    reached = np.where(ended, np.asarray(training.epochs), np.inf)
    reasons = [rule.check_network(problem.network) for rule in (Backpropagation(), PERAL())]
    return {"refused": "; ".join(filter(None, reasons)), PERCEPTRON: reached.tolist()}


def seconds_by_switch(
    row: dict[str, Any], goal: int
) -> tuple[Float[np.ndarray, " seeds"], Float[np.ndarray, "seeds switches"]]:
    """Time to a goal of backpropagation alone, and with PERAL from each switch on [s].

    A switch after backpropagation has reached the goal counts as backpropagation alone.
    """
    seconds = row["seconds"]
    first = np.array(row[BACKPROPAGATION][goal]) * seconds[BACKPROPAGATION]
    switches = np.array(row["switches"])
    after = np.array(row["after"][goal])
    total = switches * seconds[BACKPROPAGATION] + after * seconds[PERAL_RULE]
    before = np.array(row[BACKPROPAGATION][goal])[:, None] <= switches
    return first, np.where(before, first[:, None], total)


def guided_seconds(
    row: dict[str, Any], led: dict[str, Any], goal: int
) -> Float[np.ndarray, " seeds"]:
    """Time to a goal under the indicator, its looks included [s].

    **Arguments**

    - `row`: of the rules, which has the time of an epoch.
    - `led`: of the indicator.
    """
    seconds = row["seconds"]
    durations = [seconds[name] for name in (BACKPROPAGATION, PERAL_RULE, "look")]
    counts = np.array(led["guided"][goal])
    arrived = np.asarray(np.isfinite(counts).all(axis=1))
    return np.where(arrived, np.where(arrived[:, None], counts, 0.0) @ durations, np.inf)


def best_seconds(row: dict[str, Any], goal: int) -> Float[np.ndarray, " seeds"]:
    """Time to a goal with the best switch in hindsight, which may be none [s]."""
    alone, switched = seconds_by_switch(row, goal)
    return np.minimum(alone, switched.min(axis=1))


def over_best(row: dict[str, Any], led: dict[str, Any], goal: int) -> Float[np.ndarray, " seeds"]:
    """The indicator's time over that of the best switch in hindsight."""
    best = best_seconds(row, goal)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = guided_seconds(row, led, goal) / best
    # Where nothing arrives, there is nothing to compare; a goal that the start meets takes no time.
    return np.where(np.isinf(best) | (best == 0), np.nan, ratio)


def median_of(values: Sequence[float] | np.ndarray) -> float:
    """Median, infinity being a number like others, NaN left out."""
    numbers = np.asarray(values, float)
    numbers = numbers[~np.isnan(numbers)]
    return float(np.quantile(numbers, 0.5, method="inverted_cdf")) if numbers.size else np.nan

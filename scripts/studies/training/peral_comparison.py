"""The two problems of Section 6.3, trained by both rules from one hand-over."""

import argparse
import dataclasses
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.training import (
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Cost,
    Examples,
    Plan,
    Training,
    examples,
    fully_connected,
    inverse_dynamics,
    mean_modulus,
    normal_equations,
    train,
)
from scripts.studies import command
from scripts.studies.training.peral_operations import BACKPROPAGATION, PERAL_RULE, seconds_per_epoch


RULES: dict[str, AbstractRule] = {BACKPROPAGATION: Backpropagation(), PERAL_RULE: PERAL()}
START = {"ultrasound": 0.5, "PUMA 560": 0.1}  # weights are drawn from ± this
BACKPROPAGATION_RATE = 1e-3  # to start with: small (7.5)
# PERAL starts with a share of the rate that gains most in an epoch: as high as 6.3.1's rule raises
# the rate of a parabolic cost.
LADDER, STABLE = tuple(0.01 * 2.0**step for step in range(14)), 0.31
HAND_OVER_CORRECT = 0.30
CORRECT = (0.40, 0.45, 0.50)
PARTS = (0.25, 0.50, 0.75)


@dataclasses.dataclass(frozen=True)
class Problem:
    """A network and its patterns.

    - `examples`: of all seeds, or of each with a leading axis; `first`: of the first seed.
    - `comparison`: patterns that no training sees (6.3.1), if there are any.
    """

    name: str
    variant: str
    network: AdaptiveNetwork
    examples: Examples
    first: Examples
    comparison: Examples | None = None


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Both rules on one problem, all seeds.

    - `hand_over`: epochs of backpropagation alone, NaN if it never reached the hand-over.
    - `curves`: by rule, (seeds, epochs): backpropagation from the start, PERAL from the hand-over.
    - `goals`: by name, (seeds,), values that the curves are to fall to.
    - `epochs`: by rule and goal, (seeds,), from the hand-over; infinite if never.
    - `ended`: by rule, the number of trainings for each outcome.
    - `seconds`: of an epoch, by rule.
    - `rate`: PERAL's first.
    - `at_hand_over`, `at_end`: weights at the hand-over, and at the end of each rule.
    """

    problem: Problem
    hand_over: Float[np.ndarray, " seeds"]
    curves: dict[str, Float[np.ndarray, "seeds epochs"]]
    goals: dict[str, Float[np.ndarray, " seeds"]]
    epochs: dict[str, dict[str, Float[np.ndarray, " seeds"]]]
    ended: dict[str, dict[str, int]]
    seconds: dict[str, float]
    rate: float
    at_hand_over: Float[Array, "seeds weights"]
    at_end: dict[str, Float[Array, "seeds weights"]]


def wrong(errors: Float[Array, "kinds patterns"], mask: Float[Array, "kinds patterns"]) -> Array:
    """Share of patterns for which the winner of the outputs is not the right kind.

    Targets are 1 for the right kind and -1 for others and outputs lie between, so that only the
    right kind's error is above zero: the errors determine the targets.
    """
    right = jnp.argmax(errors, axis=0)
    targets = jnp.where(jnp.arange(errors.shape[0])[:, None] == right[None, :], 1.0, -1.0)
    used = jnp.any(mask > 0, axis=0)
    missed = (jnp.argmax(targets - errors, axis=0) != right) & used
    return jnp.sum(missed) / jnp.maximum(jnp.sum(used), 1)


def ultrasound(patterns: int, *, centred: bool) -> Problem:
    """The 25+1 to 10 network of Fig. 6.3-2, and equal shares of patterns of each kind.

    All 1,850 comparison patterns are kept for comparison. Means are those of the training patterns.
    """
    scene = sim.ultrasound(seed=0)
    echoes, others = scene.training, scene.comparison
    by_kind = [np.flatnonzero(echoes.kind == kind) for kind in range(len(echoes.kinds))]
    rows = np.concatenate([rows[: max(1, patterns // len(by_kind))] for rows in by_kind])
    mean = echoes.inputs[rows].mean(axis=0) if centred else np.zeros(echoes.inputs.shape[1])
    network = fully_connected([len(mean), len(by_kind)], "hyperbolic tangent")
    training_set, comparison = (
        examples(network, jnp.asarray(inputs - mean), jnp.asarray(targets))
        for inputs, targets in (
            (echoes.inputs[rows], echoes.targets[rows]),
            (others.inputs, others.targets),
        )
    )
    variant = "inputs centred" if centred else "inputs as they are"
    return Problem("ultrasound", variant, network, training_set, training_set, comparison)


def puma(patterns: int, noise: float, seeds: int) -> Problem:
    """The CSLC, and true motions and torques with noise of so much of their standard deviation."""
    _, truth = sim.simulate(sim.puma560(), sim.training(), seed=0)
    network = inverse_dynamics(jc.derive(jc.puma560()))
    every = max(1, len(truth.time) // patterns)
    columns = (truth.position, truth.velocity, truth.acceleration, truth.torque)

    def one(seed: int) -> Examples:
        rng = np.random.default_rng([seed, 1])
        q, qd, qdd, torque = (
            jnp.asarray((x + noise * x.std(axis=0) * rng.standard_normal(x.shape))[::every])
            for x in columns
        )
        return examples(network, (q, qd, qdd), torque)

    by_seed = [
        one(seed) for seed in command.progress(range(seeds), desc=f"noise {noise:g}", unit="seed")
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *by_seed)
    return Problem("PUMA 560", f"noise {noise:.0%}", network, stacked, by_seed[0])


def starts(problem: Problem, seeds: int) -> Float[Array, "seeds weights"]:
    """Random weights, the same for a seed whatever the number of seeds."""
    reach = START[problem.name]
    rows = [
        np.random.default_rng([seed, 0]).uniform(-reach, reach, problem.network.size)
        for seed in range(seeds)
    ]
    return jnp.asarray(np.stack(rows))


def stable_rate(
    problem: Problem, weights: Float[Array, "seeds weights"], cost: Cost = mean_modulus
) -> float:
    """The share `STABLE` of the rate that leaves PERAL's cost lowest in an epoch."""
    network, axis = problem.network, 0 if problem.examples.targets.ndim == 3 else None
    learning = (True,) * len(network.groups)

    def after(of_seed: Examples, w: Array) -> Array:
        change = jnp.sum(of_seed.change(network, RULES[PERAL_RULE], w, learning), axis=0)
        return jax.lax.map(
            lambda rate: of_seed.costs(network, w + rate * change, cost)[0], jnp.asarray(LADDER)
        )

    costs = jax.jit(jax.vmap(after, in_axes=(axis, 0)))(problem.examples, weights)
    return STABLE * LADDER[int(np.argmin(np.median(np.asarray(costs), axis=0)))]


def first_at_most(
    curves: Float[np.ndarray, "seeds epochs"], goals: Float[np.ndarray, " seeds"]
) -> Float[np.ndarray, " seeds"]:
    """Epochs until each curve is at its goal or below for the first time, or infinity."""
    reached = curves <= goals[:, None]
    return np.where(reached.any(axis=1), np.argmax(reached, axis=1), np.inf)


def plans(measure: Any, rate: float, cost: Cost = mean_modulus, **more: Any) -> dict[str, Plan]:
    """One for each rule; numbers as arrays, so that plans that differ in them compile once."""
    rates = {
        BACKPROPAGATION: jnp.asarray(BACKPROPAGATION_RATE),
        PERAL_RULE: jnp.asarray(rate),
    }
    return {
        name: Plan(rule, AdaptedRates(rates[name]), cost=cost, measure=measure, **more)
        for name, rule in RULES.items()
    }


def compare_ultrasound(
    problem: Problem,
    options: argparse.Namespace,
    folder: Path,
    *,
    handed_over: float = HAND_OVER_CORRECT,
    cost: Cost = mean_modulus,
) -> Outcome:
    """Return both rules on the ultrasound scene, from a share of correct classifications on."""
    start = starts(problem, options.seeds)
    target = {"target": jnp.asarray(1.0 - CORRECT[-1])}
    until = 1.0 - handed_over
    plan = plans(wrong, 1.0, cost, **target)[BACKPROPAGATION]
    # The same epochs twice: up to the hand-over for the weights there, and through it.
    early = eqx.tree_at(lambda p: p.target, plan, jnp.asarray(until))
    first = run(problem, start, early, options.before, folder / f"{problem.variant}-first.npz")
    on = run(
        problem, start, plan, options.before + options.further, folder / f"{problem.variant}.npz"
    )
    rate = stable_rate(problem, first.weights, cost)
    by_peral = plans(wrong, rate, cost, **target)[PERAL_RULE]
    tuned = run(
        problem, first.weights, by_peral, options.tuning, folder / f"{problem.variant}-P.npz"
    )
    curves = {
        BACKPROPAGATION: np.asarray(on.history.measure),
        PERAL_RULE: np.asarray(tuned.history.measure),
    }
    reached = first_at_most(np.asarray(first.history.measure), np.full(options.seeds, until))
    goals = {f"{share:.0%} correct": np.full(options.seeds, 1.0 - share) for share in CORRECT}
    plan_of = {BACKPROPAGATION: plan, PERAL_RULE: by_peral}
    return outcome(problem, reached, curves, goals, (first, on, tuned), plan_of, rate)


def compare_puma(problem: Problem, options: argparse.Namespace, folder: Path) -> Outcome:
    """Return both rules on the PUMA 560, from a fixed number of epochs of backpropagation."""
    seeds = problem.examples.targets.shape[0]
    start = starts(problem, seeds)
    plan = plans(None, 1.0)[BACKPROPAGATION]
    before, after = folder / f"{problem.variant}-first.npz", folder / f"{problem.variant}.npz"
    first = run(problem, start, plan, options.hand_over, before)
    if not after.exists():  # goes on from the hand-over, its rates included
        shutil.copyfile(before, after)
    on = run(problem, start, plan, options.hand_over + options.further, after)
    rate = stable_rate(problem, first.weights)
    by_peral = plans(None, rate)[PERAL_RULE]
    tuned = run(
        problem, first.weights, by_peral, options.tuning, folder / f"{problem.variant}-P.npz"
    )
    curves = {
        BACKPROPAGATION: np.asarray(on.history.cost),
        PERAL_RULE: np.asarray(tuned.history.cost),
    }
    direct, start_cost = (
        moduli(problem, weights) for weights in (direct_solutions(problem), first.weights)
    )
    goals = {f"{part:.0%} of the way": start_cost + part * (direct - start_cost) for part in PARTS}
    reached = np.full(seeds, float(options.hand_over))
    plan_of = {BACKPROPAGATION: plan, PERAL_RULE: by_peral}
    return outcome(problem, reached, curves, goals, (first, on, tuned), plan_of, rate)


def run(
    problem: Problem, start: Float[Array, "seeds weights"], plan: Plan, epochs: int, file: Path
) -> Training:
    """A training of all seeds, with a checkpoint in a file."""
    rule = plan.schedule.rules[0].name
    print(f"{problem.name}, {problem.variant}: {rule}, up to {epochs} epochs", flush=True)
    return train(
        problem.network, problem.examples, start, plan, checkpoint=file, epochs=epochs,
        keep_weights=False, progress=True,
    )  # fmt: skip


def outcome(
    problem: Problem,
    hand_over: Float[np.ndarray, " seeds"],
    curves: dict[str, Float[np.ndarray, "seeds epochs"]],
    goals: dict[str, Float[np.ndarray, " seeds"]],
    trainings: tuple[Training, Training, Training],
    plan_of: Mapping[str, Plan],
    rate: float,
) -> Outcome:
    """Epochs and seconds to the goals, from the trainings before and after the hand-over."""
    first, on, tuned = trainings
    handed_over = np.isfinite(hand_over)
    beyond = np.array(curves[BACKPROPAGATION])
    # What lies before the hand-over does not count, should it have been lower.
    beyond[np.arange(beyond.shape[1]) < np.where(handed_over, hand_over, np.inf)[:, None]] = np.inf
    epochs = {
        BACKPROPAGATION: {k: first_at_most(beyond, v) - hand_over for k, v in goals.items()},
        PERAL_RULE: {k: first_at_most(curves[PERAL_RULE], v) for k, v in goals.items()},
    }
    epochs = {
        r: {k: np.where(handed_over, v, np.nan) for k, v in e.items()} for r, e in epochs.items()
    }
    seconds = {
        name: seconds_per_epoch(problem.network, plan, problem.first, first.weights[0])
        for name, plan in plan_of.items()
    }
    return Outcome(
        problem,
        np.where(handed_over, hand_over, np.nan),
        curves,
        goals,
        epochs,
        {BACKPROPAGATION: on.outcomes(), PERAL_RULE: tuned.outcomes()},
        seconds,
        rate,
        first.weights,
        {BACKPROPAGATION: on.weights, PERAL_RULE: tuned.weights},
    )


def correct(outcome: Outcome) -> list[dict[str, Any]]:
    """Shares of correct classifications of training and comparison patterns (6.3.1), by seed.

    At the hand-over and at the end of each rule's training, which is at the last goal where the
    training reached it; NaN for seeds that were not handed over.
    """
    problem = outcome.problem
    if problem.comparison is None:
        return []
    handed_over = np.isfinite(outcome.hand_over)

    def shares(patterns: Examples, weights: Array) -> list[float]:
        missed = jax.vmap(lambda w: patterns.costs(problem.network, w, wrong)[0])(weights)
        return np.where(handed_over, 1.0 - np.asarray(missed), np.nan).tolist()

    return [
        {
            "at": at,
            "training": shares(problem.examples, weights),
            "comparison": shares(problem.comparison, weights),
        }
        for at, weights in {"hand-over": outcome.at_hand_over, **outcome.at_end}.items()
    ]


def direct_solutions(problem: Problem) -> Float[Array, "seeds weights"]:
    """The least-squares weights of every seed's patterns."""
    return jax.vmap(lambda one: normal_equations(problem.network, one).solution())(problem.examples)


def moduli(problem: Problem, weights: Float[Array, "seeds weights"]) -> Float[np.ndarray, " seeds"]:
    """The mean error modulus of every seed's patterns [N m]."""
    return costs_of(problem, weights, mean_modulus)


def costs_of(problem: Problem, weights: Float[Array, "seeds weights"], cost: Any) -> np.ndarray:
    """A cost of every seed's patterns, (seeds,)."""

    def one(of_seed: Examples, w: Array) -> Array:
        return of_seed.costs(problem.network, w, cost)[0]

    return np.asarray(jax.vmap(one)(problem.examples, weights))

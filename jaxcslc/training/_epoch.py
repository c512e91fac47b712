"""One epoch of a training: assess, decide whether to go on and by which rule, and learn.

`TrainingState` is what passes from epoch to epoch, `History` is what is kept of epochs, and
`Training` is the result. `_train` runs epochs; `_plan` states the rules.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from ._examples import Examples
from ._network import AdaptiveNetwork
from ._plan import Plan, Turn, promise
from ._rules import AbstractRule


class OUTCOMES(eqx.Enumeration):
    """Outcome of a training; the members are the messages."""

    reached = ""
    no_further_reduction = ""
    stop_set = ""
    running = (
        "The training has not ended: it used up its epochs. Give it more, or end it by a target"
        " or a least reduction."
    )
    diverged = (
        "The training diverged: the cost grew beyond all bounds or became NaN. Start with smaller"
        " rates; the weights are those of the lowest cost."
    )
    stalled = (
        "The training stalled: no new lowest cost for as many epochs as `patience` says. The rates"
        " may be too large to settle, or too small to move."
    )


ENDINGS = {
    "reached the target": OUTCOMES.reached,
    "no further reduction": OUTCOMES.no_further_reduction,
    "stop set": OUTCOMES.stop_set,
    "not ended": OUTCOMES.running,
    "diverged": OUTCOMES.diverged,
    "stalled": OUTCOMES.stalled,
}
"""Outcomes of trainings, by their words."""


class History(eqx.Module):
    """A training epoch by epoch, as it stood before each epoch moved the weights.

    Leading axes are those of many trainings. From the end of a training on, its entries repeat.

    **Attributes**

    - `cost`: (..., epochs) of the training patterns.
    - `measure`: (..., epochs) what the target is compared with.
    - `stop_cost`: (..., epochs) of the stop set, NaN without one.
    - `rule`: (..., epochs) which of the schedule's rules learnt, -1 once it had ended.
    - `rates`: (..., epochs, groups) that it learnt with.
    - `weights`: (..., epochs, p), or none if they were not asked for.
    """

    cost: Float[Array | np.ndarray, "..."]
    measure: Float[Array | np.ndarray, "..."]
    stop_cost: Float[Array | np.ndarray, "..."]
    rule: Int[Array | np.ndarray, "..."]
    rates: Float[Array | np.ndarray, "... groups"]
    weights: Float[Array | np.ndarray, "... weights"] | None


class Training(eqx.Module):
    """The result of a training.

    **Attributes**

    - `weights`: (..., p): at the end; with a stop set, where that had its lowest cost (3.6.1);
      of a training that diverged, those of the lowest cost.
    - `rates`: (..., rules, groups) at the end.
    - `cost`: (...,) as the last epoch found it, before it moved the weights.
    - `epochs`: (...,) how many moved the weights.
    - `outcome`: a member of `OUTCOMES` for each.
    - `history`: epoch by epoch.
    """

    weights: Float[Array, "*trainings weights"]
    rates: Float[Array, "*trainings rules groups"]
    cost: Float[Array, "*trainings"]
    epochs: Int[Array, "*trainings"]
    outcome: OUTCOMES
    history: History

    def outcomes(self) -> dict[str, int]:
        """Return the number of trainings that ended in each way."""
        numbers = {
            name: int(np.sum(np.asarray(self.outcome == member)))
            for name, member in ENDINGS.items()
        }
        return {name: number for name, number in numbers.items() if number}

    def endings(self) -> tuple[str, ...]:
        """Return how each training ended, in the words of `ENDINGS`."""
        ended = {name: np.ravel(self.outcome == member) for name, member in ENDINGS.items()}
        names = np.select(list(ended.values()), list(ended), next(iter(ended)))
        return tuple(names.tolist())

    def __repr__(self) -> str:
        number = int(np.prod(jnp.shape(self.cost)))
        ended = ", ".join(f"{count} {name}" for name, count in self.outcomes().items())
        return f"Training({number} of {self.weights.shape[-1]} weights: {ended})"


class TrainingState(eqx.Module):
    """State of a training: all that the next epoch, or a resumed run, needs."""

    weights: Float[Array, " weights"]
    rates: Float[Array, "rules groups"]
    key: Key[Array, ""]
    epoch: Int[Array, ""]
    turn: Turn
    outcome: OUTCOMES
    # Changes with every epoch:
    cost: Float[Array, ""]
    # Set by the first:
    first_cost: Float[Array, ""]
    # Changes with a new lowest cost:
    lowest: Float[Array, ""]
    lowest_weights: Float[Array, " weights"]
    since_lowest: Int[Array, ""]
    # With a stop set only:
    stop_lowest: Float[Array, ""]
    stop_weights: Float[Array, " weights"]
    since_stop: Int[Array, ""]

    @classmethod
    def first(
        cls,
        network: AdaptiveNetwork,
        plan: Plan,
        weights: Float[Array, " weights"],
        key: Key[Array, ""],
    ) -> "TrainingState":
        infinite, zero = jnp.asarray(jnp.inf, weights.dtype), jnp.zeros((), int)
        return cls(
            weights=weights,
            rates=plan.first_rates(network).astype(weights.dtype),
            key=key,
            epoch=zero,
            turn=Turn.first(),
            outcome=OUTCOMES.running,
            cost=infinite,
            first_cost=infinite,
            lowest=infinite,
            lowest_weights=weights,
            since_lowest=zero,
            stop_lowest=infinite,
            stop_weights=weights,
            since_stop=zero,
        )

    @property
    def done(self) -> Bool[Array, "..."]:
        return self.outcome != OUTCOMES.running


def epoch(
    network: AdaptiveNetwork,
    plan: Plan,
    training_set: Examples,
    stop_set: Examples | None,
    state: TrainingState,
    keep_weights: bool,
    rule: int | None = None,
) -> tuple[TrainingState, History]:
    """Run one epoch: assess, decide whether to go on and by which rule, and learn.

    - `rule`: of trainings in step, the index of the rule that is to learn.
    """
    cost, measure = training_set.costs(network, state.weights, plan.cost, plan.measure or plan.cost)
    stop_cost = jnp.asarray(jnp.nan, cost.dtype)
    if stop_set is not None:
        (stop_cost,) = stop_set.costs(network, state.weights, plan.cost)

    preference = _preference(network, plan, training_set, state)
    assessed = _assessed(
        plan, state, preference, cost, measure, stop_cost, stop_set is not None, rule
    )
    weights, rates = _learnt(network, plan, training_set, assessed, rule)
    moved = eqx.tree_at(
        lambda s: (s.weights, s.rates, s.epoch),
        assessed,
        (weights, assessed.rates.at[assessed.turn.rule].set(rates), assessed.epoch + 1),
    )
    # A training that had ended before keeps everything as it was.
    next_state = jax.tree.map(
        lambda before, now, new: jnp.where(state.done, before, jnp.where(assessed.done, now, new)),
        state,
        assessed,
        moved,
    )
    at_rest = next_state.rates[next_state.turn.rule]
    record = History(
        cost=cost,
        measure=measure,
        stop_cost=stop_cost,
        rule=jnp.where(assessed.done, -1, assessed.turn.rule),
        rates=jnp.where(assessed.done, at_rest, rates),
        weights=state.weights if keep_weights else None,
    )
    return next_state, record


# The rule to go on with, and the rates of all rules.
_Preference = tuple[Int[Array, ""], Float[Array, "rules groups"]]


def _preference(
    network: AdaptiveNetwork,
    plan: Plan,
    training_set: Examples,
    state: TrainingState,
) -> _Preference:
    """The rule that the schedule's switch prefers, and rates for it; without one, the present."""
    switch, present = plan.schedule.switch, (state.turn.rule, state.rates)
    if switch is None:
        return present

    def look() -> _Preference:
        gains, best = promise(network, plan, training_set, state.weights, state.rates)
        rule = switch.preferred(state.turn.rule, gains)
        rows = [
            jnp.where((rule == at) & (rule != state.turn.rule), rates.taking_over(*pair), pair[0])
            for at, (rates, *pair) in enumerate(
                zip(plan.rule_rates, state.rates, best, strict=True)
            )
        ]
        return rule, jnp.stack(rows)

    return jax.lax.cond(state.turn.wait == 0, look, lambda: present)


def _assessed(
    plan: Plan,
    state: TrainingState,
    preference: _Preference,
    cost: Array,
    measure: Array,
    stop_cost: Array,
    stop_set: bool,
    commanded_rule: int | None,
) -> TrainingState:
    """The state with the cost of its weights known, whose turn it is, and whether it ended."""
    rule, rates = preference
    first = state.epoch == 0
    first_cost = jnp.where(first, cost, state.first_cost)
    new_lowest = cost < state.lowest
    since_lowest = jnp.where(new_lowest, 0, state.since_lowest + 1)
    if commanded_rule is not None:
        turn = later = state.turn.in_step(plan.schedule, commanded_rule, cost)
    elif plan.schedule.switch is None:
        later = state.turn.next(plan.schedule, cost, state.cost - cost)
        turn = jax.tree.map(lambda old, new: jnp.where(first, old, new), state.turn, later)
    else:
        turn = later = state.turn.switched(plan.schedule, rule, state.cost - cost)
    lowest_cost = jnp.where(new_lowest, cost, state.lowest)
    lowest_weights = jnp.where(new_lowest, state.weights, state.lowest_weights)
    # A rule takes over where the best so far was: PERAL, which follows no gradient, may have lost
    # in its bout what the one before had gained.
    takes_over = ~first & (later.rule != state.turn.rule) & (measure > plan.target)
    stop_new = stop_cost < state.stop_lowest
    since_stop = jnp.where(stop_new, 0, state.since_stop + 1)

    # The last to apply is the one that counts.
    outcome = state.outcome
    outcome = OUTCOMES.where(since_lowest >= plan.patience, OUTCOMES.stalled, outcome)
    outcome = OUTCOMES.where(turn.ended(plan.schedule), OUTCOMES.no_further_reduction, outcome)
    if stop_set:
        outcome = OUTCOMES.where(since_stop >= plan.stop_patience, OUTCOMES.stop_set, outcome)
    outcome = OUTCOMES.where(measure <= plan.target, OUTCOMES.reached, outcome)
    beyond = ~jnp.isfinite(cost) | (
        cost > plan.divergence * jnp.maximum(first_cost, jnp.finfo(float).tiny)
    )
    outcome = OUTCOMES.where(beyond, OUTCOMES.diverged, outcome)
    return TrainingState(
        weights=jnp.where(takes_over, lowest_weights, state.weights),
        rates=rates,
        key=state.key,
        epoch=state.epoch,
        turn=turn,
        outcome=outcome,
        cost=jnp.where(takes_over, lowest_cost, cost),
        first_cost=first_cost,
        lowest=lowest_cost,
        lowest_weights=lowest_weights,
        since_lowest=since_lowest,
        stop_lowest=jnp.where(stop_new, stop_cost, state.stop_lowest),
        stop_weights=jnp.where(stop_new, state.weights, state.stop_weights),
        since_stop=since_stop,
    )


def _learnt(
    network: AdaptiveNetwork,
    plan: Plan,
    training_set: Examples,
    state: TrainingState,
    commanded_rule: int | None,
) -> tuple[Float[Array, " weights"], Float[Array, " groups"]]:
    """The weights after the epoch, and the rates that led to them."""
    learning = plan.learning(network)

    def learn_by(number: int, weights: Array, rates: Array) -> tuple[Array, Array]:
        """An epoch of one rule at the rates that serve best."""
        rule = plan.schedule.rules[number]
        if plan.order == "batch":
            change = training_set.change(network, rule, weights, learning)

            def after(trial: Array) -> Array:
                return weights + trial @ change

            def costs_after(trials: Array) -> Array:
                return training_set.trial_costs(network, weights, change, trials, plan.cost)
        else:
            key = jax.random.fold_in(state.key, state.epoch)
            sequence = jax.random.permutation(key, training_set.targets.shape[-1])

            def after(trial: Array) -> Array:
                return _one_by_one(network, rule, training_set, weights, trial, sequence, learning)

            def costs_after(trials: Array) -> Array:
                candidates = jax.vmap(after)(trials)
                return jax.vmap(lambda w: training_set.costs(network, w, plan.cost)[0])(candidates)

        at, moves = plan.rule_rates[number].choose(rates, state.cost, costs_after)
        return jnp.where(moves, after(at), weights), at

    branches = [partial(learn_by, number) for number in range(len(plan.schedule.rules))]
    present = state.rates[state.turn.rule]
    if len(branches) == 1 or commanded_rule is not None:
        return branches[commanded_rule or 0](state.weights, present)
    return jax.lax.switch(state.turn.rule, branches, state.weights, present)


def _one_by_one(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    training_set: Examples,
    weights: Array,
    rates: Array,
    sequence: Array,
    learning: tuple[bool, ...],
) -> Array:
    """The weights after one pattern at a time, in the given sequence (3.4)."""
    # Patterns first, so that a step reads one stretch of memory.
    rows = jax.tree.map(
        lambda x: jnp.moveaxis(x, -1, 0),
        (training_set.signals, training_set.targets, training_set.learning_counts),
    )

    def step(weights: Array, at: Array) -> tuple[Array, None]:
        signals, targets, counts = jax.tree.map(lambda x: x[at][..., None], rows)
        change = rule.change(network, weights, signals, targets, counts, learning)
        return weights + rates @ change, None

    return jax.lax.scan(step, weights, sequence)[0]

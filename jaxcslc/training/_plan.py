from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..adaptive import AdaptiveNetwork
from ._costs import Cost, half_rms
from ._rates import AbstractRates, AdaptedRates
from ._rules import AbstractRule
from ._switching import SwitchWhen


class Schedule(eqx.Module):
    """Which rule learns when: one alone, or bouts of several by turns (thesis 7.5).

    **Attributes**

    - `rules`: the first alone until the cost falls below `hand_over`, then all by turns.
    - `hand_over`: cost below which turns begin; a number, or one for each of many trainings.
      In 7.5, what the coefficients of direct measurement leave on the same patterns.
    - `bout`: epochs that a rule has before it is the next one's turn; one number, or one for each
      rule. The next one begins at the weights of the lowest cost so far.
    - `least_reduction`: a rule whose epochs gain less, `tolerated` times in a row or all through
      its bout, gives its turn away; when every rule has done so one after the other, the training
      ends. 0.001 N m in 7.5. Not before the hand-over, where rates may still be growing; and
      epochs that move nothing, because rates that are too high are coming down, are not counted.
    - `tolerated`: epochs, so that rates have the time to follow; a shorter bout is all of them.
    - `in_step`: whether trainings side by side take turns together. The first rule then learns
      until every training is below `hand_over`. Bouts are never cut short, and a training ends
      after a round of bouts that gained less than `least_reduction` per epoch. Under `vmap`, an
      epoch computes what all rules do; in step, it computes one rule, and bouts of a quick rule
      (backpropagation on `NormalEquations`) cost no more than they do alone.
    - `switch`: in place of hand-over and bouts, an indicator of which rule is to learn, from the
      first epoch on (8.2.2); `least_reduction` then ends the training once the rule that promises
      most gains too little.

    **Raises** `ValueError` if there is no rule, or a bout has no epoch, or none is tolerated, if
    bouts or a switch's durations are not one for each rule, or if a switch has one rule only or is
    to work in step.
    """

    rules: tuple[AbstractRule, ...]
    hand_over: Float[Array, "..."] | float = float("inf")
    bout: int | tuple[int, ...] = eqx.field(default=25, static=True)
    least_reduction: Float[Array, "..."] | float = -float("inf")
    tolerated: int = eqx.field(default=5, static=True)
    switch: SwitchWhen | None = None
    in_step: bool = eqx.field(default=False, static=True)

    @property
    def bouts(self) -> tuple[int, ...]:
        """Epochs of each rule's bout."""
        return (self.bout,) * len(self.rules) if isinstance(self.bout, int) else self.bout

    def __check_init__(self) -> None:
        if not self.rules:
            raise ValueError("schedule: expected at least one rule")
        if len(self.bouts) != len(self.rules):
            raise ValueError(
                f"schedule: expected one bout, or one for each of {len(self.rules)} rules, got"
                f" {len(self.bouts)}"
            )
        if min(self.bouts) < 1:
            raise ValueError(f"schedule: a bout must have an epoch at least, got {self.bout}")
        if self.in_step and self.switch is not None:
            raise ValueError("schedule: turns are taken in step, or by a switch; got both")
        if self.tolerated < 1:
            raise ValueError(f"schedule: tolerated must be an epoch at least, got {self.tolerated}")
        number = len(self.rules)
        if self.switch is not None and number < 2:
            raise ValueError("schedule: a switch needs two rules or more, got one")
        durations = None if self.switch is None else self.switch.durations
        if durations is not None and len(durations) != number:
            raise ValueError(
                f"schedule: expected a duration for each of {number} rules, got {len(durations)}"
            )


class Turn(eqx.Module):
    """Whose turn it is.

    **Attributes**

    - `rule`: index into the schedule's rules.
    - `epochs`: of the present bout.
    - `little`: epochs in a row that gained too little.
    - `fruitful`: whether an epoch of the bout gained enough.
    - `spent`: rules in a row that gave their turn away for it.
    - `handed_over`: whether turns have begun.
    - `wait`, `interval`: epochs to the switch's next look, and from there to the one after.
    """

    rule: Int[Array, ""]
    epochs: Int[Array, ""]
    little: Int[Array, ""]
    fruitful: Bool[Array, ""]
    spent: Int[Array, ""]
    handed_over: Bool[Array, ""]
    wait: Int[Array, ""]
    interval: Int[Array, ""]

    @classmethod
    def first(cls) -> "Turn":
        zero, no = jnp.zeros((), int), jnp.zeros((), bool)
        return cls(zero, zero, zero, no, zero, no, zero, zero)

    def next(
        self, schedule: Schedule, cost: Float[Array, ""], reduction: Float[Array, ""]
    ) -> "Turn":
        """The turn after an epoch that left `cost` and gained `reduction`."""
        number = len(schedule.rules)
        handed_over = self.handed_over | (cost < schedule.hand_over) | (number == 1)
        gained = reduction >= schedule.least_reduction
        fruitful = self.fruitful | gained
        further = jnp.where(reduction == 0, self.little, self.little + 1)
        little = jnp.where(gained | ~self.handed_over, 0, further)
        passed = self.epochs + 1 >= jnp.asarray(schedule.bouts)[self.rule]
        exhausted = self.handed_over & ((little >= schedule.tolerated) | (passed & ~fruitful))
        spent = jnp.where(exhausted, self.spent + 1, jnp.where(gained, 0, self.spent))
        # The epoch that brings the hand-over is still the first rule's; turns begin behind it.
        over = handed_over & (exhausted | ~self.handed_over | passed)
        return Turn(
            jnp.where(over, (self.rule + 1) % number, self.rule),
            jnp.where(over, 0, self.epochs + 1),
            jnp.where(over, 0, little),
            fruitful & ~over,
            spent,
            handed_over,
            self.wait,
            self.interval,
        )

    def switched(
        self, schedule: Schedule, rule: Int[Array, ""], reduction: Float[Array, ""]
    ) -> "Turn":
        """The turn after an epoch that gained `reduction`, where a switch prefers `rule`."""
        over = rule != self.rule
        gained = reduction >= schedule.least_reduction
        further = jnp.where(reduction == 0, self.little, self.little + 1)
        little = jnp.where(gained | over, 0, further)
        spent = jnp.where(little >= schedule.tolerated, len(schedule.rules), 0)
        epochs = jnp.where(over, 0, self.epochs + 1)
        assert schedule.switch is not None
        looked, every = self.wait == 0, schedule.switch.every
        doubled = jnp.where(over | (self.interval == 0), every, 2 * self.interval)
        interval = jnp.where(looked, doubled, self.interval)
        wait = jnp.where(looked, interval, self.wait) - 1
        yes = jnp.ones((), bool)
        return Turn(rule, epochs, little, gained & ~over, spent, yes, wait, interval)

    def in_step(self, schedule: Schedule, rule: int, cost: Float[Array, ""]) -> "Turn":
        """The turn after an epoch that left `cost`, where all trainings are at `rule`."""
        handed_over = self.handed_over | (cost < schedule.hand_over) | (len(schedule.rules) == 1)
        return eqx.tree_at(
            lambda turn: (turn.rule, turn.epochs, turn.handed_over),
            self,
            (jnp.full_like(self.rule, rule), self.epochs + 1, handed_over),
        )

    def ended(self, schedule: Schedule) -> Bool[Array, ""]:
        """Whether no rule gains enough any more."""
        return self.handed_over & (self.spent >= len(schedule.rules))


class Plan(eqx.Module):
    """How to train: rules and their turns, rates, cost, and what ends it.

    **Attributes**

    - `schedule`: a `Schedule`, or one rule.
    - `rates`: an `AbstractRates`, the same for every rule, or one for each; `AdaptedRates(1e-3)`
      if omitted.
    - `cost`: what rates are adapted by and histories show: `half_rms` (the ε of 7.5),
      `mean_modulus` (6.3.1), `half_square` (Eqn. 3.4-2), or a function like them.
    - `order`: `"batch"`, all patterns at once; or `"sequential"`, one after the other, reshuffled
      every epoch (3.4).
    - `frozen`: names of adaptive layers or subnetworks that do not learn (5.2.4), and whose links
      do not count in averages over shared weights (5.2.6).
    - `target`: the training ends when `measure` is at most this.
    - `measure`: what `target` is compared with, the cost unless given.
    - `stop_patience`: with a stop set (3.6.1), how many epochs in a row its cost may fail to
      reach a new lowest value.
    - `patience`: how many epochs the cost may fail to; then the training has stalled.
    - `divergence`: a cost above this many times the first has diverged.
    """

    schedule: Schedule
    rates: tuple[AbstractRates, ...]
    cost: Cost = eqx.field(static=True)
    order: Literal["batch", "sequential"] = eqx.field(static=True)
    frozen: tuple[str, ...] = eqx.field(static=True)
    target: Float[Array, "..."] | float
    measure: Cost | None = eqx.field(static=True)
    stop_patience: int = eqx.field(static=True)
    patience: int = eqx.field(static=True)
    divergence: float = eqx.field(static=True)

    def __init__(
        self,
        schedule: Schedule | AbstractRule,
        rates: AbstractRates | Sequence[AbstractRates] | None = None,
        *,
        cost: Cost = half_rms,
        order: Literal["batch", "sequential"] = "batch",
        frozen: str | Sequence[str] = (),
        target: Float[Array, "..."] | float = 0.0,
        measure: Cost | None = None,
        stop_patience: int = 50,
        patience: int = 500,
        divergence: float = 1e3,
    ) -> None:
        self.schedule = Schedule((schedule,)) if isinstance(schedule, AbstractRule) else schedule
        number = len(self.schedule.rules)
        if isinstance(rates, float | int):
            raise ValueError(f"rates: expected FixedRates({rates}) or AdaptedRates({rates})")
        rates = AdaptedRates(1e-3) if rates is None else rates
        rule_rates = (rates,) * number if isinstance(rates, AbstractRates) else tuple(rates)
        if len(rule_rates) != number:
            raise ValueError(
                f"rates: expected one for each of {number} rules, got {len(rule_rates)}"
            )
        if order not in ("batch", "sequential"):
            raise ValueError(f"order: expected 'batch' or 'sequential', got {order!r}")
        if patience < 1 or stop_patience < 1:
            raise ValueError("patience, stop_patience: expected at least one epoch")
        names = (frozen,) if isinstance(frozen, str) else tuple(frozen)
        self.rates = rule_rates
        self.cost, self.order, self.frozen = cost, order, names
        self.target, self.measure = target, measure
        self.stop_patience, self.patience, self.divergence = stop_patience, patience, divergence

    def learning(self, network: AdaptiveNetwork) -> tuple[bool, ...]:
        """Which adaptive layers learn, in the order of `network.groups`.

        **Raises** `ValueError` if `frozen` names something else, or everything.
        """
        names = {s.name for s in network.subnetworks} | set(network.groups)
        for name in self.frozen:
            if name not in names:
                raise ValueError(
                    f"frozen: expected some of {', '.join(sorted(names))}, got {name!r}"
                )
        owners = [s.name for s in network.subnetworks for _ in s.adaptive_layers]
        learning = tuple(
            group not in self.frozen and owner not in self.frozen
            for group, owner in zip(network.groups, owners, strict=True)
        )
        if not any(learning):
            raise ValueError("frozen: every layer is; nothing is left to learn")
        return learning

    def first_rates(self, network: AdaptiveNetwork) -> Float[Array, "rules groups"]:
        """The rates to start with, zero where a layer does not learn.

        **Raises** `ValueError` for a wrong number of rates.
        """
        learning, groups = self.learning(network), network.groups
        rows: list[Array] = []
        for rates in self.rates:
            start = jnp.asarray(rates.start, float)
            if start.shape not in ((), (len(groups),)):
                raise ValueError(
                    f"rates: expected one number, or one for each of {', '.join(groups)}, got"
                    f" shape {start.shape}"
                )
            rows.append(jnp.broadcast_to(start, (len(groups),)) * jnp.asarray(learning, float))
        return jnp.stack(rows)

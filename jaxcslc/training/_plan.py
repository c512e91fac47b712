"""Plan of a training: learning rules and their turns, rates, cost, and what ends it.

`Schedule` gives turns in bouts (thesis 7.5) or by an indicator (`SwitchWhen`, 8.2.2). Rates are
fixed or adapted (6.3.1).
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._examples import Examples
from ._functions import Cost, half_rms
from ._network import AdaptiveNetwork
from ._rules import AbstractRule


Rates = Float[Array, " groups"]
CostsAfter = Callable[[Float[Array, "trials groups"]], Float[Array, " trials"]]


class AbstractRates(eqx.Module):
    """Learning rates, one an adaptive layer, and how they change before each epoch.

    **Attributes**

    - `start`: (groups,) or one for all.
    """

    start: eqx.AbstractVar[Float[Array | np.ndarray, "..."] | float]

    @abstractmethod
    def choose(
        self, rates: Rates, before: Float[Array, ""], costs_after: CostsAfter
    ) -> tuple[Rates, Bool[Array, ""]]:
        """Return the rates for an epoch, (groups,), and whether it moves the weights at them.

        - `rates`: those of the epoch before.
        - `before`: the cost as it stands.
        - `costs_after`: from (trials, groups) rates to the (trials,) costs that they would lead to.
        """

    @abstractmethod
    def taking_over(self, rates: Rates, best: Rates) -> Rates:
        """Return the rates of a rule that takes over because it promised most.

        - `rates`: those that it left, or began with.
        - `best`: those at which the first epoch would gain most.
        """


class FixedRates(AbstractRates):
    """Rates that stay as they are."""

    start: Float[Array | np.ndarray, "..."] | float

    def choose(
        self, rates: Rates, before: Float[Array, ""], costs_after: CostsAfter
    ) -> tuple[Rates, Bool[Array, ""]]:
        del before, costs_after
        return rates, jnp.ones((), bool)

    def taking_over(self, rates: Rates, best: Rates) -> Rates:
        del best
        return rates


class AdaptedRates(AbstractRates):
    """The highest rates that stay stable, as thesis 6.3.1 finds them, each for itself (6.3.2).

    Before each epoch, a rate goes up by a tenth if that makes the reduction of the cost a
    further 8 % greater, or else down by a tenth if that makes the cost any lower. 'A further
    8 % or greater reduction' is read as of the reduction: a tenth more of a small step gains a
    tenth more at most, so that 8 % asks that the step still be nearly all gain. Where several
    layers have a rate each, it is 8 % of what this layer's own rate gains: of five that share
    in a reduction, a tenth more of one can never add 8 % to the whole.

    For a cost that is a parabola along the step, a rate rises to 31 % of the best one and falls
    from 105 %.

    Rates are to be the highest 'whilst remaining stable'. Of several, each may be, and all at
    once not: an epoch that would raise the cost is not taken at the adapted rates but at the
    present ones, and if these would raise it as well, not at all, while all rates go down by a
    tenth. Without this, two-layer networks and PERAL on a CSLC diverged more often than not. One
    rate alone may raise the cost by up to the 8 %: rules do not follow the slope of every cost, and
    where the least of moves raises it, refusing would be to stand still for ever (83 of 100
    backpropagations of the ultrasound problem did, by the mean error modulus). Beyond, it only
    goes down: by a tenth at a time it comes down too late, and backpropagation of a linear layer
    with correlated inputs diverged in four of four trainings.

    **Attributes**

    - `start`: (groups,) or one for all.
    - `step`: the tenth.
    - `gain`: the 8 %.
    - `floor`: the part of its start that no rate falls below: where a layer's part of the cost is
      lost in rounding, its rate would wander off and take hundreds of epochs to come back.
    """

    start: Float[Array | np.ndarray, "..."] | float
    step: float = 0.1
    gain: float = 0.08
    floor: float = 1e-4

    def choose(
        self, rates: Rates, before: Float[Array, ""], costs_after: CostsAfter
    ) -> tuple[Rates, Bool[Array, ""]]:
        after = costs_after(self.trials(rates))
        adapted = self.adapted(rates, before, after)
        lower = jnp.maximum((1.0 - self.step) * jnp.minimum(rates, adapted), self._least(rates))
        # Comparisons are false for a cost that is not finite.
        if rates.shape[0] == 1:
            trials = self.trials(rates)[:, 0]  # the adapted rate is one: its cost is there
            moves = after[jnp.argmin(jnp.abs(trials - adapted[0]))] <= (1.0 + self.gain) * before
            return jnp.where(moves, adapted, lower), moves
        (jointly,) = costs_after(adapted[None])
        good, bearable = jointly <= before, after[0] <= before
        return jnp.where(good, adapted, jnp.where(bearable, rates, lower)), good | bearable

    def taking_over(self, rates: Rates, best: Rates) -> Rates:
        """Return rates as high as `choose` raises them for a parabolic cost: 31 % of the best."""
        step, gain = self.step, self.gain
        raised = jnp.maximum(2.0 * (step - gain) / (2.0 * step + step**2 - gain), 0.0)
        return jnp.where(rates > 0, jnp.maximum(raised * best, self._least(rates)), 0.0)

    def trials(self, rates: Rates) -> Float[Array, "trials groups"]:
        """Return the rates to compare: the present ones, then each higher, lower and at nothing."""
        steps, present = self.step * jnp.diag(rates), rates[None]
        trials = [present, present + steps, present - steps]
        if rates.shape[0] > 1:  # of a single one, at nothing is the cost before
            trials.append(present - jnp.diag(rates))
        return jnp.concatenate(trials)

    def adapted(
        self, rates: Rates, before: Float[Array, ""], after: Float[Array, " trials"]
    ) -> Rates:
        """Adapt each rate by itself, (groups,), given the cost after every trial."""
        groups = rates.shape[0]
        present, higher, lower = after[0], after[1 : 1 + groups], after[1 + groups : 1 + 2 * groups]
        without = after[1 + 2 * groups :] if groups > 1 else before[None]
        gain_alone = without - present
        # A trial that is not finite gains nothing; where the present one is not, go down.
        up = (gain_alone > 0) & (present - higher >= self.gain * gain_alone)
        down = (lower < present) | ~jnp.isfinite(present)
        factor = jnp.where(up, 1.0 + self.step, jnp.where(down, 1.0 - self.step, 1.0))
        return jnp.maximum(rates * factor, self._least(rates))

    def _least(self, rates: Rates) -> Rates:
        """The floor; layers that are frozen stay at zero."""
        return jnp.where(rates > 0, self.floor * jnp.asarray(self.start, rates.dtype), 0.0)


class SwitchWhen(eqx.Module):
    """Gives the turn to the rule whose next epoch promises the greatest gain (thesis 8.2.2).

    An epoch of a rule would change the outputs of all patterns by s, a vector. Of the errors e, it
    can remove the part cos²(s, e) of their sum of squares, and it does so at e's / s's times its
    rates: exactly where outputs are linear in the weights, and to first order elsewhere. This part
    is known before the epoch, for every rule, and needs no knowledge of the end. For gradient
    descent it falls as training advances into a valley; for PERAL it falls where its allocation no
    longer points to lower errors.

    A rule that takes over starts at the best rates in the proportion that they had among layers, if
    its rates are adapted.

    **Attributes**

    - `every`: epochs to the next look after the first, and after a change of turn. A look costs
      about an epoch of each rule, and each that changes nothing doubles the time to the next.
    - `margin`: how many times the gain of the present rule another one must promise; above one, so
      that turns do not change for nothing.

    **Raises** `ValueError` for an `every` below one, or a margin that is not positive.

    >>> from jaxcslc.training import PERAL, Backpropagation, Plan, Schedule, SwitchWhen
    >>> plan = Plan(Schedule((Backpropagation(), PERAL()), switch=SwitchWhen()))
    >>> plan.schedule.switch.every
    5
    """

    every: Int[Array, ""] | int = 5
    margin: Float[Array, ""] | float = 1.5

    def __check_init__(self) -> None:
        if self.every < 1:
            raise ValueError(f"switch: expected an epoch or more between looks, got {self.every}")
        if not self.margin > 0.0:
            raise ValueError(f"switch: expected a margin above zero, got {self.margin}")

    def preferred(self, present: Int[Array, ""], gains: Float[Array, " rules"]) -> Int[Array, ""]:
        """Return the rule to go on with, given what the next epoch of each promises.

        >>> import jax.numpy as jnp
        >>> from jaxcslc.training import SwitchWhen
        >>> present = jnp.asarray(0)
        >>> int(SwitchWhen(margin=1.5).preferred(present, jnp.asarray([0.10, 0.14])))
        0
        >>> int(SwitchWhen(margin=1.5).preferred(present, jnp.asarray([0.10, 0.16])))
        1
        """
        best = jnp.argmax(gains)
        return jnp.where(gains[best] > self.margin * gains[present], best, present)


def promise(
    network: AdaptiveNetwork,
    plan: "Plan",
    training_set: Examples,
    weights: Float[Array, " weights"],
    rates: Float[Array, "rules groups"],
) -> tuple[Float[Array, " rules"], Float[Array, "rules groups"]]:
    """Return what an epoch of every rule promises, with rates in their present proportion.

    It is the part of the sum of squared errors that the epoch would remove, 0 to 1, and the rates
    at which it would.
    """
    errors, learning = training_set.errors(network, weights), plan.learning(network)

    def outputs(w: Array) -> Array:
        return network.activation.value(training_set.totals(network, w)) * training_set.counts

    gains: list[Array] = []
    best: list[Array] = []
    for rule, own_rates in zip(plan.schedule.rules, rates, strict=True):
        change = training_set.change(network, rule, weights, learning)
        _, moved = jax.jvp(outputs, (weights,), (own_rates @ change,))
        gain, multiple = line_gain(errors, moved)
        gains.append(gain)
        best.append(jnp.where(gain > 0.0, multiple, 1.0) * own_rates)
    return jnp.stack(gains), jnp.stack(best)


def line_gain(
    errors: Float[Array, "outputs patterns"], moved: Float[Array, "outputs patterns"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """cos² of the angle between errors and a change of outputs, and the best multiple of it.

    Zero, and zero, where the change leads away from the errors, or is none.
    """
    along = jnp.maximum(jnp.sum(errors * moved), 0.0)
    square, of_errors = jnp.sum(moved**2), jnp.sum(errors**2)
    usable = (along > 0.0) & jnp.isfinite(square) & (square > 0.0)
    multiple = jnp.where(usable, along / jnp.where(usable, square, 1.0), 0.0)
    share = along / jnp.where(usable, of_errors, 1.0)
    return jnp.where(usable, jnp.minimum(multiple * share, 1.0), 0.0), multiple


class Schedule(eqx.Module):
    """Schedule of learning rules: one alone, or bouts of several by turns (thesis 7.5).

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
    - `switch`: instead of hand-over and bouts, an indicator of which rule is to learn, from the
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
        if self.switch is not None and len(self.rules) < 2:
            raise ValueError("schedule: a switch needs two rules or more, got one")


class Turn(eqx.Module):
    """State of the turns of a schedule's rules.

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
        """Return whether no rule gains enough any more."""
        return self.handed_over & (self.spent >= len(schedule.rules))


def _as_schedule(schedule: Schedule | AbstractRule) -> Schedule:
    return Schedule((schedule,)) if isinstance(schedule, AbstractRule) else schedule


def _as_rates(rates: AbstractRates | Sequence[AbstractRates] | float) -> tuple[AbstractRates, ...]:
    if isinstance(rates, float | int):
        raise ValueError(f"rates: expected FixedRates({rates}) or AdaptedRates({rates})")
    return (rates,) if isinstance(rates, AbstractRates) else tuple(rates)


def _as_names(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


class Plan(eqx.Module):
    """Plan of a training: rules and their turns, rates, cost, and what ends it.

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

    schedule: Schedule = eqx.field(converter=_as_schedule)
    rates: tuple[AbstractRates, ...] = eqx.field(default=AdaptedRates(1e-3), converter=_as_rates)
    cost: Cost = eqx.field(default=half_rms, static=True, kw_only=True)
    order: Literal["batch", "sequential"] = eqx.field(default="batch", static=True, kw_only=True)
    frozen: tuple[str, ...] = eqx.field(default=(), converter=_as_names, static=True, kw_only=True)
    target: Float[Array, "..."] | float = eqx.field(default=0.0, kw_only=True)
    measure: Cost | None = eqx.field(default=None, static=True, kw_only=True)
    stop_patience: int = eqx.field(default=50, static=True, kw_only=True)
    patience: int = eqx.field(default=500, static=True, kw_only=True)
    divergence: float = eqx.field(default=1e3, static=True, kw_only=True)

    def __check_init__(self) -> None:
        number = len(self.schedule.rules)
        if len(self.rates) not in (1, number):
            raise ValueError(
                f"rates: expected one for each of {number} rules, got {len(self.rates)}"
            )
        if self.order not in ("batch", "sequential"):
            raise ValueError(f"order: expected 'batch' or 'sequential', got {self.order!r}")
        if self.patience < 1 or self.stop_patience < 1:
            raise ValueError("patience, stop_patience: expected at least one epoch")

    @property
    def rule_rates(self) -> tuple[AbstractRates, ...]:
        """The rates of each rule."""
        return self.rates * len(self.schedule.rules) if len(self.rates) == 1 else self.rates

    def learning(self, network: AdaptiveNetwork) -> tuple[bool, ...]:
        """Return whether each adaptive layer learns, in the order of `network.groups`.

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
        """Return the rates to start with, zero where a layer does not learn.

        **Raises** `ValueError` for a wrong number of rates.
        """
        learning, groups = self.learning(network), network.groups
        rows: list[Array] = []
        for rates in self.rule_rates:
            start = jnp.asarray(rates.start, float)
            if start.shape not in ((), (len(groups),)):
                raise ValueError(
                    f"rates: expected one number, or one for each of {', '.join(groups)}, got"
                    f" shape {start.shape}"
                )
            rows.append(jnp.broadcast_to(start, (len(groups),)) * jnp.asarray(learning, float))
        return jnp.stack(rows)

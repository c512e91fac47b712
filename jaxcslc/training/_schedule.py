import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._rules import AbstractRule


class Schedule(eqx.Module):
    """Which rule learns when: one alone, or bouts of several by turns (thesis 7.5).

    **Attributes**

    - `rules`: the first alone until the cost falls below `hand_over`, then all by turns.
    - `hand_over`: cost below which turns begin; a number, or one for each of many trainings.
      In 7.5, what the coefficients of direct measurement leave on the same patterns.
    - `bout`: epochs that a rule has before it is the next one's turn. The next one begins at the
      weights of the lowest cost so far.
    - `least_reduction`: a rule whose epochs gain less, `tolerated` times in a row or all through
      its bout, gives its turn away; when every rule has done so one after the other, the training
      ends. 0.001 N m in 7.5. Not before the hand-over, where rates may still be growing; and
      epochs that move nothing, because rates that are too high are coming down, are not counted.
    - `tolerated`: epochs, so that rates have the time to follow; a shorter bout is all of them.

    **Raises** `ValueError` if there is no rule, or a bout has no epoch, or none is tolerated.
    """

    rules: tuple[AbstractRule, ...]
    hand_over: Float[Array, "..."] | float = float("inf")
    bout: int = eqx.field(default=25, static=True)
    least_reduction: Float[Array, "..."] | float = -float("inf")
    tolerated: int = eqx.field(default=5, static=True)

    def __check_init__(self) -> None:
        if not self.rules:
            raise ValueError("schedule: expected at least one rule")
        if self.bout < 1:
            raise ValueError(f"schedule: a bout must have an epoch at least, got {self.bout}")
        if self.tolerated < 1:
            raise ValueError(f"schedule: tolerated must be an epoch at least, got {self.tolerated}")


class Turn(eqx.Module):
    """Whose turn it is.

    **Attributes**

    - `rule`: index into the schedule's rules.
    - `epochs`: of the present bout.
    - `little`: epochs in a row that gained too little.
    - `fruitful`: whether an epoch of the bout gained enough.
    - `spent`: rules in a row that gave their turn away for it.
    - `handed_over`: whether turns have begun.
    """

    rule: Int[Array, ""]
    epochs: Int[Array, ""]
    little: Int[Array, ""]
    fruitful: Bool[Array, ""]
    spent: Int[Array, ""]
    handed_over: Bool[Array, ""]

    @classmethod
    def first(cls) -> "Turn":
        zero, no = jnp.zeros((), int), jnp.zeros((), bool)
        return cls(zero, zero, zero, no, zero, no)

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
        passed = self.epochs + 1 >= schedule.bout
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
        )

    def ended(self, schedule: Schedule) -> Bool[Array, ""]:
        """Whether no rule gains enough any more."""
        return self.handed_over & (self.spent >= len(schedule.rules))

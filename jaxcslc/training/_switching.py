from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..adaptive import AdaptiveNetwork
from ._examples import Examples
from ._rules import AbstractRule


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
      about an epoch of each other rule, and each that changes nothing doubles the time to the next.
    - `margin`: how many times the gain of the present rule another one must promise, both divided
      by the duration of an epoch; above one, so that turns do not change for nothing.
    - `durations`: of an epoch of each rule, in proportion; equal if omitted.

    **Raises** `ValueError` for an `every` below one, a margin that is not positive, or a duration
    that is not.

    >>> from jaxcslc.training import PERAL, Backpropagation, Plan, Schedule, SwitchWhen
    >>> plan = Plan(Schedule((Backpropagation(), PERAL()), switch=SwitchWhen()))
    >>> plan.schedule.switch.every
    5
    """

    every: Int[Array, ""] | int = 5
    margin: Float[Array, ""] | float = 1.5
    durations: tuple[Float[Array, ""] | float, ...] | None = None

    def __check_init__(self) -> None:
        if self.every < 1:
            raise ValueError(f"switch: expected an epoch or more between looks, got {self.every}")
        if not self.margin > 0.0:
            raise ValueError(f"switch: expected a margin above zero, got {self.margin}")
        if self.durations is not None and not all(x > 0.0 for x in self.durations):
            raise ValueError(f"switch: expected durations above zero, got {self.durations}")

    def preferred(self, present: Int[Array, ""], gains: Float[Array, " rules"]) -> Int[Array, ""]:
        """The rule to go on with, given what the next epoch of each promises.

        >>> import jax.numpy as jnp
        >>> from jaxcslc.training import SwitchWhen
        >>> present = jnp.asarray(0)
        >>> int(SwitchWhen(margin=1.5).preferred(present, jnp.asarray([0.10, 0.14])))
        0
        >>> int(SwitchWhen(margin=1.5).preferred(present, jnp.asarray([0.10, 0.16])))
        1
        """
        durations = jnp.ones(gains.shape) if self.durations is None else jnp.asarray(self.durations)
        worth = gains / durations
        best = jnp.argmax(worth)
        return jnp.where(worth[best] > self.margin * worth[present], best, present)


class Promise(NamedTuple):
    """What an epoch of every rule promises.

    - `gains`: the part of the sum of squared errors that it would remove, 0 to 1.
    - `rates`: at which it would.
    - `changes`: of the weights, at a rate of one.
    """

    gains: Float[Array, " rules"]
    rates: Float[Array, "rules groups"]
    changes: Float[Array, "rules groups weights"]


def promise(
    network: AdaptiveNetwork,
    rules: tuple[AbstractRule, ...],
    training_set: Examples,
    weights: Float[Array, " weights"],
    rates: Float[Array, "rules groups"],
    learning: tuple[bool, ...],
) -> Promise:
    """Gains of all rules, with rates in their present proportion."""
    errors = training_set.errors(network, weights)

    def outputs(w: Array) -> Array:
        return network.activation.value(training_set.totals(network, w)) * training_set.counts

    gains: list[Array] = []
    best: list[Array] = []
    changes: list[Array] = []
    for rule, own_rates in zip(rules, rates, strict=True):
        changes.append(training_set.change(network, rule, weights, learning))
        _, moved = jax.jvp(outputs, (weights,), (own_rates @ changes[-1],))
        gain, multiple = line_gain(errors, moved)
        gains.append(gain)
        best.append(jnp.where(gain > 0.0, multiple, 1.0) * own_rates)
    return Promise(jnp.stack(gains), jnp.stack(best), jnp.stack(changes))


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

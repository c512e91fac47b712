from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..adaptive import AdaptiveNetwork
from ._costs import Cost, half_rms
from ._rates import AbstractRates, AdaptedRates
from ._rules import AbstractRule
from ._schedule import Schedule


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
        each = (rates,) * number if isinstance(rates, AbstractRates) else tuple(rates)
        if len(each) != number:
            raise ValueError(f"rates: expected one for each of {number} rules, got {len(each)}")
        if order not in ("batch", "sequential"):
            raise ValueError(f"order: expected 'batch' or 'sequential', got {order!r}")
        if patience < 1 or stop_patience < 1:
            raise ValueError("patience, stop_patience: expected at least one epoch")
        names = (frozen,) if isinstance(frozen, str) else tuple(frozen)
        self.rates = each
        self.cost, self.order, self.frozen = cost, order, names
        self.target, self.measure = target, measure
        self.stop_patience, self.patience, self.divergence = stop_patience, patience, divergence

    def learning(self, network: AdaptiveNetwork) -> tuple[bool, ...]:
        """Which adaptive layers learn, in the order of `network.groups`.

        **Raises** `ValueError` if `frozen` names something else, or everything.
        """
        known = {s.name for s in network.subnetworks} | set(network.groups)
        for name in self.frozen:
            if name not in known:
                raise ValueError(
                    f"frozen: expected some of {', '.join(sorted(known))}, got {name!r}"
                )
        owners = [s.name for s in network.subnetworks for _ in s.layers]
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

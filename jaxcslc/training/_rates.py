from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


class AbstractRates(eqx.Module):
    """Learning rates, one an adaptive layer, and how they change before each epoch.

    **Attributes**

    - `start`: (groups,) or one for all.
    """

    start: eqx.AbstractVar[Float[Array | np.ndarray, "..."] | float]

    @abstractmethod
    def trials(self, rates: Float[Array, " groups"]) -> Float[Array, "trials groups"]:
        """Which rates to try out in an epoch, the present ones first."""

    @abstractmethod
    def adapted(
        self,
        rates: Float[Array, " groups"],
        before: Float[Array, ""],
        after: Float[Array, " trials"],
    ) -> Float[Array, " groups"]:
        """The rates for this epoch, given the cost before it and after every trial."""

    @abstractmethod
    def settled(
        self,
        present: Float[Array, " groups"],
        adapted: Float[Array, " groups"],
        before: Float[Array, ""],
        after_present: Float[Array, ""],
        after_adapted: Float[Array, ""],
    ) -> tuple[Float[Array, " groups"], Bool[Array, ""]]:
        """The rates in the end, and whether the epoch moves the weights at them."""


class FixedRates(AbstractRates):
    """Rates that stay as they are."""

    start: Float[Array | np.ndarray, "..."] | float

    def trials(self, rates: Float[Array, " groups"]) -> Float[Array, "trials groups"]:
        return rates[None, :]

    def adapted(
        self,
        rates: Float[Array, " groups"],
        before: Float[Array, ""],
        after: Float[Array, " trials"],
    ) -> Float[Array, " groups"]:
        del before, after
        return rates

    def settled(
        self,
        present: Float[Array, " groups"],
        adapted: Float[Array, " groups"],
        before: Float[Array, ""],
        after_present: Float[Array, ""],
        after_adapted: Float[Array, ""],
    ) -> tuple[Float[Array, " groups"], Bool[Array, ""]]:
        del adapted, before, after_present, after_adapted
        return present, jnp.ones((), bool)


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
    rate alone moves in any case: rules do not follow the slope of every cost, and where the least
    of moves raises it, refusing would be to stand still for ever (83 of 100 backpropagations of
    the ultrasound problem did, by the mean error modulus).

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

    def trials(self, rates: Float[Array, " groups"]) -> Float[Array, "trials groups"]:
        steps, present = self.step * jnp.diag(rates), rates[None]
        trials = [present, present + steps, present - steps]
        if rates.shape[0] > 1:  # each without its own part
            trials.append(present - jnp.diag(rates))
        return jnp.concatenate(trials)

    def adapted(
        self,
        rates: Float[Array, " groups"],
        before: Float[Array, ""],
        after: Float[Array, " trials"],
    ) -> Float[Array, " groups"]:
        groups = rates.shape[0]
        present, higher, lower = after[0], after[1 : 1 + groups], after[1 + groups : 1 + 2 * groups]
        without = after[1 + 2 * groups :] if groups > 1 else before[None]
        own = without - present
        # A trial that is not finite gains nothing; where the present one is not, go down.
        up = (own > 0) & (present - higher >= self.gain * own)
        down = (lower < present) | ~jnp.isfinite(present)
        factor = jnp.where(up, 1.0 + self.step, jnp.where(down, 1.0 - self.step, 1.0))
        return jnp.maximum(rates * factor, self._least(rates))

    def settled(
        self,
        present: Float[Array, " groups"],
        adapted: Float[Array, " groups"],
        before: Float[Array, ""],
        after_present: Float[Array, ""],
        after_adapted: Float[Array, ""],
    ) -> tuple[Float[Array, " groups"], Bool[Array, ""]]:
        if present.shape[0] == 1:
            return adapted, jnp.ones((), bool)
        # False for a cost that is not finite.
        good, bearable = after_adapted <= before, after_present <= before
        lower = jnp.maximum((1.0 - self.step) * jnp.minimum(present, adapted), self._least(present))
        return jnp.where(good, adapted, jnp.where(bearable, present, lower)), good | bearable

    def _least(self, rates: Float[Array, " groups"]) -> Float[Array, " groups"]:
        """The floor; layers that are frozen stay at zero."""
        return jnp.where(rates > 0, self.floor * jnp.asarray(self.start, rates.dtype), 0.0)

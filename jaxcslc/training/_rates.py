from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


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
        """The rates for an epoch, (groups,), and whether it moves the weights at them.

        - `rates`: those of the epoch before.
        - `before`: the cost as it stands.
        - `costs_after`: from (trials, groups) rates to the (trials,) costs that they would lead to.
        """

    @abstractmethod
    def taking_over(self, rates: Rates, best: Rates) -> Rates:
        """The rates of a rule that takes over because it promised most.

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
        """As high as `choose` would raise them for a cost that is a parabola: 31 % of the best."""
        step, gain = self.step, self.gain
        raised = jnp.maximum(2.0 * (step - gain) / (2.0 * step + step**2 - gain), 0.0)
        return jnp.where(rates > 0, jnp.maximum(raised * best, self._least(rates)), 0.0)

    def trials(self, rates: Rates) -> Float[Array, "trials groups"]:
        """Which rates to compare: the present ones, then each higher, lower and at nothing."""
        steps, present = self.step * jnp.diag(rates), rates[None]
        trials = [present, present + steps, present - steps]
        if rates.shape[0] > 1:  # of a single one, at nothing is the cost before
            trials.append(present - jnp.diag(rates))
        return jnp.concatenate(trials)

    def adapted(
        self, rates: Rates, before: Float[Array, ""], after: Float[Array, " trials"]
    ) -> Rates:
        """Each rate by itself, (groups,), given the cost after every trial."""
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

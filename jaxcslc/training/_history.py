"""Result of a training: weights, outcome, and the history epoch by epoch."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


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

    cost: Float[Array | np.ndarray, "*trainings epochs"]
    measure: Float[Array | np.ndarray, "*trainings epochs"]
    stop_cost: Float[Array | np.ndarray, "*trainings epochs"]
    rule: Int[Array | np.ndarray, "*trainings epochs"]
    rates: Float[Array | np.ndarray, "*trainings epochs groups"]
    weights: Float[Array | np.ndarray, "*trainings epochs weights"] | None


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

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._results import ENDINGS, OUTCOMES


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
    """What a training found.

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
        """How many trainings ended in which way."""
        numbers = {
            name: int(np.sum(np.asarray(self.outcome == member)))
            for name, member in ENDINGS.items()
        }
        return {name: number for name, number in numbers.items() if number}

    def __repr__(self) -> str:
        number = int(np.prod(jnp.shape(self.cost)))
        ended = ", ".join(f"{count} {name}" for name, count in self.outcomes().items())
        return f"Training({number} of {self.weights.shape[-1]} weights: {ended})"

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..adaptive import LINEAR_COMBINER, AdaptiveNetwork
from ._costs import Cost, half_square
from ._delta_rules import Backpropagation
from ._examples import Examples
from ._rules import AbstractRule, links_per_weight


# Patterns whose sensitivities are held at once: 32 MB for a PUMA 560's five subnetworks.
_BLOCK = 4096


class NormalEquations(eqx.Module):
    """What full-batch backpropagation of a linear network needs to know of its patterns.

    Outputs that are linear in the weights have a quadratic cost, Eqn. 3.4-2's half sum of
    squares: its Gram matrix says what any number of patterns would, so that an epoch costs p²
    operations and not a pass over them. `train` takes it in place of `Examples`, with
    `Backpropagation`, the cost `half_square` and batches.

    **Attributes**

    - `gram`: (p, p), the mean over patterns of regressor' regressor.
    - `layered`: (groups, p, p), its parts by the adaptive layer that the left factor belongs to.
    - `moment`: (groups, p), the mean of regressor' target, by layer.
    - `square`: mean over patterns of the summed squared targets.
    """

    gram: Float[Array, "*sets weights weights"]
    layered: Float[Array, "*sets groups weights weights"]
    moment: Float[Array, "*sets groups weights"]
    square: Float[Array, "*sets"]

    @property
    def trainings(self) -> int | None:
        """How many sets of patterns these are, if there is a leading axis of them."""
        return self.gram.shape[0] if self.gram.ndim == 3 else None

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The numbers, to check their precision."""
        return (self.gram, self.moment)

    def check_rule(self, rule: AbstractRule, cost: Cost, order: str) -> str | None:
        """Why they cannot be trained with so, in one line; none if they can."""
        if not isinstance(rule, Backpropagation):
            return (
                f"normal equations serve backpropagation only: {rule.name} needs every pattern's"
                " own values; train it on `examples`"
            )
        if order != "batch":
            return "normal equations know no single patterns: train sequentially on `examples`"
        if cost is not half_square:
            return "normal equations know the cost `half_square` only; give it to the plan"
        return None

    def costs(
        self, network: AdaptiveNetwork, weights: Float[Array, " weights"], *costs: Cost
    ) -> tuple[Float[Array, ""], ...]:
        """Half the mean of the summed squared errors (Eqn. 3.4-2), once for each of `costs`.

        A difference of large numbers where it is small: of a cost below a millionth of a
        millionth of that of zero weights nothing is left but rounding, and it may be negative.
        """
        del network
        moment = jnp.sum(self.moment, axis=0)
        square = weights @ (self.gram @ weights) - 2.0 * (moment @ weights) + self.square
        return (0.5 * square,) * len(costs)

    def trial_costs(
        self,
        network: AdaptiveNetwork,
        weights: Float[Array, " weights"],
        change: Float[Array, "groups weights"],
        trials: Float[Array, "trials groups"],
        cost: Cost,
    ) -> Float[Array, " trials"]:
        """The cost after a change of the weights at each of several sets of rates."""
        return jax.vmap(lambda trial: self.costs(network, weights + trial @ change, cost)[0])(
            trials
        )

    def change(
        self,
        network: AdaptiveNetwork,
        rule: AbstractRule,
        weights: Float[Array, " weights"],
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        """A batch's move at a rate of one, as `Backpropagation` finds it on the patterns."""
        del rule
        layers = [layer.links for _, layer in network.adaptive_layers]
        shares = jnp.asarray(1.0 / links_per_weight(layers, network.size, learning))
        gradient = self.moment - self.layered @ weights
        takes_part = jnp.asarray(learning, gradient.dtype)
        return gradient * shares[None, :] * takes_part[:, None]


def normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    """The normal equations of patterns; pairs that do not count are left out.

    Can be jitted, and vmapped over recordings.

    **Raises** `ValueError` if the network's outputs are not linear in its weights.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.adaptive import fully_connected
    >>> from jaxcslc.training import examples, half_square, normal_equations
    >>> network = fully_connected([1, 1], "linear combiner")
    >>> line = examples(network, jnp.asarray([[0.0], [1.0]]), jnp.asarray([[1.0], [3.0]]))
    >>> (cost,) = normal_equations(network, line).costs(network, jnp.zeros(2), half_square)
    >>> float(cost)  # (1 + 9) / 2 / 2
    2.5
    """
    if not network.linear or network.activation != LINEAR_COMBINER:
        raise ValueError(
            "normal equations need outputs that are linear in the weights: one layer of linear"
            " combiners, without or with context-sensitive layers"
        )
    if training_set.trainings is not None:
        raise ValueError("normal equations: for many sets of patterns, jax.vmap this function")
    return _normal_equations(network, training_set)


@eqx.filter_jit
def _normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    samples = training_set.targets.shape[-1]
    blocks = -(-samples // _BLOCK)
    width = min(samples, _BLOCK)

    def block_of(x: Array) -> Array:
        """(units, patterns) to (blocks, units, width), filled up with patterns of no weight."""
        filled = jnp.pad(x, ((0, 0), (0, blocks * width - samples)))
        return jnp.moveaxis(filled.reshape(x.shape[0], blocks, width), 1, 0)

    units = jnp.eye(network.size, dtype=training_set.targets.dtype)

    def sums(part: Any) -> tuple[Array, Array, Array]:
        signals, targets, counts = part
        unit_responses = jax.lax.map(
            lambda unit: jnp.stack(network.forward(unit, signals).parts), units
        )
        masked_responses = (
            jnp.moveaxis(unit_responses, 1, 0) * counts[None, None]
        )  # (groups, p, outputs, patterns)
        whole = jnp.sum(unit_responses, axis=1)
        return (
            jnp.einsum("gpok,qok->gpq", masked_responses, whole),
            jnp.einsum("gpok,ok->gp", masked_responses, targets),
            jnp.sum(targets**2 * counts),
        )

    parts = jax.tree.map(
        block_of, (training_set.signals, training_set.targets, training_set.counts)
    )
    layered, moment, square = jax.tree.map(
        lambda x: jnp.sum(x, axis=0) / training_set.patterns, jax.lax.map(sums, parts)
    )
    return NormalEquations(jnp.sum(layered, axis=0), layered, moment, square)

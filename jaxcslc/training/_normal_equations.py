"""Normal equations of patterns, for backpropagation of networks that are linear in their weights.

An epoch then costs p² operations, and not a pass over the patterns.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._activations import LINEAR_COMBINER
from ._costs import Cost, half_square
from ._examples import Examples
from ._network import AdaptiveNetwork
from ._rules import AbstractRule, Backpropagation, links_per_weight


# Patterns whose sensitivities are held at once: 32 MB for a PUMA 560's five subnetworks.
_BLOCK = 4096


class NormalEquations(eqx.Module):
    """Normal equations of patterns: all that full-batch backpropagation of a linear network needs.

    Outputs that are linear in the weights have a quadratic cost, Eqn. 3.4-2's half sum of
    squares: its Gram matrix says what any number of patterns would, so that an epoch costs p²
    operations and not a pass over them. `train` takes it in place of `Examples`, with
    `Backpropagation`, the cost `half_square` and batches.

    **Attributes**

    - `gram`: (p, p), the mean over patterns of regressor' regressor.
    - `moment`: (p,), the mean of regressor' target.
    - `square`: mean over patterns of the summed squared targets.
    - `layered_gram`: (groups, p, p), parts of `gram` by the adaptive layer that the left factor
      belongs to.
    - `layered_moment`: (groups, p), parts of `moment` by layer.

    Where subnetworks learn from pairs of their own, `gram`, `moment` and `square` are of all pairs
    that count for any, as costs are. A layer's parts are of its own pairs. The sum of
    `layered_gram` is then not `gram`, and not symmetric.
    """

    gram: Float[Array, "*sets weights weights"]
    moment: Float[Array, "*sets weights"]
    square: Float[Array, "*sets"]
    layered_gram: Float[Array, "*sets groups weights weights"]
    layered_moment: Float[Array, "*sets groups weights"]

    @property
    def trainings(self) -> int | None:
        """Number of sets of patterns, if there is a leading axis of them; otherwise None."""
        return self.gram.shape[0] if self.gram.ndim == 3 else None

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The numbers, to check their precision."""
        return (self.gram, self.layered_moment)

    def check_rule(self, rule: AbstractRule, cost: Cost, order: str) -> str | None:
        """Return why these equations do not suit the training, in one line; None if they do."""
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
        square = weights @ (self.gram @ weights) - 2.0 * (self.moment @ weights) + self.square
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
        gradient = self.layered_moment - self.layered_gram @ weights
        takes_part = jnp.asarray(learning, gradient.dtype)
        return gradient * shares[None, :] * takes_part[:, None]

    def solution(self) -> Float[Array, "*sets weights"]:
        """The weights at which backpropagation at one rate for all layers no longer moves, (p,).

        They solve Z'(t - X k) = 0 over all pairs of output and pattern. X is the regressor. Z is X
        with the columns of a subnetwork zero at pairs that it does not learn from. If all
        subnetworks learn from the same pairs, this is the least-squares solution, of lowest cost.
        Otherwise it is an instrumental-variable estimate with the instruments Z: its cost may be
        above the lowest. It helps where what the network lacks correlates with the columns that Z
        has zero, and with no others, as static friction does with viscous and Coulomb friction
        (7.2.2). The other columns then keep the pairs, which a mask of all subnetworks would lose.

        Of weights that the patterns leave open, the smallest in proportion to their regressors.
        Can be jitted, and mapped over sets of patterns.

        >>> import numpy as np
        >>> from jaxcslc.training import fully_connected
        >>> from jaxcslc.training import examples, normal_equations
        >>> network = fully_connected([1, 1], "linear combiner")
        >>> line = examples(network, np.array([[0.0], [1.0]]), np.array([[1.0], [3.0]]))
        >>> normal_equations(network, line).solution().round(9).tolist()  # slope and bias
        [2.0, 1.0]
        """
        matrix = jnp.sum(self.layered_gram, axis=-3)
        moment = jnp.sum(self.layered_moment, axis=-2)
        lengths = jnp.sqrt(jnp.diagonal(self.gram, axis1=-2, axis2=-1))
        lengths = jnp.where(lengths > 0.0, lengths, 1.0)
        scaled = matrix / (lengths[..., :, None] * lengths[..., None, :])

        def solved(scaled: Array, moment: Array) -> Array:
            return jnp.linalg.lstsq(scaled, moment)[0]

        for _ in range(moment.ndim - 1):
            solved = jax.vmap(solved)
        return solved(scaled, moment / lengths) / lengths


def normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    """The normal equations of patterns; pairs that do not count are left out.

    Can be jitted, and vmapped over recordings.

    **Raises** `ValueError` if the network's outputs are not linear in its weights.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import fully_connected
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


def with_normal_equations(network: AdaptiveNetwork, training_set: Examples) -> Examples:
    """Return patterns together with their normal equations.

    A schedule of backpropagation and PERAL needs the patterns for PERAL alone. Backpropagation of
    a linear network, and the cost `half_square`, then need p² operations per epoch instead of a
    pass over all patterns. Can be jitted, and vmapped over recordings.

    **Arguments**

    - `network`: whose outputs are linear in its p weights.
    - `training_set`: from `examples`.

    **Raises** `ValueError` as `normal_equations`.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import fully_connected
    >>> from jaxcslc.training import Backpropagation, examples, with_normal_equations
    >>> network = fully_connected([1, 1], "linear combiner")
    >>> line = examples(network, jnp.asarray([[0.0], [1.0]]), jnp.asarray([[1.0], [3.0]]))
    >>> both = with_normal_equations(network, line)
    >>> both.change(network, Backpropagation(), jnp.zeros(2), (True,)).tolist()
    [[1.5, 2.0]]
    """
    equations = normal_equations(network, training_set)
    return eqx.tree_at(
        lambda part: part.equations, training_set, equations, is_leaf=lambda x: x is None
    )


@eqx.filter_jit
def _normal_equations(network: AdaptiveNetwork, training_set: Examples) -> NormalEquations:
    samples = training_set.targets.shape[-1]
    blocks = -(-samples // _BLOCK)
    width = min(samples, _BLOCK)

    def block_of(x: Array) -> Array:
        """(..., patterns) to (blocks, ..., width), filled up with patterns of no weight."""
        filled = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, blocks * width - samples)])
        return jnp.moveaxis(filled.reshape(*x.shape[:-1], blocks, width), -2, 0)

    units = jnp.eye(network.size, dtype=training_set.targets.dtype)

    def sums(part: Any) -> tuple[Array, ...]:
        signals, targets, counts, subnetwork_counts = part
        own_counts = counts[None] if subnetwork_counts is None else subnetwork_counts
        unit_responses = jax.lax.map(
            lambda unit: jnp.stack(network.forward(unit, signals).parts), units
        )
        masked_responses = (
            jnp.moveaxis(unit_responses, 1, 0) * own_counts[:, None]
        )  # (groups, p, outputs, patterns)
        whole = jnp.sum(unit_responses, axis=1)
        layered = (
            jnp.einsum("gpok,qok->gpq", masked_responses, whole),
            jnp.einsum("gpok,ok->gp", masked_responses, targets),
        )
        square = jnp.sum(targets**2 * counts)
        if subnetwork_counts is None:
            return square, *layered
        counted = whole * counts[None]
        gram = jnp.einsum("pok,qok->pq", counted, whole)
        return square, *layered, gram, jnp.einsum("pok,ok->p", counted, targets)

    of_patterns = (
        training_set.signals,
        training_set.targets,
        training_set.counts,
        training_set.subnetwork_counts,
    )
    parts = jax.lax.map(sums, jax.tree.map(block_of, of_patterns))
    square, *layered = (jnp.sum(x, axis=0) / training_set.patterns for x in parts)
    layered_gram, layered_moment, *of_all = layered
    gram, moment = of_all or (jnp.sum(x, axis=0) for x in layered)
    return NormalEquations(gram, moment, square, layered_gram, layered_moment)

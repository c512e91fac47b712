"""Learning rules: their base class, the perceptron rule and backpropagation (thesis 3.4).

A rule states how far an epoch moves the weights at a rate of one. PERAL is in `_peral`.
"""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._activations import HARD_LIMITER
from ._network import AdaptiveNetwork, Layer, Links, Signals


Weights = Float[Array, " weights"]
Numbers = Float[Array, "outputs patterns"]
#: One where a pair of output and pattern takes part in learning, zero where it is masked: for all
#: subnetworks, or for each.
Counts = Float[Array, "*subnetworks outputs patterns"]
#: What every adaptive layer's links are moved by: (nodes, inputs) each, of sizes that differ.
Moves = Sequence[Float[Array, "_ _"]]


class AbstractRule(eqx.Module):
    """A learning rule: how far one epoch, at a rate of one, moves the weights (thesis 3.4, 6).

    Rules say nothing of rates, of the order of patterns, or of when to stop: a training puts
    them together. `change` sums over the patterns that it is given: a training divides by their
    number in batch mode, and hands over one at a time in sequential mode.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the rule for histories and messages."""

    @abstractmethod
    def check_network(self, network: AdaptiveNetwork) -> str | None:
        """Return why this rule cannot train such a network, in one line; None if it can."""

    def check_start(
        self, network: AdaptiveNetwork, weights: np.ndarray, learning: tuple[bool, ...]
    ) -> str | None:
        """Return why this rule cannot start from such weights, in one line; None if it can."""
        del network, weights, learning
        return None

    def check_patterns(
        self,
        network: AdaptiveNetwork,
        signals: Signals,
        counts: Counts,
    ) -> str | None:
        """Return why these patterns cannot lead anywhere, in one line; None if they can."""
        del network, signals, counts
        return None

    @abstractmethod
    def change(
        self,
        network: AdaptiveNetwork,
        weights: Weights,
        signals: Signals,
        targets: Numbers,
        counts: Counts,
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        """Compute each adaptive layer's contribution to the change of the weights, (groups, p).

        It is zero for weights that none of the layer's links has.

        - `signals`, `targets`: as in `Examples`.
        - `counts`: (outputs, patterns), or (subnetworks, outputs, patterns): a node's error then
          passes to a subnetwork only where the pair counts for it (7.2.2).
        - `learning`: which layers take part; shared weights move by the average over the links
          of those that do (5.2.6).
        """


def of_subnetwork(counts: Counts, number: int) -> Numbers:
    """Return the counts of one subnetwork."""
    return counts[number] if counts.ndim == 3 else counts


def change_of_weights(
    network: AdaptiveNetwork,
    moves: Moves,
    learning: tuple[bool, ...],
    *,
    by_sign: bool = False,
) -> Float[Array, "groups weights"]:
    """Convert moves of links to changes of weights: averages over the links that share (5.2.6).

    - `moves`: one (nodes, inputs) matrix an adaptive layer.
    - `by_sign`: whether a link's known multiple enters by its sign only, for a rule that moves
      what a link passes on; otherwise as it is, by the chain rule.
    """
    layers = [layer.links for _, layer in network.adaptive_layers]
    shares = 1.0 / links_per_weight(layers, network.size, learning)
    rows: list[Array] = []
    for links, move, learns in zip(layers, moves, learning, strict=True):
        if not learns:
            rows.append(jnp.zeros(network.size, move.dtype))
            continue
        multiple = np.sign(links.multiple) if by_sign else links.multiple
        per_link = links.at_links(move) * jnp.asarray(multiple, move.dtype)
        rows.append(links.to_weights(per_link, network.size) * jnp.asarray(shares, move.dtype))
    return jnp.stack(rows)


def links_per_weight(
    layers: Sequence[Links], size: int, learning: tuple[bool, ...]
) -> Float[np.ndarray, " weights"]:
    """Count the learning links that share each weight; 1 for weights that none has."""
    numbers = np.zeros(size)
    for links, learns in zip(layers, learning, strict=True):
        if learns:
            numbers += np.bincount(links.weight, minlength=size)
    return np.maximum(numbers, 1.0)


def transposed_product(left: Array, right: Array) -> Array:
    """`left @ right.T` over the patterns."""
    return jax.lax.dot_general(left, right, (((1,), (1,)), ((), ())))


class PerceptronRule(AbstractRule):
    """Rosenblatt's rule for one layer of hard limiters (Eqn. 3.4-1): dW = x'(t - y).

    For targets that can be separated by a hyperplane, sequential training ends in finitely many
    steps from any weights.
    """

    @property
    def name(self) -> str:
        return "perceptron rule"

    def check_network(self, network: AdaptiveNetwork) -> str | None:
        plain = len(network.subnetworks) == 1 and not network.subnetworks[0].contexts
        if not plain or not network.single_adaptive_layer:
            return "the perceptron rule trains one layer only: hidden nodes have no target (3.4.1)"
        if network.activation != HARD_LIMITER:
            return f"the perceptron rule trains hard limiters, not a {network.activation.name}"
        return None

    def change(
        self,
        network: AdaptiveNetwork,
        weights: Weights,
        signals: Signals,
        targets: Numbers,
        counts: Counts,
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        passage = network.forward(weights, signals)
        errors = (targets - network.activation.value(passage.total)) * of_subnetwork(counts, 0)
        move = transposed_product(errors, passage.layer_inputs[0][0])
        return change_of_weights(network, [move], learning)


class Backpropagation(AbstractRule):
    """Gradient descent on half the sum of squared errors (Eqns. 3.4-2 to 3.4-9).

    Through any number of adaptive layers and context-sensitive ones, and through the layers that
    compute context-sensitive weights (3.3.5). The change of a shared
    weight is its gradient, by the chain rule through every link's multiple, divided by how many
    links share it (5.2.6): at one rate for all layers it vanishes where the gradient does.

    Pairs that count for some subnetworks only (7.2.2) have errors in these alone. The change is
    then the gradient of no cost, and training ends at `NormalEquations.solution`.
    """

    @property
    def name(self) -> str:
        return "backpropagation"

    def check_network(self, network: AdaptiveNetwork) -> str | None:
        activations = [layer.activation for _, layer in network.adaptive_layers]
        for activation in (network.activation, *activations):
            if activation.slope is None:
                return (
                    f"backpropagation needs a slope, and a {activation.name} has none; train it"
                    " by the perceptron rule, or take a sigmoid"
                )
        return None

    def change(
        self,
        network: AdaptiveNetwork,
        weights: Weights,
        signals: Signals,
        targets: Numbers,
        counts: Counts,
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        passage = network.forward(weights, signals)
        slope = network.activation.slope
        assert slope is not None, self.check_network(network)
        errors = targets - network.activation.value(passage.total)
        slopes = slope(passage.total)

        moves: list[Array] = []
        for at, subnetwork in enumerate(network.subnetworks):
            delta = errors * of_subnetwork(counts, at) * slopes
            inputs, sums = passage.layer_inputs[at], passage.sums[at]
            end = len(inputs)
            subnetwork_moves: list[Array] = []  # from the last layer to the first
            for number in reversed(range(len(subnetwork.contexts))):
                layer = subnetwork.contexts[number]
                first = end - len(layer.layers)
                if layer.layers:
                    at_weights = layer.backward_to_contexts(delta, passage.values[at][number])
                    subnetwork_moves += _moves_back(
                        layer.layers, weights, at_weights, inputs[first:end], sums[first:end]
                    )
                delta = layer.backward(delta, passage.contexts[at][number])
                end = first
            subnetwork_moves += _moves_back(
                subnetwork.layers, weights, delta, inputs[:end], sums[:end]
            )
            moves += reversed(subnetwork_moves)
        return change_of_weights(network, moves, learning)


def _moves_back(
    layers: Sequence[Layer],
    weights: Weights,
    delta: Float[Array, "nodes patterns"],
    inputs: Sequence[Array],
    sums: Sequence[Array],
) -> list[Array]:
    """Moves of the links of adaptive layers in a row, from the last layer to the first.

    - `delta`: errors carried back to the outputs of the last layer.
    """
    moves: list[Array] = []
    for number in reversed(range(len(layers))):
        layer = layers[number]
        # The linear combiner's slope of one is skipped, as is the output layer's, whose
        # activation is the network's.
        if layer.activation.slope not in (None, jnp.ones_like):
            delta = delta * layer.activation.slope(sums[number])  # pyright: ignore[reportOptionalCall]
        moves.append(transposed_product(delta, inputs[number]))
        if number > 0:
            delta = (layer.links.matrix(weights).T @ delta)[: layer.inputs]
    return moves

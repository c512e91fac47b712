from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..adaptive import HARD_LIMITER, AdaptiveNetwork, Layer, Signals
from ._rules import (
    AbstractRule,
    Counts,
    Numbers,
    Weights,
    change_of_weights,
    of_subnetwork,
    transposed_product,
)


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

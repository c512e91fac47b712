from jaxtyping import Array, Float

from ..adaptive import HARD_LIMITER, AdaptiveNetwork, Signals
from ._rules import AbstractRule, Numbers, Weights, change_of_weights, transposed_product


class PerceptronRule(AbstractRule):
    """Rosenblatt's rule for one layer of hard limiters (Eqn. 3.4-1): dW = x'(t - y).

    For targets that can be separated by a hyperplane, sequential training ends in finitely many
    steps from any weights.
    """

    @property
    def name(self) -> str:
        return "perceptron rule"

    def refuse(self, network: AdaptiveNetwork) -> str | None:
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
        counts: Numbers,
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        passage = network.forward(weights, signals)
        errors = (targets - network.activation.value(passage.total)) * counts
        move = transposed_product(errors, passage.given[0][0])
        return change_of_weights(network, [move], learning)

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..adaptive import AdaptiveNetwork, Signals
from ._rules import AbstractRule, Numbers, Weights, change_of_weights, transposed_product


class PERAL(AbstractRule):
    """Proportional error allocation (thesis 6.2): each link takes its share of the error.

    The value that a link passes on is moved by a part of the node's error, in proportion to the
    modulus of what it contributes now (Eqns. 6.2-1 to 6.2-7). A link that passes nothing takes
    nothing, so that a weight of zero stays zero: the rule is for tuning weights that another
    rule has found roughly.

    One adaptive layer, followed by any number of context-sensitive ones: the thesis has one
    (Eqn. 6.2-4); the velocity subnetwork of a CSLC has two, and the step through them is taken
    twice. Where subnetworks meet in one output node, the node's error is shared among the links
    of all of them. For a weight that links share, a link asks for the change that moves what it
    passes on as wanted, its multiple notwithstanding, and the average over links is taken
    (5.2.6). The scan prints x_j under the sum of Eqn. 6.2-6; Eqn. 6.2-7 has every x_m.
    """

    @property
    def name(self) -> str:
        return "PERAL"

    def refuse(self, network: AdaptiveNetwork) -> str | None:
        return refuse(network)

    def refuse_start(
        self, network: AdaptiveNetwork, weights: np.ndarray, learning: tuple[bool, ...]
    ) -> str | None:
        learnt = np.zeros(network.size, bool)
        for (_, layer), learns in zip(network.adaptive_layers, learning, strict=True):
            if learns:
                learnt[layer.links.weight] = True
        still = ~np.any(weights[..., learnt], axis=-1)
        if np.any(still):
            which = "" if weights.ndim == 1 else f" (training {int(np.argmax(still)) + 1})"
            return (
                f"PERAL cannot start from weights that are all zero{which}: a link's share of the"
                " error is in proportion to what it passes on; train by backpropagation first"
            )
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
        activation = network.activation
        errors = (targets - activation.value(passage.total)) * counts
        wanted = errors if activation.increasing else -errors  # Eqn. 6.2-1

        # Moduli of what the links of each subnetwork's adaptive layer bring to its nodes, and of
        # what its context layers bring to theirs.
        brought: list[list[Array]] = []
        for at, subnetwork in enumerate(network.subnetworks):
            magnitudes = subnetwork.layers[0].links.matrix(weights, magnitude=True)
            own = [magnitudes @ jnp.abs(passage.given[at][0])]
            for layer, value, context in zip(
                subnetwork.contexts, passage.values[at], signals.contexts[at], strict=True
            ):
                own.append(layer.forward(jnp.abs(value), jnp.abs(context)))
            brought.append(own)
        at_outputs = share(wanted, sum((own[-1] for own in brought[1:]), start=brought[0][-1]))

        moves: list[Array] = []
        for at, subnetwork in enumerate(network.subnetworks):
            portion = at_outputs
            for number in reversed(range(len(subnetwork.contexts))):
                layer, value = subnetwork.contexts[number], passage.values[at][number]
                signs = jnp.sign(signals.contexts[at][number])
                each = 1.0 / layer.fan_out.astype(value.dtype)
                moved = jnp.abs(value) * layer.backward(portion, signs) * each[:, None]
                if number == 0 and not subnetwork.layers[0].activation.increasing:
                    moved = -moved  # Eqn. 6.2-5
                portion = share(moved, brought[at][number])
            moves.append(transposed_product(portion, jnp.sign(passage.given[at][0])))
        change = change_of_weights(network, moves, learning, by_sign=True)
        return jnp.abs(weights)[None, :] * change


def refuse(network: AdaptiveNetwork) -> str | None:
    if not network.single_adaptive_layer:
        return (
            "PERAL trains one adaptive layer only: it has no estimate of the error of a node"
            " that precedes another (6.2)"
        )
    activations = [layer.activation for _, layer in network.adaptive_layers]
    for activation in (network.activation, *activations):
        if activation.slope is None:
            return f"PERAL needs continuous activations (6.2), and a {activation.name} is not"
    return None


def share(amount: Array, among: Array) -> Array:
    """`amount / among`, zero where there is nothing to divide it among."""
    empty = among == 0
    return jnp.where(empty, 0.0, amount / jnp.where(empty, 1.0, among))

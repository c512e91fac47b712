"""Proportional error allocation (PERAL), practical and ideal (thesis 6.1, 6.2)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._rank import numerical_rank
from ._network import AdaptiveNetwork, Signals
from ._rules import (
    AbstractRule,
    Counts,
    Numbers,
    Weights,
    change_of_weights,
    of_subnetwork,
    transposed_product,
)


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
    (5.2.6). Where a pair counts for some subnetworks only (7.2.2), links of the others have their
    share of its error all the same, and do not move by it. The scan prints x_j under the sum of
    Eqn. 6.2-6; Eqn. 6.2-7 has every x_m.
    """

    @property
    def name(self) -> str:
        return "PERAL"

    def check_network(self, network: AdaptiveNetwork) -> str | None:
        return check_layers(network)

    def check_start(
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
        counts: Counts,
        learning: tuple[bool, ...],
    ) -> Float[Array, "groups weights"]:
        passage = network.forward(weights, signals)
        activation = network.activation
        errors = targets - activation.value(passage.total)

        # Moduli of what the links of each subnetwork's adaptive layer bring to its nodes, and of
        # what its context layers bring to theirs.
        brought: list[list[Array]] = []
        for at, subnetwork in enumerate(network.subnetworks):
            magnitudes = subnetwork.layers[0].links.matrix(weights, magnitude=True)
            moduli = [magnitudes @ jnp.abs(passage.layer_inputs[at][0])]
            for layer, value, context in zip(
                subnetwork.contexts, passage.values[at], signals.contexts[at], strict=True
            ):
                moduli.append(layer.forward(jnp.abs(value), jnp.abs(context)))
            brought.append(moduli)
        at_outputs = sum((moduli[-1] for moduli in brought[1:]), start=brought[0][-1])

        moves: list[Array] = []
        for at, subnetwork in enumerate(network.subnetworks):
            counted = errors * of_subnetwork(counts, at)
            wanted = counted if activation.increasing else -counted  # Eqn. 6.2-1
            portion = share(wanted, at_outputs)
            for number in reversed(range(len(subnetwork.contexts))):
                layer, value = subnetwork.contexts[number], passage.values[at][number]
                signs = jnp.sign(signals.contexts[at][number])
                inverse_fan_out = 1.0 / layer.fan_out.astype(value.dtype)
                moved = jnp.abs(value) * layer.backward(portion, signs) * inverse_fan_out[:, None]
                if number == 0 and not subnetwork.layers[0].activation.increasing:
                    moved = -moved  # Eqn. 6.2-5
                portion = share(moved, brought[at][number])
            moves.append(transposed_product(portion, jnp.sign(passage.layer_inputs[at][0])))
        change = change_of_weights(network, moves, learning, by_sign=True)
        return jnp.abs(weights)[None, :] * change


def check_layers(network: AdaptiveNetwork) -> str | None:
    """Return why proportional allocation cannot train such a network; None if it can."""
    if any(layer.layers for subnetwork in network.subnetworks for layer in subnetwork.contexts):
        return (
            "PERAL cannot train weights that a subnetwork computes (3.3.5): it allocates errors to"
            " what context-sensitive links weigh, and none to their weights (6.2)"
        )
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


class IdealPERAL(AbstractRule):
    """PERAL with the optimum known (thesis 6.1), to study what the practical form approximates.

    Errors are allocated in proportion to what each link would contribute at the optimum:
    dw_j = sgn(x_j) |w*_j| e / sum |x_m w*_m|. The scan prints sgn(w_j) in Eqn. 6.1-3; Eqn. 6.1-2,
    from which it follows, the rank condition on the signs of inputs, and Eqn. 6.2-6 all have
    sgn(x_j).

    One layer, without context. `train` refuses patterns that `check_sign_rank` refuses: they
    cannot lead to the optimum.

    **Attributes**

    - `optimum`: (p,) the optimal weights.
    """

    optimum: Float[Array, " weights"]

    @property
    def name(self) -> str:
        return "ideal PERAL"

    def check_network(self, network: AdaptiveNetwork) -> str | None:
        if any(subnetwork.contexts for subnetwork in network.subnetworks):
            return "ideal PERAL is stated for one layer without context-sensitive weights (6.1)"
        if self.optimum.shape != (network.size,):
            return (
                f"ideal PERAL needs the optimum of all {network.size} weights, got shape"
                f" {self.optimum.shape}"
            )
        return check_layers(network)

    def check_start(
        self, network: AdaptiveNetwork, weights: np.ndarray, learning: tuple[bool, ...]
    ) -> str | None:
        del learning
        stuck = np.atleast_2d(weights).any(axis=0) & (np.asarray(self.optimum) == 0)
        if stuck.any():
            return (
                f"ideal PERAL cannot move {network.names[int(np.argmax(stuck))]}: it is zero at"
                " the optimum, so that no error is allocated to it (6.1); start it at zero"
            )
        return None

    def check_patterns(
        self, network: AdaptiveNetwork, signals: Signals, counts: Counts
    ) -> str | None:
        for at, subnetwork in enumerate(network.subnetworks):
            layer, inputs = subnetwork.layers[0], signals.inputs[at]
            seen = np.asarray(layer.with_bias(jnp.asarray(inputs)))
            # Nodes that see the same inputs of the same patterns are looked at once.
            views = {
                (tuple(layer.links.source[layer.links.node == node]), taken.tobytes()): taken
                for node, taken in enumerate(np.asarray(of_subnetwork(counts, at)) > 0)
            }
            for (sources, _), taken in views.items():
                try:
                    check_sign_rank(seen[list(sources)][:, taken].T)
                except ValueError as error:
                    return f"ideal PERAL: {error}"
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
        errors = targets - network.activation.value(passage.total)
        wanted = errors if network.activation.increasing else -errors
        brought = [
            subnetwork.layers[0].links.matrix(self.optimum, magnitude=True) @ jnp.abs(inputs[0])
            for subnetwork, inputs in zip(network.subnetworks, passage.layer_inputs, strict=True)
        ]
        at_outputs = sum(brought[1:], start=brought[0])
        moves: list[Array] = []
        for at, inputs in enumerate(passage.layer_inputs):
            portion = share(wanted * of_subnetwork(counts, at), at_outputs)
            moves.append(transposed_product(portion, jnp.sign(inputs[0])))
        change = change_of_weights(network, moves, learning, by_sign=True)
        return jnp.abs(self.optimum)[None, :] * change


def check_sign_rank(inputs: Float[Array | np.ndarray, "patterns inputs"]) -> None:
    """The condition under which ideal PERAL can lead to the optimum (thesis 6.1).

    Patterns whose inputs have the same signs act as one. The signs of all patterns' inputs, one
    row a pattern, must therefore have as many independent rows as there are weights. This is
    necessary. It is sufficient for two weights; for three or more it is not, though 6.1 says so:
    the patterns (3, 1, 1), (1, 3, -1) and (1, -1, 3) with an optimum of ones lead away from it
    at any rate. With ten patterns a weight, of independent signs, such cases are rare.

    - `inputs`: (patterns, inputs), the constant of a bias among them.

    **Raises** `ValueError` with the rank found and the inputs that it leaves together.

    >>> import numpy as np
    >>> from jaxcslc.training import check_sign_rank
    >>> check_sign_rank(np.asarray([[1.0, -2.0], [3.0, 4.0]]))
    >>> check_sign_rank(np.asarray([[1.0, 2.0], [3.0, 4.0]]))
    Traceback (most recent call last):
    ValueError: input signs have rank 1, expected 2, one a weight: over all patterns, the signs \
of inputs 1, 2 are not independent (thesis 6.1); record patterns that differ in them
    """
    signs = np.sign(np.asarray(inputs, float))
    if signs.ndim != 2:
        raise ValueError(f"inputs: expected shape (patterns, inputs), got {signs.shape}")
    rank = numerical_rank(signs)
    if rank < signs.shape[1]:
        _, _, right = np.linalg.svd(signs, full_matrices=True)
        involved = np.flatnonzero(np.abs(right[rank:]).max(axis=0) > 1e-9) + 1
        raise ValueError(
            f"input signs have rank {rank}, expected {signs.shape[1]}, one a weight: over all"
            f" patterns, the signs of inputs {', '.join(map(str, involved))} are not independent"
            " (thesis 6.1); record patterns that differ in them"
        )

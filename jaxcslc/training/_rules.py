"""Learning rules: perceptron rule, backpropagation (thesis 3.4), proportional error allocation (6).

A rule states how far an epoch moves the weights at a rate of one.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._rank import numerical_rank
from ._functions import HARD_LIMITER
from ._network import AdaptiveNetwork, Layer, Links, Passage, Signals


# An input with a larger entry of a unit vector is part of the dependence that it describes.
_INVOLVED = 1e-9

Weights = Float[Array, " weights"]
Numbers = Float[Array, "outputs patterns"]
#: One where a pair of output and pattern takes part in learning, zero where it is masked: for all
#: subnetworks, or for each.
Counts = Float[Array, "*subnetworks outputs patterns"]
#: What every adaptive layer's links are moved by: (nodes, inputs) each, of sizes that differ.
Moves = Sequence[Float[Array, "_ _"]]


class Presentation(NamedTuple):
    """Patterns that were presented to a network, as a learning rule sees them.

    - `passage`: forward, with these weights.
    - `errors`: target less output, at the output nodes.
    - `counts`: of the pairs, for all subnetworks or for each.
    """

    network: AdaptiveNetwork
    weights: Weights
    passage: Passage
    errors: Numbers
    counts: Counts

    def masked_errors(self, subnetwork: int) -> Numbers:
        """Return the errors that a subnetwork learns from; zero for pairs that do not count."""
        return self.errors * subnetwork_counts(self.counts, subnetwork)


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
    def moves(self, shown: Presentation) -> Moves:
        """Compute what the links of every adaptive layer are moved by, at a rate of one."""

    def proportions(self, weights: Weights) -> Weights | None:
        """Return what links are moved in proportion to, for rules that move what links pass on.

        A link's known multiple then enters by its sign only; otherwise as it is, by the chain rule.
        """
        del weights
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
        """Compute each adaptive layer's contribution to the change of the weights, (groups, p).

        It is zero for weights that none of the layer's links has.

        - `signals`, `targets`: as in `Examples`.
        - `counts`: (outputs, patterns), or (subnetworks, outputs, patterns): a node's error then
          passes to a subnetwork only where the pair counts for it (7.2.2).
        - `learning`: which layers take part; shared weights move by the average over the links
          of those that do (5.2.6).
        """
        passage = network.forward(weights, signals)
        errors = targets - network.activation.value(passage.total)
        moves = self.moves(Presentation(network, weights, passage, errors, counts))
        sizes = self.proportions(weights)
        change = weight_changes(network, moves, learning, by_sign=sizes is not None)
        return change if sizes is None else jnp.abs(sizes)[None, :] * change


def subnetwork_counts(counts: Counts, number: int) -> Numbers:
    """Return the counts of one subnetwork."""
    return counts[number] if counts.ndim == 3 else counts


def weight_changes(
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

    def moves(self, shown: Presentation) -> Moves:
        return [transposed_product(shown.masked_errors(0), shown.passage.layer_inputs[0][0])]


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

    def moves(self, shown: Presentation) -> Moves:
        network, weights, passage = shown.network, shown.weights, shown.passage
        slope = network.activation.slope
        assert slope is not None, self.check_network(network)
        slopes = slope(passage.total)

        moves: list[Array] = []
        for at, subnetwork in enumerate(network.subnetworks):
            delta = shown.masked_errors(at) * slopes
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
        return moves


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


class AbstractProportionalRule(AbstractRule):
    """A rule that allocates errors to links in proportion to what they bring (thesis 6)."""

    @abstractmethod
    def proportions(self, weights: Weights) -> Weights:
        """Return the weights whose links' contributions are what errors are in proportion to."""

    def moves(self, shown: Presentation) -> Moves:
        network, passage = shown.network, shown.passage
        sizes = self.proportions(shown.weights)
        # Moduli of what the links of each subnetwork's adaptive layer bring to its nodes, and of
        # what its context layers bring to theirs.
        brought: list[list[Array]] = []
        for at, subnetwork in enumerate(network.subnetworks):
            magnitudes = subnetwork.layers[0].links.matrix(sizes, magnitude=True)
            moduli = [magnitudes @ jnp.abs(passage.layer_inputs[at][0])]
            for layer, value, context in zip(
                subnetwork.contexts, passage.values[at], passage.contexts[at], strict=True
            ):
                moduli.append(layer.forward(jnp.abs(value), jnp.abs(context)))
            brought.append(moduli)
        at_outputs = sum((moduli[-1] for moduli in brought[1:]), start=brought[0][-1])

        moves: list[Array] = []
        for at, subnetwork in enumerate(network.subnetworks):
            counted = shown.masked_errors(at)
            wanted = counted if network.activation.increasing else -counted  # Eqn. 6.2-1
            portion = share(wanted, at_outputs)
            for number in reversed(range(len(subnetwork.contexts))):
                layer, value = subnetwork.contexts[number], passage.values[at][number]
                signs = jnp.sign(passage.contexts[at][number])
                inverse_fan_out = 1.0 / layer.fan_out.astype(value.dtype)
                moved = jnp.abs(value) * layer.backward(portion, signs) * inverse_fan_out[:, None]
                if number == 0 and not subnetwork.layers[0].activation.increasing:
                    moved = -moved  # Eqn. 6.2-5
                portion = share(moved, brought[at][number])
            moves.append(transposed_product(portion, jnp.sign(passage.layer_inputs[at][0])))
        return moves


class PERAL(AbstractProportionalRule):
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

    def proportions(self, weights: Weights) -> Weights:
        return weights


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


class IdealPERAL(AbstractProportionalRule):
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
                for node, taken in enumerate(np.asarray(subnetwork_counts(counts, at)) > 0)
            }
            for (sources, _), taken in views.items():
                try:
                    check_sign_rank(seen[list(sources)][:, taken].T)
                except ValueError as error:
                    return f"ideal PERAL: {error}"
        return None

    def proportions(self, weights: Weights) -> Weights:
        del weights
        return self.optimum


def check_sign_rank(inputs: Float[Array | np.ndarray, "patterns inputs"]) -> None:
    """Return the condition under which ideal PERAL can lead to the optimum (thesis 6.1).

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
        involved = np.flatnonzero(np.abs(right[rank:]).max(axis=0) > _INVOLVED) + 1
        raise ValueError(
            f"input signs have rank {rank}, expected {signs.shape[1]}, one a weight: over all"
            f" patterns, the signs of inputs {', '.join(map(str, involved))} are not independent"
            " (thesis 6.1); record patterns that differ in them"
        )

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..adaptive import AdaptiveNetwork, Links, Signals


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
        """For histories and messages."""

    @abstractmethod
    def check_network(self, network: AdaptiveNetwork) -> str | None:
        """Why this rule cannot train such a network, in one line; none if it can."""

    def check_start(
        self, network: AdaptiveNetwork, weights: np.ndarray, learning: tuple[bool, ...]
    ) -> str | None:
        """Why this rule cannot start from such weights, in one line; none if it can."""
        del network, weights, learning
        return None

    def check_patterns(
        self,
        network: AdaptiveNetwork,
        signals: Signals,
        counts: Counts,
    ) -> str | None:
        """Why these patterns cannot lead anywhere, in one line; none if they can."""
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
        """What each adaptive layer contributes to the change of the weights, (groups, p); zero for
        weights that none of its links has.

        - `signals`, `targets`: as in `Examples`.
        - `counts`: (outputs, patterns), or (subnetworks, outputs, patterns): a node's error then
          passes to a subnetwork only where the pair counts for it (7.2.2).
        - `learning`: which layers take part; shared weights move by the average over the links
          of those that do (5.2.6).
        """


def of_subnetwork(counts: Counts, number: int) -> Numbers:
    """What counts for one subnetwork."""
    return counts[number] if counts.ndim == 3 else counts


def change_of_weights(
    network: AdaptiveNetwork,
    moves: Moves,
    learning: tuple[bool, ...],
    *,
    by_sign: bool = False,
) -> Float[Array, "groups weights"]:
    """From moves of links to changes of weights: averages over the links that share (5.2.6).

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
    """How many learning links share each weight; one for weights that none has."""
    numbers = np.zeros(size)
    for links, learns in zip(layers, learning, strict=True):
        if learns:
            numbers += np.bincount(links.weight, minlength=size)
    return np.maximum(numbers, 1.0)


def transposed_product(left: Array, right: Array) -> Array:
    """`left @ right.T` over the patterns."""
    return jax.lax.dot_general(left, right, (((1,), (1,)), ((), ())))

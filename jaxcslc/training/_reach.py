from functools import lru_cache

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..adaptive import AdaptiveNetwork, Signals, Subnetwork


def reach(network: AdaptiveNetwork) -> tuple[tuple[int, ...], ...]:
    """For each output, the weights that can change it, in ascending order."""
    return _reach(network.subnetworks)


@lru_cache(maxsize=64)
def _reach(subnetworks: tuple[Subnetwork, ...]) -> tuple[tuple[int, ...], ...]:
    found: list[set[int]] = [set() for _ in range(subnetworks[0].outputs)]
    for subnetwork in subnetworks:
        at: list[set[int]] = [set() for _ in range(subnetwork.layers[0].links.inputs)]
        for layer in subnetwork.layers:
            links = layer.links
            at += [set()] * layer.bias
            nodes: list[set[int]] = [set() for _ in range(links.nodes)]
            for source, node, weight in zip(links.source, links.node, links.weight, strict=True):
                nodes[node] |= at[source] | {int(weight)}
            at = nodes
        for layer in subnetwork.contexts:
            nodes = [set() for _ in range(layer.nodes)]
            for source, node in zip(layer.source, layer.node, strict=True):
                nodes[node] |= at[source]
            at = nodes
        found = [old | new for old, new in zip(found, at, strict=True)]
    return tuple(tuple(sorted(weights)) for weights in found)


def covered(
    network: AdaptiveNetwork, signals: Signals, counts: Float[Array, "outputs patterns"]
) -> Bool[Array, " weights"]:
    """Which weights at least one pair that counts can tell something of.

    Moduli all the way, so that nothing cancels: what counts is carried back to the links of the
    first layer through whatever is not zero. Hidden nodes are taken to answer something.
    """
    total = jnp.zeros(network.size, counts.dtype)
    for subnetwork, inputs, contexts in zip(
        network.subnetworks, signals.inputs, signals.contexts, strict=True
    ):
        back = counts
        for layer, context in zip(reversed(subnetwork.contexts), reversed(contexts), strict=True):
            back = layer.backward(back, jnp.abs(context))
        for number, layer in reversed(list(enumerate(subnetwork.layers))):
            links = layer.links
            values = jnp.abs(inputs) if number == 0 else jnp.ones((layer.inputs, back.shape[-1]))
            sums = links.at_links(back @ layer.given(values).T)
            total = total + links.to_weights(sums, network.size)
            some = links.matrix(jnp.ones(network.size, counts.dtype), magnitude=True)
            back = (some.T @ back)[: layer.inputs]
    return total > 0

from collections.abc import Sequence

from ._network import AdaptiveNetwork, Subnetwork


def network_order(network: AdaptiveNetwork) -> int:
    """The order of a network (thesis 4.2): the largest order of any output.

    The thesis takes it for the least number of independent patterns that determine the weights.
    It is that number for one adaptive layer whose outputs share no weights. Where outputs share
    weights, each pattern says something of a weight several times, and fewer patterns are enough:
    a PUMA 560's CSLC has order 28, which is what joint 2's weights need from joint 2's torque
    alone, and 8 patterns of all joints determine its 43 weights
    (`AbstractLinearNetwork.least_patterns`). Behind several adaptive layers, orders multiply and
    can exceed the number of weights.

    >>> import jaxcslc as jc
    >>> from jaxcslc.adaptive import inverse_dynamics, network_order
    >>> network_order(inverse_dynamics(jc.derive(jc.puma560())))  # thesis 5.2.5
    28
    """
    return max(order_per_output(network))


def order_per_output(network: AdaptiveNetwork) -> tuple[int, ...]:
    """Each output's order (thesis 4.2): its number of weights times the order of what they weigh.

    For one adaptive layer, as many independent patterns determine the output's weights from this
    output alone; see `network_order`.

    Every node counts the independently weighted links that feed it; an output's order is the
    highest product of these counts along a route from inputs to it. Context-sensitive layers
    have no weights of their own: their nodes count the weights that reach them. Weights that
    are shared count once (5.2.5: joint 2's 28 of a PUMA 560). Activations are taken to be
    strictly increasing or decreasing, and the network to be in its most compact form.

    **Raises** `ValueError` if layers compute context-sensitive weights: values may be scaled
    against such weights, so that no number of patterns determines both.
    """
    for subnetwork in network.subnetworks:
        if any(layer.layers for layer in subnetwork.contexts):
            raise ValueError(
                f"network order: subnetwork {subnetwork.name!r} computes weights (3.3.5), which may"
                " be scaled against what they weigh; no number of patterns determines both"
            )
    reached = [_reach(subnetwork) for subnetwork in network.subnetworks]
    return tuple(
        len(frozenset[int]().union(*(weights[output] for weights, _ in reached)))
        * max(before[output] for _, before in reached)
        for output in range(network.outputs_count)
    )


def _reach(subnetwork: Subnetwork) -> tuple[Sequence[frozenset[int]], Sequence[int]]:
    """For each last node: the weights since the last adaptive layer, and the order before it."""
    weights: list[frozenset[int]] = []
    before: list[int] = []
    orders = [1] * subnetwork.layers[0].inputs
    for layer in subnetwork.layers:
        sources = [*orders, 1] if layer.bias else orders
        links = layer.links
        weights = [frozenset[int]()] * links.nodes
        before = [1] * links.nodes
        for source, node, weight in zip(links.source, links.node, links.weight, strict=True):
            weights[node] |= {int(weight)}
            before[node] = max(before[node], sources[source])
        orders = [max(len(w), 1) * b for w, b in zip(weights, before, strict=True)]
    for layer in subnetwork.contexts:
        further = [frozenset[int]()] * layer.nodes
        highest = [1] * layer.nodes
        for source, node in zip(layer.source, layer.node, strict=True):
            further[node] |= weights[source]
            highest[node] = max(highest[node], before[source])
        weights, before = further, highest
    return weights, before

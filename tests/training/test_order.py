"""Network order (thesis 4.2): its worked example, the rules of the text, and the CSLC's 28."""

import numpy as np
import pytest

from jaxcslc import CSLC
from jaxcslc.training import (
    LINEAR_COMBINER,
    AdaptiveNetwork,
    ContextLayer,
    Layer,
    Links,
    Signals,
    Subnetwork,
    fully_connected,
    inverse_dynamics,
    network_order,
    order_per_output,
)


def network_of(*subnetworks: Subnetwork) -> AdaptiveNetwork:
    """Whose order is asked for only."""

    def none(patterns: object) -> Signals:
        raise NotImplementedError

    size = 1 + max(int(x.links.weight.max()) for s in subnetworks for x in s.layers)
    names = tuple(f"w{index}" for index in range(size))
    return AdaptiveNetwork(subnetworks, none, LINEAR_COMBINER, names)


def linked(inputs: int, nodes: int, pairs: list[tuple[int, int]], first: int = 0) -> Links:
    source, node = zip(*pairs, strict=True)
    return Links(inputs, nodes, source, node, range(first, first + len(pairs)))


def test_the_worked_example() -> None:
    """Fig. 4.2-1: hidden nodes of orders 2, 3, 3, 2; y1 from the first two, y2 from the others and
    one of them: 6, 9, and 9 for the network."""
    hidden = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2), (1, 3), (2, 3)]
    outputs = [(0, 0), (1, 0), (0, 1), (2, 1), (3, 1)]
    first, second = linked(3, 4, hidden), linked(4, 2, outputs, first=len(hidden))
    network = network_of(Subnetwork("network", (Layer(first), Layer(second))))
    assert order_per_output(network) == (6, 9)
    assert network_order(network) == 9


@pytest.mark.parametrize(("inputs", "nodes"), [(1, 1), (5, 1), (7, 10)])
def test_one_full_layer_has_the_order_of_its_inputs(inputs: int, nodes: int) -> None:
    for kind in ("linear combiner", "hyperbolic tangent"):
        network = fully_connected([inputs, nodes], kind, bias=False)
        assert order_per_output(network) == (inputs,) * nodes
        assert network_order(fully_connected([inputs, nodes], kind)) == inputs + 1


def test_full_layers_multiply() -> None:
    network = fully_connected([3, 4, 5, 2], "logistic", bias=False)
    assert order_per_output(network) == (3 * 4 * 5,) * 2
    assert network_order(fully_connected([3, 4, 2], "logistic")) == (3 + 1) * (4 + 1)


def test_shared_weights_count_once() -> None:
    shared = Links(
        3, 2, [0, 1, 2, 0, 1], [0, 0, 0, 1, 1], [0, 0, 1, 2, 3], [1.0, -2.0, 1.0, 1.0, 1.0]
    )
    assert order_per_output(network_of(Subnetwork("a", (Layer(shared),)))) == (2, 2)
    # Also where subnetworks share them.
    again = Links(1, 2, [0, 0], [0, 1], [0, 0])
    both = network_of(Subnetwork("a", (Layer(shared),)), Subnetwork("b", (Layer(again),)))
    assert order_per_output(both) == (2, 3)


def test_context_layers_have_no_weights_of_their_own() -> None:
    links = linked(3, 3, [(0, 0), (1, 0), (1, 1), (2, 2)])
    context = ContextLayer(3, 2, 2, (0, 1, 2, 2), (0, 0, 0, 1), (0, 1, 0, 1))
    network = network_of(Subnetwork("a", (Layer(links),), (context,)))
    assert order_per_output(network) == (4, 1)


def test_an_output_without_weights_has_none() -> None:
    network = network_of(Subnetwork("a", (Layer(linked(2, 2, [(0, 0), (1, 0)])),)))
    assert order_per_output(network) == (2, 0)


def test_a_longer_route_beside_a_short_one() -> None:
    """The definition of 4.2: a node's links times those of the nodes on the best route to it."""
    deep = fully_connected([2, 3, 1], "linear combiner", bias=False).subnetworks[0]
    flat = Subnetwork("flat", (Layer(Links.full(4, 1, first=9)),))
    assert order_per_output(network_of(deep, flat)) == ((3 + 4) * 2,)


def test_the_cslc_s_orders(puma: CSLC) -> None:
    """5.2.5: 28, because of joint 2; per joint the errata's 20, 21, 17, 10, 8 and 2 mass, joint
    2's five gravity coefficients and what the text leaves for others, and two of friction."""
    network = inverse_dynamics(puma)
    assert network_order(network) == 28 == puma.order
    assert order_per_output(network) == puma.order_per_joint
    alone = [s for s in network.subnetworks if s.name in ("mass", "velocity")]
    rigid = AdaptiveNetwork(tuple(alone), network.preprocess, network.activation, network.names)
    assert order_per_output(rigid) == (20, 21, 17, 10, 8, 2)
    friction = np.array(order_per_output(network)) - np.array(order_per_output(rigid))
    assert friction[1] == 5 + 1 + 1

"""Smaller network instead of one of which some weights are pruned.

`jaxcslc.training.prune` decides which weights go. `compact` removes their links, and the nodes
and inputs that nothing passes through any more.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._network import AdaptiveNetwork, ContextLayer, Layer, Links, Signals, Subnetwork


# Of links or units, which are left.
_Left = Bool[np.ndarray, " _"]


def compact(
    network: AdaptiveNetwork,
    weights: Float[Array | np.ndarray, " _"],
    kept: Bool[Array | np.ndarray, " _"],
) -> tuple[AdaptiveNetwork, Float[Array, " left"]]:
    """Return the network without the links of weights that are not kept (thesis 3.6.2).

    The smaller network answers what the given one answers with zeros for the weights that are not
    kept. A node goes with all its links if no link leads from it to an output, or if it always
    answers zero. Inputs, contexts and subnetworks that nothing reads go, too. Names of weights and
    subnetworks carry over. A CSLC loses the links of a coefficient in every subnetwork; the
    derivation is as it was.

    **Arguments**

    - `network`: p weights.
    - `weights`: (p,).
    - `kept`: (p,) False where a weight is pruned.

    **Returns** the smaller network, and the weights that are left in it, (q,).

    **Raises** `ValueError` for other shapes, or if no link that is left leads to an output.

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.training import compact, fully_connected
    >>> network = fully_connected([2, 3, 1], ["hyperbolic tangent", "linear combiner"])
    >>> kept = np.ones(network.size, bool)
    >>> kept[[9, 11]] = False  # the links from hidden nodes 1 and 3 to the output
    >>> smaller, weights = compact(network, jnp.ones(network.size), kept)
    >>> smaller.names
    ('layer 1, node 2, input 1', 'layer 1, node 2, input 2', 'layer 1, node 2, bias', \
'layer 2, node 1, input 2', 'layer 2, node 1, bias')
    """
    values, left = jnp.asarray(weights), np.asarray(kept, bool)
    if values.shape != (network.size,) or left.shape != (network.size,):
        raise ValueError(
            f"weights, kept: expected shape ({network.size},), got {values.shape} and {left.shape}"
        )
    parts = [_Part(subnetwork, left) for subnetwork in network.subnetworks]
    alive = [at for at, part in enumerate(parts) if part.reaches_an_output]
    if not alive:
        raise ValueError("kept: no link that is left leads from an input or a bias to an output")
    used = np.unique(np.concatenate([parts[at].weights for at in alive]))
    number = np.zeros(network.size, int)
    number[used] = np.arange(len(used))
    smaller = AdaptiveNetwork(
        tuple(parts[at].rebuilt(number) for at in alive),
        _Selected(network.preprocess, tuple((at, *parts[at].rows) for at in alive)),
        network.activation,
        tuple(network.names[index] for index in used),
    )
    return smaller, values[used]


class _Selected(eqx.Module):
    """The part of the signals that a smaller network takes.

    **Attributes**

    - `preprocess`: of the network that it was.
    - `rows`: for each subnetwork its index, its rows of inputs, and those of each context layer.
    """

    preprocess: Callable[[Any], Signals]
    rows: tuple[tuple[int, tuple[int, ...], tuple[tuple[int, ...], ...]], ...] = eqx.field(
        static=True
    )

    def __call__(self, patterns: Any) -> Signals:
        signals = self.preprocess(patterns)
        return Signals(
            tuple(signals.inputs[at][np.array(rows)] for at, rows, _ in self.rows),
            tuple(
                tuple(
                    context[np.array(rows)]
                    for context, rows in zip(signals.contexts[at], of_contexts, strict=True)
                )
                for at, _, of_contexts in self.rows
            ),
        )


class _Chain:
    """Adaptive layers in a row: which links and units are left.

    - `links`: of every layer.
    - `units`: the inputs, and the nodes of every layer.
    """

    def __init__(self, layers: Sequence[Layer], inputs: int, kept: _Left) -> None:
        self.layers = layers
        self.links = [kept[layer.links.weight] for layer in layers]
        self.units = [np.ones(inputs, bool)]
        for layer, left in zip(layers, self.links, strict=True):
            left &= self._sources(layer, self.units[-1])[layer.links.source]
            of_zero = float(layer.activation.value(jnp.zeros(())))
            answering = np.full(layer.links.nodes, of_zero != 0)
            answering[layer.links.node[left]] = True
            self.units.append(answering)

    def need(self, outputs: _Left) -> None:
        """Leave what leads to the outputs that are needed."""
        self.units[-1] = outputs
        for at in reversed(range(len(self.layers))):
            links, left = self.layers[at].links, self.links[at]
            left &= self.units[at + 1][links.node]
            self.units[at] = _marked(links.source[left], links.inputs)[: self.layers[at].inputs]
        self.units = [_one_at_least(units) for units in self.units]

    @staticmethod
    def _sources(layer: Layer, units: _Left) -> _Left:
        return np.append(units, True) if layer.bias else units

    @property
    def weights(self) -> Iterable[Int[np.ndarray, " _"]]:
        for layer, left in zip(self.layers, self.links, strict=True):
            yield layer.links.weight[left]

    def rebuilt(self, number: Int[np.ndarray, " weights"]) -> tuple[Layer, ...]:
        """The layers with what is left; `number` is the new index of each weight."""
        layers: list[Layer] = []
        for at, (layer, left) in enumerate(zip(self.layers, self.links, strict=True)):
            old = layer.links
            bias = layer.bias and bool(np.any(old.source[left] == layer.inputs))
            sources, nodes = self._sources(layer, self.units[at]), self.units[at + 1]
            links = Links(
                int(self.units[at].sum()) + bias,
                int(nodes.sum()),
                _renumbered(sources)[old.source[left]],
                _renumbered(nodes)[old.node[left]],
                number[old.weight[left]],
                old.multiple[left],
            )
            layers.append(Layer(links, layer.activation, bias))
        return tuple(layers)


class _Part:
    """A subnetwork: which of its links and units are left."""

    def __init__(self, subnetwork: Subnetwork, kept: _Left) -> None:
        self.subnetwork = subnetwork
        self.values = _Chain(subnetwork.layers, subnetwork.layers[0].inputs, kept)
        self.computing = [
            _Chain(layer.layers, layer.context_inputs, kept) for layer in subnetwork.contexts
        ]
        # Forward: links that carry something. Units are the sources of each context layer.
        self.links: list[_Left] = []
        self.units: list[_Left] = []
        answering = self.values.units[-1]
        for layer, chain in zip(subnetwork.contexts, self.computing, strict=True):
            self.units.append(answering)
            self.links.append(
                answering[_array(layer.source)] & chain.units[-1][_array(layer.context)]
            )
            answering = _marked(_array(layer.node)[self.links[-1]], layer.nodes)
        last = self.links[-1] if self.links else self.values.links[-1]
        self.reaches_an_output = bool(np.any(last))
        # Back: links that lead to an output. All outputs stay.
        needed = np.ones(subnetwork.outputs, bool)
        self.units.append(needed)
        for at in reversed(range(len(self.links))):
            layer, left = subnetwork.contexts[at], self.links[at]
            left &= needed[_array(layer.node)]
            self.computing[at].need(_marked(_array(layer.context)[left], layer.contexts))
            needed = _marked(_array(layer.source)[left], layer.inputs)
            self.units[at] = _one_at_least(needed)
        self.values.need(needed)

    @property
    def weights(self) -> Int[np.ndarray, " _"]:
        """Indices of the weights of the remaining links, one per link."""
        chains = [self.values, *self.computing]
        return np.concatenate([weights for chain in chains for weights in chain.weights])

    @property
    def rows(self) -> tuple[tuple[int, ...], tuple[tuple[int, ...], ...]]:
        """Indices of the remaining inputs, and of the remaining values of each context layer."""
        first, *others = (
            tuple(np.flatnonzero(chain.units[0]).tolist())
            for chain in (self.values, *self.computing)
        )
        return first, tuple(others)

    def rebuilt(self, number: Int[np.ndarray, " weights"]) -> Subnetwork:
        contexts: list[ContextLayer] = []
        for at, layer in enumerate(self.subnetwork.contexts):
            chain, left = self.computing[at], self.links[at]
            ends = (
                (self.units[at], layer.source),
                (self.units[at + 1], layer.node),
                (chain.units[-1], layer.context),
            )
            source, node, context = (
                tuple(_renumbered(units)[_array(indices)[left]].tolist()) for units, indices in ends
            )
            inputs, nodes, values = (int(units.sum()) for units, _ in ends)
            computing = chain.rebuilt(number)
            contexts.append(ContextLayer(inputs, nodes, values, source, node, context, computing))
        return Subnetwork(self.subnetwork.name, self.values.rebuilt(number), tuple(contexts))


def _array(indices: Sequence[int]) -> Int[np.ndarray, " _"]:
    return np.array(indices, int)


def _marked(indices: Int[np.ndarray, " _"], size: int) -> _Left:
    marks = np.zeros(size, bool)
    marks[indices] = True
    return marks


def _one_at_least(units: _Left) -> _Left:
    """A layer has a unit, be it one without links, where a bias alone is left behind it."""
    return units if units.any() else _marked(np.zeros(1, int), len(units))


def _renumbered(units: _Left) -> Int[np.ndarray, " _"]:
    """The new index of each unit that is left."""
    return np.cumsum(units) - 1

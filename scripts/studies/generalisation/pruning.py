"""Pruning: removal of links that a network's training-set error does not need (thesis 3.6.2).

`prune` decides which weights go. `compact` builds the smaller network: it removes their links, and
the nodes and inputs that nothing passes through any more.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxcslc.training import AdaptiveNetwork, ContextLayer, Layer, Links, Signals, Subnetwork


@dataclasses.dataclass(frozen=True)
class LinkEnds:
    """Nodes that each weight's link leads from and leads to.

    Nodes have numbers of the caller's choice. Inputs are nodes, and so is the constant input of
    biases. A weight that belongs to a node without being a link (the width of a radial basis
    function, say) may come from any node that is no node of the network, such as -1.

    **Attributes**

    - `source`: (p,) the node that each weight's link leads from.
    - `target`: (p,) the node that it leads to.

    **Raises**

    - `ValueError`: `source` and `target` of different lengths.
    """

    source: Int[np.ndarray, " source"]
    target: Int[np.ndarray, " target"]

    def __post_init__(self) -> None:
        if self.source.size != self.target.size:
            raise ValueError(
                f"links have {self.source.size} sources and {self.target.size} targets; expected"
                " one of each for every weight"
            )


@dataclasses.dataclass(frozen=True)
class Pruning:
    """Result of pruning a network: what is left, and what was removed.

    **Attributes**

    - `kept`: (p,) False where a weight was removed.
    - `weights`: (p,) those given, zero where removed.
    - `cost_before`, `cost_after`: of the weights given and of those left.
    - `sensitivity`: (p,) how much the cost rose when a weight alone was removed from the network
      as it was given; NaN for weights that are not tested.
    - `removed`: (removed,) indices of the weights removed, in that order.
    - `nodes`: the nodes removed because nothing led from them any more.
    - `passes`: how often all links left were tested.
    - `finished`: whether no link is left that could go; if not, the passes ran out.
    """

    kept: Bool[np.ndarray, " p"]
    weights: Float[np.ndarray, " p"]
    cost_before: float
    cost_after: float
    sensitivity: Float[np.ndarray, " p"]
    removed: Int[np.ndarray, " removed"]
    nodes: tuple[int, ...]
    passes: int
    finished: bool

    def compact(self, network: AdaptiveNetwork) -> tuple[AdaptiveNetwork, Float[Array, " left"]]:
        """Return the network without what is removed, and its weights: see
        `jaxcslc.training.compact`.

        **Raises** `ValueError` if the network has another number of weights.
        """
        return compact(network, self.weights, self.kept)

    def __str__(self) -> str:
        return (
            f"{self.removed.size} of {self.kept.size} weights removed"
            f" ({len(self.nodes)} nodes), cost {self.cost_before:.4g} -> {self.cost_after:.4g},"
            f" {self.passes} passes{'' if self.finished else ', not finished'}"
        )


def prune(
    cost: Callable[..., Any],
    weights: Float[Array | np.ndarray, " p"],
    links: LinkEnds | None = None,
    *,
    tolerance: float = 0.01,
    args: tuple[Any, ...] = (),
    tested: Bool[np.ndarray, " tested"] | None = None,
    passes: int | None = None,
) -> Pruning:
    """Remove the links to which a network's training-set error is not sensitive (3.6.2).

    To remove a link is to make its weight zero. An increase is *marked* when it takes the cost
    above (1 + `tolerance`) times the cost of the network as it was given: the increases of all
    removals together count, so that many small ones do not add up to a spoilt network. In passes:

    1. Each link left is removed alone. Those whose removal alone is a marked increase stay.
    2. The others are removed one after the other, the least sensitive first. One whose removal,
       on top of those before it, is a marked increase is restored.
    3. A node that had links leading from it, and has lost all of them, is removed at once with all
       that lead to it, which may leave further nodes so.

    Passes end when no link can go alone any more. The thesis describes a single pass in no stated
    order; `passes=1` is that.

    **Arguments**

    - `cost`: weights (p,), and `args`, to a scalar: the error of the training set. Anything that
      JAX can compile: a network of Equinox by `jax.flatten_util.ravel_pytree`, for one.
    - `weights`: (p,) as trained.
    - `links`: from where to where; without it no nodes are removed.
    - `tolerance`: relative, 0 or more.
    - `args`: more arguments of `cost`, arrays or pytrees of them. Calls with the same `cost` and
      arrays of the same shapes compile once.
    - `tested`: (p,) which weights may be removed for themselves, by default all. The others, of
      which zero does not mean 'no link' (centres, widths), go with their node.
    - `passes`: at most so many; by default as many as it takes.

    **Returns** a `Pruning`.

    **Raises**

    - `ValueError`: a tolerance or number of passes that makes no sense, arrays that do not
      fit the weights, a cost that is no scalar or not finite, or nothing to test.

    >>> import jax.numpy as jnp, numpy as np
    >>> from scripts.studies.generalisation.pruning import LinkEnds, prune
    >>> x = np.linspace(-1.0, 1.0, 50)
    >>> def cost(w):  # two hidden nodes; the second barely reaches the output
    ...     return jnp.mean((w[2] * jnp.tanh(w[0] * x) + w[3] * jnp.tanh(w[1] * x) - x) ** 2)
    >>> links = LinkEnds(source=np.array([0, 0, 1, 2]), target=np.array([1, 2, 3, 3]))
    >>> pruned = prune(cost, np.array([0.5, 1.0, 2.0, 1e-4]), links)
    >>> print(pruned)
    2 of 4 weights removed (1 nodes), cost 0.0009543 -> 0.000957, 2 passes
    >>> pruned.nodes
    (2,)
    """
    start = np.asarray(weights, dtype=float)
    may_go = np.ones(start.size, dtype=bool) if tested is None else tested
    _check(start.size, links, may_go, tolerance, passes)
    network = _Wiring(links)

    def cost_of(kept: Bool[np.ndarray, " p"]) -> float:
        return float(_cost(cost, kept, jnp.asarray(weights), args))

    kept = np.ones(start.size, dtype=bool)
    before = cost_of(kept)
    if not np.isfinite(before):
        raise ValueError(f"the cost before pruning is {before}; expected a finite number")
    limit = (1.0 + tolerance) * before
    sensitivity = np.full(start.size, np.nan)
    removed: list[int] = []
    done = 0
    finished = False
    while not finished and (passes is None or done < passes):
        left = np.flatnonzero(kept & may_go)
        alone = np.array([cost_of(network.without(kept, one)) for one in left.tolist()])
        if done == 0:
            sensitivity[left] = alone - before
        done += 1
        order = np.argsort(alone, kind="stable")
        going = left[order][alone[order] <= limit].tolist()
        for one in going:
            trial = network.without(kept, one)
            # It may have gone with a node. A cost that is no number is marked.
            if kept[one] and cost_of(trial) <= limit:
                gone = np.flatnonzero(kept & ~trial).tolist()
                removed += sorted(gone, key=lambda i: not may_go[i])  # the link before its node's
                kept = trial
        finished = not going or not np.any(kept & may_go)
    return Pruning(
        kept,
        np.where(kept, start, 0.0),
        before,
        cost_of(kept),
        sensitivity,
        np.array(removed, dtype=int),
        network.gone(kept),
        done,
        finished,
    )


# One program for all costs: others round differently, and a link without any effect might stay.
@functools.partial(jax.jit, static_argnums=0)
def _cost(
    cost: Callable[..., Any], kept: Bool[Array | np.ndarray, " p"], weights: Array, args: Any
) -> Float[Array, ""]:
    value = jnp.asarray(cost(jnp.where(kept, weights, 0), *args))
    if value.shape != ():
        raise ValueError(f"the cost has shape {value.shape}; expected a scalar for weights (p,)")
    return value


class _Wiring:
    """Removal of nodes whose links were removed."""

    def __init__(self, links: LinkEnds | None) -> None:
        if links is None:
            self.nodes = np.zeros(0, dtype=int)
            return
        self.nodes, indices = np.unique(
            np.concatenate([links.source, links.target]), return_inverse=True
        )
        self.source, self.target = np.split(indices, 2)
        # Outputs have nothing leading from them, and stay; so do inputs, which nothing leads to.
        from_it = np.bincount(self.source, minlength=self.nodes.size) > 0
        to_it = np.bincount(self.target, minlength=self.nodes.size) > 0
        self.hidden = from_it & to_it

    def _dead(self, kept: Bool[np.ndarray, " p"]) -> Bool[np.ndarray, " nodes"]:
        return self.hidden & (np.bincount(self.source[kept], minlength=self.nodes.size) == 0)

    def without(self, kept: Bool[np.ndarray, " p"], gone: int) -> Bool[np.ndarray, " p"]:
        """Return what is kept when a link goes.

        Nodes that this leaves without a link from them go too.
        """
        left = kept.copy()
        left[gone] = False
        while self.nodes.size and np.any(to_dead := left & self._dead(left)[self.target]):
            left &= ~to_dead
        return left

    def gone(self, kept: Bool[np.ndarray, " p"]) -> tuple[int, ...]:
        """The numbers of the nodes that are removed."""
        if not self.nodes.size:
            return ()
        return tuple(int(node) for node in self.nodes[self._dead(kept)])


def _check(
    size: int,
    links: LinkEnds | None,
    tested: Bool[np.ndarray, " tested"],
    tolerance: float,
    passes: int | None,
) -> None:
    if not 0.0 <= tolerance < np.inf:
        raise ValueError(f"tolerance is {tolerance}; expected a finite number, 0 or more")
    if passes is not None and passes < 1:
        raise ValueError(f"{passes} passes; expected 1 or more, or None")
    if links is not None and links.source.size != size:
        raise ValueError(f"links of {links.source.size} weights; expected {size}")
    if tested.size != size:
        raise ValueError(f"tested has {tested.size} entries; expected {size}")
    if not np.any(tested):
        raise ValueError("no weight may be removed; expected some to be tested")


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
    >>> from jaxcslc.training import fully_connected
    >>> from scripts.studies.generalisation.pruning import compact
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

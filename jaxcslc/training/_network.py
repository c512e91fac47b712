"""Adaptive networks: links, adaptive and context-sensitive layers, superposed subnetworks.

Links of adaptive layers have weights of their own. Those of context-sensitive layers have weights
that vary from pattern to pattern (thesis 3.1, 3.3). Networks of common structures are in
`_networks`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._functions import LINEAR_COMBINER, Activation


# Indices of links are checked when they are made: JAX's arithmetic for negative ones, at each use
# in a training, took part of its time to compile.
_CHECKED: Any = {"wrap_negative_indices": False}


class Links:
    """Links from inputs to nodes, each with a weight and a known multiple.

    A link carries `multiple * weights[weight] * input`. Links that are not listed do not exist
    (thesis 4.2); links that list the same weight share it (5.1.1); two links between the same
    pair add up, as where a Christoffel symbol's link weighs the half of one coefficient less
    the half of another (Eqn. 5.1-3).

    Immutable, and equal to another with the same content: it is part of compiled functions.

    **Arguments**

    - `inputs`, `nodes`: how many there are on either side.
    - `source`, `node`, `weight`: one index a link.
    - `multiple`: one a link; ones if omitted.

    **Raises** `ValueError` for an index out of range, lists of different lengths, or a multiple
    that is zero or not finite.

    >>> import jax
    >>> from jaxcslc.training import Links
    >>> links = Links(2, 1, source=[0, 1], node=[0, 0], weight=[0, 0], multiple=[1.0, -2.0])
    >>> links.matrix(jax.numpy.asarray([3.0])).tolist()
    [[3.0, -6.0]]
    """

    def __init__(
        self,
        inputs: int,
        nodes: int,
        source: Sequence[int] | np.ndarray,
        node: Sequence[int] | np.ndarray,
        weight: Sequence[int] | np.ndarray,
        multiple: Sequence[float] | np.ndarray | None = None,
    ) -> None:
        self.inputs, self.nodes = inputs, nodes
        self.source = np.array(source, np.int64)
        self.node = np.array(node, np.int64)
        self.weight = np.array(weight, np.int64)
        self.multiple = (
            np.ones(len(self.source)) if multiple is None else np.array(multiple, np.float64)
        )
        fields = (self.source, self.node, self.weight, self.multiple)
        if len({len(field) for field in fields}) != 1 or any(f.ndim != 1 for f in fields):
            raise ValueError(
                "links: source, node, weight and multiple must be lists of one length, got"
                f" {', '.join(str(field.shape) for field in fields)}"
            )
        for name, indices, limit in (
            ("source", self.source, inputs),
            ("node", self.node, nodes),
            ("weight", self.weight, None),
        ):
            wrong = (indices < 0) | (indices >= limit if limit is not None else False)
            if wrong.any():
                at = int(np.argmax(wrong))
                raise ValueError(
                    f"links: {name} of link {at} is {indices[at]}, expected 0 to"
                    f" {'…' if limit is None else limit - 1}"
                )
        if not np.isfinite(self.multiple).all() or (self.multiple == 0).any():
            raise ValueError("links: multiples must be finite and not zero; remove such links")
        for field in fields:
            field.flags.writeable = False
        self._key = (inputs, nodes, *(field.tobytes() for field in fields))
        self._hash = hash(self._key)

    @classmethod
    def full(cls, inputs: int, nodes: int, first: int = 0) -> "Links":
        """Connect every input to every node, each link with a weight of its own, from `first` on.

        Weights are numbered node by node: `weights[first:].reshape(nodes, inputs)`.
        """
        node, source = np.divmod(np.arange(inputs * nodes), inputs)
        return cls(inputs, nodes, source, node, first + np.arange(inputs * nodes))

    @property
    def count(self) -> int:
        return len(self.source)

    def matrix(
        self, weights: Float[Array, " weights"], *, magnitude: bool = False
    ) -> Float[Array, "nodes inputs"]:
        """Return the weights matrix, transposed to the thesis's: nodes by inputs.

        With `magnitude`, of the links' moduli: two links between one pair do not cancel.
        """
        values = weights.at[self.weight].get(**_CHECKED) * self.multiple.astype(weights.dtype)
        if magnitude:
            values = jnp.abs(values)
        if self._ordered:
            return values.reshape(self.nodes, self.inputs)
        empty = jnp.zeros((self.nodes, self.inputs), weights.dtype)
        return empty.at[self.node, self.source].add(values, **_CHECKED)

    def to_weights(self, per_link: Float[Array, " links"], size: int) -> Float[Array, " weights"]:
        """Return the sum over links of each weight, (size,)."""
        return jnp.zeros(size, per_link.dtype).at[self.weight].add(per_link, **_CHECKED)

    def at_links(self, matrix: Float[Array, "nodes inputs"]) -> Float[Array, " links"]:
        """Return the entry of a matrix of nodes by inputs for every link."""
        if self._ordered:
            return matrix.reshape(-1)
        return matrix.at[self.node, self.source].get(**_CHECKED)

    @property
    def _ordered(self) -> bool:
        """True if the links are the whole matrix, row by row."""
        whole = self.inputs * self.nodes
        return self.count == whole and bool(
            (self.node * self.inputs + self.source == np.arange(whole)).all()
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Links) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash

    def __repr__(self) -> str:
        weights = len(np.unique(self.weight))
        return f"Links({self.inputs} to {self.nodes}: {self.count} links, {weights} weights)"


@dataclass(frozen=True)
class Layer:
    """An adaptive layer: weighted sums of its inputs, then an activation (Eqn. 3.3-1).

    **Attributes**

    - `links`: from inputs to nodes; their weights are what training adjusts.
    - `activation`: of every node.
    - `bias`: whether the last of the inputs is a constant one (3.3.1), which the layer supplies.
    """

    links: Links
    activation: Activation = LINEAR_COMBINER
    bias: bool = False

    @property
    def inputs(self) -> int:
        """Number of values that the layer takes, the constant not counted."""
        return self.links.inputs - self.bias

    def with_bias(self, values: Float[Array, "inputs ..."]) -> Float[Array, "inputs_and_bias ..."]:
        """Return the values that the links see."""
        if not self.bias:
            return values
        return jnp.concatenate([values, jnp.ones_like(values[:1])])


@dataclass(frozen=True)
class ContextLayer:
    """A layer whose weights vary from pattern to pattern (thesis 3.3.5, Figs. 3.3-5 and 6.2-1).

    A link carries the value of its source times its context value, so that data are multiplied
    by other data. Context values are inputs of the network, or the outputs of adaptive layers of
    their own, which learn as others do (Fig. 3.3-5; Yeung & Bekey, ICRA 1989).

    **Attributes**

    - `inputs`, `nodes`, `contexts`: how many sources, nodes and context values there are.
    - `source`, `node`, `context`: one index per link.
    - `layers`: adaptive layers that compute the context values from what patterns give; none if
      patterns give the values themselves.

    **Raises** `ValueError` for an index out of range, lists of different lengths, or layers that
    do not fit together or do not compute as many values as there are contexts.

    A product of two inputs, where one input computes the weight of the other:

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.training import (
    ...     AdaptiveNetwork, ContextLayer, Layer, LINEAR_COMBINER, Links, Signals, Subnetwork)
    >>> from jaxcslc.training import Backpropagation, FixedRates, Plan, examples, half_square, train
    >>> def signals(x):
    ...     return Signals((x.T[:1],), ((x.T[1:],),))
    >>> values = Layer(Links.full(1, 1))
    >>> weights = Layer(Links.full(2, 1, first=1), bias=True)
    >>> product = Subnetwork("product", (values,), (ContextLayer.full(1, 1, (weights,)),))
    >>> names = ("gain", "slope", "bias")
    >>> network = AdaptiveNetwork((product,), signals, LINEAR_COMBINER, names)
    >>> network.groups
    ('product', 'product context')
    >>> x = jnp.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2)))
    >>> patterns = examples(network, x, x[:, :1] * x[:, 1:])
    >>> plan = Plan(Backpropagation(), FixedRates(1.0), cost=half_square)
    >>> training = train(network, patterns, np.array([0.5, 0.0, 0.5]), plan, epochs=300)
    >>> float(training.cost) < 1e-12
    True
    """

    inputs: int
    nodes: int
    contexts: int
    source: tuple[int, ...]
    node: tuple[int, ...]
    context: tuple[int, ...]
    layers: tuple[Layer, ...] = ()

    @classmethod
    def full(cls, inputs: int, nodes: int, layers: tuple[Layer, ...] = ()) -> "ContextLayer":
        """Connect every source to every node, each link with a context value of its own, node by
        node.
        """
        node, source = np.divmod(np.arange(inputs * nodes), inputs)
        context = tuple(range(inputs * nodes))
        return cls(
            inputs,
            nodes,
            len(context),
            tuple(source.tolist()),
            tuple(node.tolist()),
            context,
            layers,
        )

    def __post_init__(self) -> None:
        if len({len(self.source), len(self.node), len(self.context)}) != 1:
            raise ValueError("context layer: source, node and context must be of one length")
        for name, indices, limit in (
            ("source", self.source, self.inputs),
            ("node", self.node, self.nodes),
            ("context", self.context, self.contexts),
        ):
            if indices and not 0 <= min(indices) <= max(indices) < limit:
                raise ValueError(
                    f"context layer: {name} indices must be 0 to {limit - 1}, got"
                    f" {min(indices)} to {max(indices)}"
                )
        for at, (before, after) in enumerate(pairwise(self.layers), start=1):
            if before.links.nodes != after.inputs:
                raise ValueError(
                    f"context layer: layer {at} of those that compute its weights has"
                    f" {before.links.nodes} nodes, layer {at + 1} takes {after.inputs}"
                )
        if self.layers and self.layers[-1].links.nodes != self.contexts:
            raise ValueError(
                f"context layer: {self.contexts} context values, but the layers that compute them"
                f" have {self.layers[-1].links.nodes} outputs"
            )

    @property
    def context_inputs(self) -> int:
        """Number of values that a pattern gives for the weights."""
        return self.layers[0].inputs if self.layers else self.contexts

    @property
    def fan_out(self) -> np.ndarray:
        """Number of nodes to which each source is linked, (inputs,); 1 without links."""
        return np.maximum(np.bincount(self.source, minlength=self.inputs), 1)

    def forward(
        self, values: Float[Array, "inputs ..."], context: Float[Array, "contexts ..."]
    ) -> Float[Array, "nodes ..."]:
        """Sums at the nodes of value times context."""
        return _gathered(self.node, self.nodes, self.source, values, self.context, context)

    def backward(
        self, values: Float[Array, "nodes ..."], context: Float[Array, "contexts ..."]
    ) -> Float[Array, "inputs ..."]:
        """Sums at the sources of value times context: the transpose of `forward`."""
        return _gathered(self.source, self.inputs, self.node, values, self.context, context)

    def backward_to_contexts(
        self, values: Float[Array, "nodes ..."], sources: Float[Array, "inputs ..."]
    ) -> Float[Array, "contexts ..."]:
        """Sums at the context values of value times source: what a change of each is worth."""
        return _gathered(self.context, self.contexts, self.node, values, self.source, sources)


def _gathered(
    to: Sequence[int],
    rows: int,
    of: Sequence[int],
    values: Float[Array, "units ..."],
    contexts: Sequence[int],
    context: Float[Array, "contexts ..."],
) -> Float[Array, "rows ..."]:
    """Row `to` of the result is the sum of rows `of` of the values times their contexts.

    Written out row by row: a row is a contiguous stretch of patterns, so this is a few hundred
    multiplications of long vectors, which the compiler fuses. A scatter, or an incidence matrix,
    would cost more than the layer before it.
    """
    sums: list[Array | None] = [None] * rows
    for row, unit, which in zip(to, of, contexts, strict=True):
        term = values[unit] * context[which]
        before = sums[row]
        sums[row] = term if before is None else before + term
    shape = jnp.broadcast_shapes(values.shape[1:], context.shape[1:])
    zero = jnp.zeros(shape, values.dtype)
    return jnp.stack([zero if total is None else total for total in sums])


class Signals(eqx.Module):
    """Preprocessed patterns as a network takes them: computed once, not once an epoch (5.2.6).

    Units first and patterns last, so that every unit is one stretch of memory; a single pattern
    has no last axis.

    **Attributes**

    - `inputs`: one (inputs, patterns) array a subnetwork.
    - `contexts`: for every subnetwork, one (values, patterns) array per context layer: the context
      values, or the inputs of the layers that compute them.
    """

    inputs: tuple[Float[Array, "_ ..."], ...]
    contexts: tuple[tuple[Float[Array, "_ ..."], ...], ...]


@dataclass(frozen=True)
class Subnetwork:
    """Adaptive layers, then context-sensitive ones; its last nodes are outputs of the network.

    **Attributes**

    - `name`: as in error messages and histories.
    - `layers`: one or more; the last one's activation is the linear combiner if nothing follows
      it, since the network's own activation does.
    - `contexts`: none, or those that follow.

    **Raises** `ValueError` if layers do not fit together.
    """

    name: str
    layers: tuple[Layer, ...]
    contexts: tuple[ContextLayer, ...] = ()

    def __post_init__(self) -> None:
        if not self.layers:
            raise ValueError(f"subnetwork {self.name!r}: expected at least one adaptive layer")
        sizes = [(layer.inputs, layer.links.nodes) for layer in self.layers]
        sizes += [(layer.inputs, layer.nodes) for layer in self.contexts]
        for at, ((_, nodes), (inputs, _)) in enumerate(pairwise(sizes)):
            if nodes != inputs:
                raise ValueError(
                    f"subnetwork {self.name!r}: layer {at + 1} has {nodes} nodes, layer"
                    f" {at + 2} takes {inputs}"
                )
        if not self.contexts and self.layers[-1].activation != LINEAR_COMBINER:
            raise ValueError(
                f"subnetwork {self.name!r}: the last layer's nodes are outputs; give their"
                " activation to the network"
            )

    @property
    def outputs(self) -> int:
        return self.contexts[-1].nodes if self.contexts else self.layers[-1].links.nodes

    @property
    def adaptive_layers(self) -> tuple[tuple[str, Layer], ...]:
        """Adaptive layers with names: its own, then those that compute context weights."""
        computing = [layer.layers for layer in self.contexts if layer.layers]
        chains = [(self.name, " ", self.layers)] + [
            (f"{self.name} context" + (f" {at}" if len(computing) > 1 else ""), ", layer ", layers)
            for at, layers in enumerate(computing, start=1)
        ]
        return tuple(
            (name if len(layers) == 1 else f"{name}{between}{number}", layer)
            for name, between, layers in chains
            for number, layer in enumerate(layers, start=1)
        )


class Passage(NamedTuple):
    """Values of one pass forward, kept for the learning rules.

    - `layer_inputs`: for every subnetwork, the inputs of each adaptive layer, its bias among them.
    - `sums`: for every subnetwork, each adaptive layer's sums.
    - `values`: for every subnetwork, what each context layer took.
    - `contexts`: for every subnetwork, each context layer's weights, as given or as computed.
    - `parts`: what every subnetwork brings to the output nodes, (outputs, ...).
    """

    layer_inputs: list[list[Float[Array, "_ ..."]]]
    sums: list[list[Float[Array, "_ ..."]]]
    values: list[list[Float[Array, "_ ..."]]]
    contexts: list[list[Float[Array, "_ ..."]]]
    parts: list[Float[Array, "outputs ..."]]

    @property
    def total(self) -> Float[Array, "outputs ..."]:
        """The sums at the output nodes, where subnetworks are superposed."""
        return sum(self.parts[1:], start=self.parts[0])


class AdaptiveNetwork(eqx.Module):
    """A feedforward network of adaptive and context-sensitive layers (thesis 3.1 and 3.3).

    Subnetworks stand side by side; their last nodes are superposed to the network's outputs, on
    which `activation` acts (5.1.5). All weights are one vector, (p,), which the links index, so
    that subnetworks may share weights.

    **Attributes**

    - `subnetworks`: at least one.
    - `preprocess`: from patterns as a user has them to `Signals`.
    - `activation`: of the output nodes.
    - `names`: of the weights.

    **Raises** `ValueError` if subnetworks differ in outputs, or a name is missing.

    Built by `fully_connected`, `inverse_dynamics`, or by hand from layers.
    """

    subnetworks: tuple[Subnetwork, ...] = eqx.field(static=True)
    preprocess: Callable[[Any], Signals]
    activation: Activation = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __check_init__(self) -> None:
        outputs = {subnetwork.outputs for subnetwork in self.subnetworks}
        if len(outputs) != 1:
            raise ValueError(
                "subnetworks must have the same output nodes, got"
                f" {', '.join(f'{s.name}: {s.outputs}' for s in self.subnetworks) or 'none'}"
            )
        highest = max(
            (int(layer.links.weight.max(initial=-1)) for _, layer in self.adaptive_layers),
            default=-1,
        )
        if highest >= len(self.names):
            raise ValueError(f"links use weight {highest}, but only {len(self.names)} are named")

    @property
    def size(self) -> int:
        """Number of weights, p."""
        return len(self.names)

    @property
    def outputs_count(self) -> int:
        """Number of output nodes, o."""
        return self.subnetworks[0].outputs

    @property
    def adaptive_layers(self) -> tuple[tuple[str, Layer], ...]:
        """Every adaptive layer with its name: each has a learning rate of its own."""
        return tuple(pair for s in self.subnetworks for pair in s.adaptive_layers)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the adaptive layers: what a learning rate, or freezing, refers to."""
        return tuple(name for name, _ in self.adaptive_layers)

    @property
    def single_adaptive_layer(self) -> bool:
        """True if every subnetwork has one adaptive layer alone, as PERAL needs (6.2)."""
        return all(len(subnetwork.adaptive_layers) == 1 for subnetwork in self.subnetworks)

    @property
    def linear(self) -> bool:
        """True if the sums at the output nodes are linear in the weights, as a CSLC's are.

        Weights that compute other weights multiply them, so that such a network never is.
        """
        return self.single_adaptive_layer and all(
            layer.activation == LINEAR_COMBINER for _, layer in self.adaptive_layers
        )

    def signals(self, patterns: Any) -> Signals:
        """Return patterns as the layers see them; `patterns` are what `preprocess` takes."""
        return self.preprocess(patterns)

    def forward(self, weights: Float[Array, " weights"], signals: Signals) -> Passage:
        """Return the values of a pass forward, (units, ...).

        **Raises** `ValueError` if there are not p weights.
        """
        if weights.shape != (self.size,):
            raise ValueError(f"weights: expected shape ({self.size},), got {weights.shape}")
        return _forward(self.subnetworks, weights, signals)

    def outputs(
        self, weights: Float[Array, " weights"], patterns: Any
    ) -> Float[Array, "... outputs"]:
        """Compute the network's outputs for patterns as `preprocess` takes them, (..., o).

        - `weights`: (p,).

        **Raises** `ValueError` if weights or patterns are not of the shape that the network takes.

        >>> import jax.numpy as jnp
        >>> from jaxcslc.training import fully_connected
        >>> network = fully_connected([2, 1], "hard limiter")
        >>> network.outputs(jnp.asarray([1.0, 1.0, -1.5]), jnp.asarray([[0.0, 1.0], [1.0, 1.0]]))
        Array([[0.],
               [1.]], dtype=float64)
        """
        total = self.forward(weights, self.signals(patterns)).total
        return jnp.moveaxis(self.activation.value(total), 0, -1)


@partial(jax.jit, static_argnums=0)
def _forward(
    subnetworks: tuple[Subnetwork, ...], weights: Float[Array, " weights"], signals: Signals
) -> Passage:
    """A pass forward: one program, where a CSLC's context layers would be hundreds."""
    passage = Passage([], [], [], [], [])
    for subnetwork, inputs, contexts in zip(
        subnetworks, signals.inputs, signals.contexts, strict=True
    ):
        layer_inputs: list[Array] = []
        sums: list[Array] = []
        values: list[Array] = []
        factors: list[Array] = []
        value = _through(subnetwork.layers, weights, inputs, layer_inputs, sums)
        for layer, context in zip(subnetwork.contexts, contexts, strict=True):
            values.append(value)
            factors.append(_through(layer.layers, weights, context, layer_inputs, sums))
            value = layer.forward(value, factors[-1])
        passage.layer_inputs.append(layer_inputs)
        passage.sums.append(sums)
        passage.values.append(values)
        passage.contexts.append(factors)
        passage.parts.append(value)
    return passage


def _through(
    layers: Sequence[Layer],
    weights: Float[Array, " weights"],
    value: Float[Array, "_ ..."],
    layer_inputs: list[Array],
    sums: list[Array],
) -> Float[Array, "_ ..."]:
    """The outputs of adaptive layers in a row; their inputs and sums are appended."""
    for layer in layers:
        layer_inputs.append(layer.with_bias(value))
        sums.append(jnp.tensordot(layer.links.matrix(weights), layer_inputs[-1], 1))
        value = layer.activation.value(sums[-1])
    return value


def network_order(network: AdaptiveNetwork) -> int:
    """Return the order of a network (thesis 4.2): the largest order of any output.

    The thesis takes it for the least number of independent patterns that determine the weights.
    It is that number for one adaptive layer whose outputs share no weights. Where outputs share
    weights, each pattern says something of a weight several times, and fewer patterns are enough:
    a PUMA 560's CSLC has order 28, which is what joint 2's weights need from joint 2's torque
    alone, and 8 patterns of all joints determine its 43 weights
    (`AbstractLinearNetwork.least_patterns`). Behind several adaptive layers, orders multiply and
    can exceed the number of weights.

    >>> import jaxcslc as jc
    >>> from jaxcslc.training import inverse_dynamics, network_order
    >>> network_order(inverse_dynamics(jc.derive(jc.puma560())))  # thesis 5.2.5
    28
    """
    return max(order_per_output(network))


def order_per_output(network: AdaptiveNetwork) -> tuple[int, ...]:
    """Return each output's order (4.2): its number of weights times the order of what they weigh.

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
    return tuple(
        len(frozenset[int]().union(*(unit.last for unit in units)))
        * max(unit.before for unit in units)
        for units in _reached(network.subnetworks)
    )


def reaching_weights(network: AdaptiveNetwork) -> tuple[tuple[int, ...], ...]:
    """Return, for each output, the weights that can change it, in ascending order."""
    return tuple(
        tuple(sorted(frozenset[int]().union(*(unit.weights for unit in units))))
        for units in _reached(network.subnetworks)
    )


class _Reach(NamedTuple):
    """Links and inputs that reach a unit of a network.

    - `weights`: all of them; `last`: those since the last adaptive layer.
    - `before`: the order of what these weigh.
    """

    weights: frozenset[int] = frozenset()
    last: frozenset[int] = frozenset()
    before: int = 1

    @property
    def order(self) -> int:
        return max(len(self.last), 1) * self.before


@lru_cache(maxsize=64)
def _reached(subnetworks: tuple[Subnetwork, ...]) -> tuple[tuple[_Reach, ...], ...]:
    """Return what reaches each output, by every subnetwork."""
    at_outputs: list[list[_Reach]] = []
    for subnetwork in subnetworks:
        units = _through_layers(subnetwork.layers, subnetwork.layers[0].inputs)
        for layer in subnetwork.contexts:
            contexts = _through_layers(layer.layers, layer.context_inputs)
            nodes = [_Reach()] * layer.nodes
            for source, node, context in zip(layer.source, layer.node, layer.context, strict=True):
                at, unit = nodes[node], units[source]
                weights = at.weights | unit.weights | contexts[context].weights
                before = max(at.before, unit.before)
                nodes[node] = _Reach(weights, at.last | unit.last, before)
            units = nodes
        at_outputs.append(units)
    return tuple(zip(*at_outputs, strict=True))


def _through_layers(layers: Sequence[Layer], inputs: int) -> list[_Reach]:
    """Return what reaches the outputs of adaptive layers in a row."""
    units = [_Reach()] * inputs
    for layer in layers:
        units = [*units, _Reach()]  # the last one stands for a bias
        nodes = [_Reach()] * layer.links.nodes
        links = layer.links
        for source, node, weight in zip(links.source, links.node, links.weight, strict=True):
            at, unit, own = nodes[node], units[source], frozenset([int(weight)])
            weights = at.weights | unit.weights | own
            nodes[node] = _Reach(weights, at.last | own, max(at.before, unit.order))
        units = nodes
    return units


class PolynomialTerms(eqx.Module):
    """Products of up to `degree` inputs, single inputs first (thesis 3.3.4).

    With degree 2 and two inputs, x1, x2, x1², x1 x2 and x2²: what lets a single hard limiter
    tell the exclusive or (Fig. 3.3-3).

    **Raises** `ValueError` for a degree below one.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import PolynomialTerms
    >>> PolynomialTerms(2)(jnp.asarray([2.0, 3.0])).tolist()
    [2.0, 3.0, 4.0, 6.0, 9.0]
    """

    degree: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        if self.degree < 1:
            raise ValueError(f"polynomial terms: expected a degree of 1 or more, got {self.degree}")

    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch terms"]:
        products: list[Array] = []
        for degree in range(1, self.degree + 1):
            for factors in combinations_with_replacement(range(x.shape[-1]), degree):
                product = x[..., factors[0]]
                for factor in factors[1:]:
                    product = product * x[..., factor]
                products.append(product)
        return jnp.stack(products, axis=-1)


class RadialBasis(eqx.Module):
    """Gaussian nodes: exp(-|x - centre|² / (2 width²)), one a centre (thesis 3.3.3).

    Their local sensitivity lies in the space of all inputs, not in a sum of them; centres and
    widths are given, and the layer that follows is what is trained.

    **Attributes**

    - `centres`: (nodes, inputs).
    - `widths`: (nodes,), positive.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.training import RadialBasis
    >>> nodes = RadialBasis(jnp.zeros((1, 2)), jnp.ones(1))
    >>> round(float(nodes(jnp.asarray([1.0, 1.0]))[0]), 4)  # exp(-1)
    0.3679
    """

    centres: Float[Array, "nodes inputs"]
    widths: Float[Array, " nodes"]

    def __check_init__(self) -> None:
        if self.centres.ndim != 2 or self.widths.shape != self.centres.shape[:1]:
            raise ValueError(
                "radial basis: expected centres (nodes, inputs) and widths (nodes,), got"
                f" {self.centres.shape} and {self.widths.shape}"
            )

    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch nodes"]:
        # |x|² - 2 x c + |c|²: a product of matrices, where differences would be nodes times as
        # many numbers; rounding may leave it below zero, where a distance is none.
        squares = jnp.sum(x**2, axis=-1, keepdims=True) - 2.0 * (x @ self.centres.T)
        lead = (1,) * (x.ndim - 1)
        squares = squares + jnp.sum(self.centres**2, axis=-1).reshape(*lead, -1)
        return jnp.exp(-jnp.maximum(squares, 0.0) / (2.0 * self.widths.reshape(*lead, -1) ** 2))

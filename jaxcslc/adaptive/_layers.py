"""Layers: links with weights of their own, and links whose weights vary from pattern to pattern.

`_network.py` puts them in a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._activations import LINEAR_COMBINER, Activation
from ._links import Links


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
        """How many values the layer takes, the constant not counted."""
        return self.links.inputs - self.bias

    def with_bias(self, values: Float[Array, "inputs ..."]) -> Float[Array, "inputs_and_bias ..."]:
        """The values that the links see."""
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
    >>> from jaxcslc.adaptive import (
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
        """Every source to every node, each link with a context value of its own, node by node."""
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
        """To how many nodes each source is linked, (inputs,), one where to none."""
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

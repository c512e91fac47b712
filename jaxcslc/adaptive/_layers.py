from collections.abc import Sequence
from dataclasses import dataclass

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
    """A layer whose weights are inputs of the network (thesis 3.3.5, Fig. 6.2-1).

    A link carries the value of its source times its context value, so that data are multiplied
    by other data. Nothing here is trained.

    **Attributes**

    - `inputs`, `nodes`, `contexts`: how many sources, nodes and context values there are.
    - `source`, `node`, `context`: one index a link.

    **Raises** `ValueError` for an index out of range, or lists of different lengths.
    """

    inputs: int
    nodes: int
    contexts: int
    source: tuple[int, ...]
    node: tuple[int, ...]
    context: tuple[int, ...]

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

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Links:
    """Which inputs feed which nodes, each through which weight times which known multiple.

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
    >>> from jaxcslc.adaptive import Links
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
            raise ValueError("links: multiples must be finite and not zero; leave such links out")
        for field in fields:
            field.flags.writeable = False
        self._key = (inputs, nodes, *(field.tobytes() for field in fields))
        self._hash = hash(self._key)

    @classmethod
    def full(cls, inputs: int, nodes: int, first: int = 0) -> "Links":
        """Every input to every node, each link with a weight of its own, from `first` on.

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
        """The weights matrix, transposed to the thesis's: nodes by inputs.

        With `magnitude`, of the links' moduli: two links between one pair do not cancel.
        """
        values = weights[self.weight] * self.multiple.astype(weights.dtype)
        if magnitude:
            values = jnp.abs(values)
        if self._ordered:
            return values.reshape(self.nodes, self.inputs)
        empty = jnp.zeros((self.nodes, self.inputs), weights.dtype)
        return empty.at[self.node, self.source].add(values)

    def to_weights(self, per_link: Float[Array, " links"], size: int) -> Float[Array, " weights"]:
        """The sum over links of each weight, (size,)."""
        return jnp.zeros(size, per_link.dtype).at[self.weight].add(per_link)

    def at_links(self, matrix: Float[Array, "nodes inputs"]) -> Float[Array, " links"]:
        """What a matrix of nodes by inputs holds for every link."""
        return matrix.reshape(-1) if self._ordered else matrix[self.node, self.source]

    @property
    def _ordered(self) -> bool:
        """Whether links are the whole matrix, row by row."""
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

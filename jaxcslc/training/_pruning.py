"""Pruning: removal of links that a network's training-set error does not need (thesis 3.6.2).

`_compact` builds the smaller network.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._compact import compact
from ._network import AdaptiveNetwork


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
    block: int = 64,
    progress: Callable[[int, int], None] | None = None,
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

    Costs are evaluated in blocks by `vmap`, with the result of one evaluation after the other.

    **Arguments**

    - `cost`: weights (p,), and `args`, to a scalar: the error of the training set. Anything that
      can be `vmap`ped over the weights: a network of Equinox by
      `jax.flatten_util.ravel_pytree`, for one.
    - `weights`: (p,) as trained.
    - `links`: from where to where; without it no nodes are removed.
    - `tolerance`: relative, 0 or more.
    - `args`: more arguments of `cost`, arrays or pytrees of them. Calls with the same `cost` and
      arrays of the same shapes compile once.
    - `tested`: (p,) which weights may be removed for themselves, by default all. The others, of
      which zero does not mean 'no link' (centres, widths), go with their node.
    - `passes`: at most so many; by default as many as it takes.
    - `block`: how many costs are evaluated at a time, each with activations of its own in memory.
    - `progress`: called after each block with the number of removals tried so far, and the number
      of weights removed.

    **Returns** a `Pruning`.

    **Raises**

    - `ValueError`: a tolerance, block or number of passes that makes no sense, arrays that do not
      fit the weights, a cost that is no scalar or not finite, or nothing to test.

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.training import LinkEnds, prune
    >>> x = np.linspace(-1.0, 1.0, 50)
    >>> def cost(w):  # two hidden nodes; the second hardly reaches the output
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
    _check(start.size, links, may_go, tolerance, passes, block)
    trials = _Trials(cost, np.asarray(weights), args, block, progress)
    network = _Wiring(links)

    kept = np.ones(start.size, dtype=bool)
    before = float(trials.costs(kept[None])[0])
    if not np.isfinite(before):
        raise ValueError(f"the cost before pruning is {before}; expected a finite number")
    limit = (1.0 + tolerance) * before
    sensitivity = np.full(start.size, np.nan)
    removed: list[int] = []
    done = 0
    finished = False
    while not finished and (passes is None or done < passes):
        left = np.flatnonzero(kept & may_go)
        alone = trials.costs(np.stack([network.without(kept, one) for one in left[:, None]]))
        if done == 0:
            sensitivity[left] = alone - before
        done += 1
        order = np.argsort(alone, kind="stable")
        going = left[order][alone[order] <= limit]
        for accepted in _walk(trials, network, kept, going, limit):
            gone = np.flatnonzero(kept & ~accepted)
            # The link itself before what went with its node.
            removed += sorted(gone.tolist(), key=lambda i: not may_go[i])
            kept = accepted
            trials.removed = len(removed)
        finished = going.size == 0 or not np.any(kept & may_go)
    after = float(trials.costs(kept[None])[0])
    return Pruning(
        kept,
        np.where(kept, start, 0.0),
        before,
        after,
        sensitivity,
        np.array(removed, dtype=int),
        network.gone(kept),
        done,
        finished,
    )


def _walk(
    trials: "_Trials",
    network: "_Wiring",
    kept: Bool[np.ndarray, " p"],
    going: Int[np.ndarray, " going"],
    limit: float,
) -> Iterator[Bool[np.ndarray, " p"]]:
    """Yield what is kept after each removal that is accepted, in the order of `going`.

    The same as one trial after the other. After an acceptance a block tries the next links all
    together: the first, the first two, the first three; all before the first marked increase
    are accepted. After a marked increase a block tries the next links each alone, since what they
    would be removed from stays the same until one is accepted.
    """
    together = True
    while going.size:
        some = going[: trials.block]
        sets = [some[: i + 1] if together else some[i : i + 1] for i in range(some.size)]
        masks = np.stack([network.without(kept, one) for one in sets])
        marked = ~(trials.costs(masks) <= limit)  # a cost that is no number is marked
        if together:
            good = int(np.argmax(marked)) if np.any(marked) else some.size
            for mask in masks[:good]:
                if np.any(mask != kept):  # it may have gone with a node
                    kept = mask
                    yield kept
            together = good == some.size
            going = going[min(good + 1, some.size) :]
        elif np.all(marked):
            going = going[some.size :]
        else:
            first = int(np.argmin(marked))
            if np.any(masks[first] != kept):
                kept = masks[first]
                yield kept
            together = True
            going = going[first + 1 :]


class _Trials:
    """Evaluates costs of many sets of links, a block at a time."""

    def __init__(
        self,
        cost: Callable[..., Any],
        weights: np.ndarray,
        args: tuple[Any, ...],
        block: int,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.cost, self.weights, self.args, self.block = cost, weights, args, block
        self.progress = progress
        self.tried, self.removed = 0, 0

    def costs(self, kept: Bool[np.ndarray, "sets p"]) -> Float[np.ndarray, " sets"]:
        values_of_blocks: list[np.ndarray] = []
        for start in range(0, len(kept), self.block):
            some = kept[start : start + self.block]
            # Always whole blocks, so that one program does for all of them.
            full = np.concatenate([some, np.repeat(some[-1:], self.block - len(some), axis=0)])
            values = _costs(self.cost, np.where(full, self.weights, 0), self.args)
            if values.shape != (self.block,):
                raise ValueError(
                    f"the cost has shape {values.shape[1:]}; expected a scalar for weights (p,)"
                )
            values_of_blocks.append(np.asarray(values, dtype=float)[: len(some)])
            self.tried += len(some)
            if self.progress is not None:
                self.progress(self.tried, self.removed)
        return np.concatenate(values_of_blocks)


@functools.partial(jax.jit, static_argnums=0)
def _costs(
    cost: Callable[..., Any], weights: Float[Array | np.ndarray, "sets p"], args: Any
) -> Array:
    return jax.vmap(lambda one: cost(one, *args))(weights)


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

    def without(
        self, kept: Bool[np.ndarray, " p"], gone: Int[np.ndarray, " gone"]
    ) -> Bool[np.ndarray, " p"]:
        """Return what is kept when links go.

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
    block: int,
) -> None:
    if not 0.0 <= tolerance < np.inf:
        raise ValueError(f"tolerance is {tolerance}; expected a finite number, 0 or more")
    if passes is not None and passes < 1:
        raise ValueError(f"{passes} passes; expected 1 or more, or None")
    if block < 1:
        raise ValueError(f"block is {block}; expected 1 or more")
    if links is not None and links.source.size != size:
        raise ValueError(f"links of {links.source.size} weights; expected {size}")
    if tested.size != size:
        raise ValueError(f"tested has {tested.size} entries; expected {size}")
    if not np.any(tested):
        raise ValueError("no weight may be removed; expected some to be tested")

"""Networks with patterns, twice over: the library's and those of the literal transcription."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxcslc.training import (
    HYPERBOLIC_TANGENT,
    LINEAR_COMBINER,
    LOGISTIC,
    Activation,
    AdaptiveNetwork,
    ContextLayer,
    Layer,
    Links,
    Signals,
    Subnetwork,
    decreasing,
)
from jaxcslc.training._examples import Examples
from jaxcslc.training._rules import AbstractRule
from tests.training import _transcription as thesis


FUNCTIONS: dict[Activation, thesis.Function] = {
    LINEAR_COMBINER: thesis.IDENTITY,
    LOGISTIC: thesis.LOGISTIC,
    HYPERBOLIC_TANGENT: thesis.TANH,
    decreasing(HYPERBOLIC_TANGENT): thesis.FALLING_TANH,
    decreasing(LOGISTIC): thesis.FALLING_LOGISTIC,
}


@dataclass(frozen=True)
class Problem:
    """A network twice over, with patterns."""

    network: AdaptiveNetwork
    parts: list[thesis.Subnetwork]
    f: thesis.Function
    xs: list[np.ndarray]  # (patterns, inputs) for every subnetwork
    contexts: list[list[np.ndarray]]
    t: np.ndarray
    k: np.ndarray
    patterns: Any = None  # as a user has them

    def training_set(self, counts: np.ndarray | None = None) -> Examples:
        signals = Signals(
            tuple(jnp.asarray(x.T) for x in self.xs),
            tuple(tuple(jnp.asarray(c.T) for c in per_pattern) for per_pattern in self.contexts),
        )
        ones = np.ones(self.t.shape) if counts is None else counts
        masks = jnp.asarray(np.swapaxes(ones, -1, -2), float)
        t = jnp.asarray(self.t.T)
        if masks.ndim == 2:
            return Examples(signals, t, masks, None)
        return Examples(signals, t, jnp.max(masks, axis=0), None, masks)

    def literally(
        self,
        rule: Callable[..., thesis.Moves],
        learning: Sequence[bool] | None = None,
        counts: np.ndarray | None = None,
    ) -> np.ndarray:
        per_pattern: list[thesis.Moves] = []
        for p in range(len(self.t)):
            if counts is not None and not counts[..., p, :].any():
                continue
            xs = [x[p] for x in self.xs]
            contexts = [
                [c[p] for c in subnetwork_contexts] for subnetwork_contexts in self.contexts
            ]
            pattern_counts = None if counts is None else counts[..., p, :]
            per_pattern.append(
                rule(self.parts, self.f, xs, contexts, self.t[p], self.k, pattern_counts)
            )
        return thesis.average_over_links(
            self.parts,
            thesis.mean_over_patterns(per_pattern),
            len(self.k),
            by_chain_rule=rule is thesis.backpropagation,
            learning=learning,
        )


def sparse(
    rng: np.random.Generator, inputs: int, nodes: int, weights: Sequence[int], doubles: int = 2
) -> Links:
    """Two thirds of the links, every node with one, few weights, pairs that are linked twice."""
    pairs = [(s, n) for n in range(nodes) for s in range(inputs)]
    kept = [pair for pair in pairs if rng.uniform() < 0.67 or pair[0] == pair[1] % inputs]
    kept += [kept[i] for i in rng.integers(len(kept), size=doubles)]
    source, node = zip(*kept, strict=True)
    multiple = rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0], len(kept))
    return Links(inputs, nodes, source, node, rng.choice(weights, len(kept)), multiple)


def transcribed(part: Subnetwork) -> thesis.Subnetwork:
    return thesis.Subnetwork(
        [
            (
                layer.links.nodes,
                [
                    thesis.Link(int(s), int(n), int(k), float(m))
                    for s, n, k, m in zip(
                        layer.links.source,
                        layer.links.node,
                        layer.links.weight,
                        layer.links.multiple,
                        strict=True,
                    )
                ],
                FUNCTIONS[layer.activation],
            )
            for layer in part.layers
        ],
        [
            (
                layer.nodes,
                [
                    thesis.ContextLink(*link)
                    for link in zip(layer.source, layer.node, layer.context, strict=True)
                ],
            )
            for layer in part.contexts
        ],
        bias=part.layers[0].bias,
    )


def problem(
    rng: np.random.Generator, parts: Sequence[Subnetwork], f: Activation, size: int
) -> Problem:
    """Random patterns, weights and contexts; a fifth of inputs and contexts zero."""

    def numbers(columns: int) -> np.ndarray:
        return rng.normal(size=(7, columns)) * (rng.uniform(size=(7, columns)) < 0.8)

    def signals(patterns: Signals) -> Signals:
        return patterns

    names = tuple(f"w{index}" for index in range(size))
    network = AdaptiveNetwork(tuple(parts), signals, f, names)
    return Problem(
        network,
        [transcribed(part) for part in parts],
        FUNCTIONS[f],
        [numbers(part.layers[0].inputs) for part in parts],
        [[numbers(layer.contexts) for layer in part.contexts] for part in parts],
        rng.uniform(max(f.low, -1.0), 1.0, size=(7, parts[0].outputs)),
        rng.normal(size=size),
    )


def sparse_context(
    rng: np.random.Generator, inputs: int, nodes: int, contexts: int
) -> ContextLayer:
    """Some sources to one node, some to several, some to the same one twice."""
    per_pattern = [
        (s, int(n), int(rng.integers(contexts)))
        for s in range(inputs)
        for n in rng.integers(nodes, size=1 + s % 3)
    ]
    source, node, context = zip(*per_pattern, strict=True)
    return ContextLayer(inputs, nodes, contexts, source, node, context)


def one_sparse_layer(rng: np.random.Generator, f: Activation) -> Problem:
    layer = Layer(sparse(rng, 6, 3, range(4)), bias=True)
    return problem(rng, [Subnetwork("a", (layer,))], f, 4)


def one_context_layer(rng: np.random.Generator, f_A: Activation, f: Activation) -> Problem:
    layer = Layer(sparse(rng, 4, 5, range(6)), f_A)
    return problem(rng, [Subnetwork("a", (layer,), (sparse_context(rng, 5, 3, 2),))], f, 6)


def five_subnetworks(rng: np.random.Generator, f: Activation) -> Problem:
    """As in a CSLC: one and two context layers that share weights, and plain layers beside."""
    parts = [
        Subnetwork("mass", (Layer(sparse(rng, 4, 5, range(6))),), (sparse_context(rng, 5, 3, 3),)),
        Subnetwork(
            "velocity",
            (Layer(sparse(rng, 3, 6, range(4))),),
            (sparse_context(rng, 6, 4, 3), sparse_context(rng, 4, 3, 3)),
        ),
        Subnetwork("gravity", (Layer(sparse(rng, 4, 3, range(6, 9))),)),
        Subnetwork("viscous", (Layer(Links(3, 3, range(3), range(3), range(9, 12))),)),
        Subnetwork("dry", (Layer(Links(3, 3, range(3), range(3), range(12, 15))),)),
    ]
    return problem(rng, parts, f, 15)


def two_adaptive_and_a_context(rng: np.random.Generator, f: Activation) -> Problem:
    """Also the deeper network shares weights between its layers, and with another subnetwork."""
    deep = Subnetwork(
        "deep",
        (
            Layer(sparse(rng, 4, 5, range(4)), HYPERBOLIC_TANGENT),
            Layer(sparse(rng, 5, 4, range(2, 8)), LOGISTIC),
        ),
        (sparse_context(rng, 4, 3, 2),),
    )
    flat = Subnetwork("flat", (Layer(sparse(rng, 4, 3, range(6, 10))),))
    return problem(rng, [deep, flat], f, 10)


@eqx.filter_jit
def summed(
    rule: AbstractRule,
    network: AdaptiveNetwork,
    k: jax.Array,
    training_set: Examples,
    learning: tuple[bool, ...],
) -> jax.Array:
    return rule.change(
        network,
        k,
        training_set.signals,
        training_set.targets,
        training_set.learning_counts,
        learning,
    )


def change(
    rule: AbstractRule,
    network: AdaptiveNetwork,
    k: Any,
    training_set: Examples,
    learning: Sequence[bool] | None = None,
) -> np.ndarray:
    """The batch form: divided by the number of patterns, (groups, p)."""
    takes_part = (True,) * len(network.groups) if learning is None else tuple(learning)
    result = summed(rule, network, jnp.asarray(k), training_set, takes_part)
    return np.asarray(result / training_set.patterns)

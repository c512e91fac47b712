"""Networks of adaptive and context-sensitive layers, and a pass forward through one.

`_layers.py` has the layers, `_build.py` and `_inverse_dynamics.py` build networks of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._activations import LINEAR_COMBINER, Activation
from ._layers import ContextLayer, Layer


class Signals(eqx.Module):
    """What a network sees of patterns, preprocessed: computed once, not once an epoch (5.2.6).

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
        """Its own layers, then those that compute weights of context layers, each with its name."""
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
    """All values of one pass forward, kept for the learning rules.

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
        """Whether every subnetwork has one adaptive layer alone, as PERAL needs (6.2)."""
        return all(len(subnetwork.adaptive_layers) == 1 for subnetwork in self.subnetworks)

    @property
    def linear(self) -> bool:
        """Whether the sums at the output nodes are linear in the weights, as a CSLC's are.

        Weights that compute other weights multiply them, so that such a network never is.
        """
        return self.single_adaptive_layer and all(
            layer.activation == LINEAR_COMBINER for _, layer in self.adaptive_layers
        )

    def signals(self, patterns: Any) -> Signals:
        """Patterns as the layers see them; `patterns` are what `preprocess` takes."""
        return self.preprocess(patterns)

    def forward(self, weights: Float[Array, " weights"], signals: Signals) -> Passage:
        """All values of a pass forward, (units, ...).

        **Raises** `ValueError` if there are not p weights.
        """
        if weights.shape != (self.size,):
            raise ValueError(f"weights: expected shape ({self.size},), got {weights.shape}")
        return _forward(self.subnetworks, weights, signals)

    def outputs(
        self, weights: Float[Array, " weights"], patterns: Any
    ) -> Float[Array, "... outputs"]:
        """What the network answers to patterns as `preprocess` takes them, (..., o).

        - `weights`: (p,).

        **Raises** `ValueError` if weights or patterns are not of the shape that the network takes.

        >>> import jax.numpy as jnp
        >>> from jaxcslc.adaptive import fully_connected
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

from collections.abc import Callable, Sequence
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Real

from ._activations import Activation, activation_named
from ._layers import Layer
from ._links import Links
from ._network import AdaptiveNetwork, Signals, Subnetwork


Inputs = Real[Array | np.ndarray, "... inputs"]


class Preprocessed(eqx.Module):
    """Patterns (..., inputs), acted upon by a function of theirs, for a network of one part.

    **Attributes**

    - `inputs`: how many the function takes.
    - `function`: (..., inputs) to (..., processed inputs), or none.
    """

    inputs: int = eqx.field(static=True)
    function: Callable[[Array], Array] | None = None

    def __call__(self, patterns: Inputs) -> Signals:
        values = jnp.asarray(patterns)
        if values.ndim == 0 or values.shape[-1] != self.inputs:
            raise ValueError(f"inputs: expected shape (..., {self.inputs}), got {values.shape}")
        if not jnp.issubdtype(values.dtype, jnp.floating):
            values = values.astype(jnp.result_type(float))
        if self.function is not None:
            values = self.function(values)
        return Signals((jnp.moveaxis(values, -1, 0),), ((),))


def fully_connected(
    sizes: Sequence[int],
    activations: str | Activation | Sequence[str | Activation],
    *,
    bias: bool = True,
    preprocess: Callable[[Array], Array] | None = None,
    name: str = "network",
) -> AdaptiveNetwork:
    """A network of one or more layers in which every input feeds every node (thesis 3.1).

    Weights are numbered layer by layer, node by node, the bias last.

    **Arguments**

    - `sizes`: number of inputs, then of each layer's nodes.
    - `activations`: of each layer's nodes, or one for all: `"hard limiter"`,
      `"linear combiner"`, `"logistic"`, `"hyperbolic tangent"`, or an `Activation`.
    - `bias`: whether every layer has a constant input of one.
    - `preprocess`: a function of the inputs, (..., inputs) to (..., processed), that stands
      before the first layer (3.3.4), such as `PolynomialTerms` or `RadialBasis`.

    **Raises** `ValueError` for fewer than two sizes, sizes below one, a wrong number of
    activations, or an unknown one.

    >>> from jaxcslc.adaptive import fully_connected
    >>> fully_connected([25, 10], "hyperbolic tangent").size  # 25 inputs and a bias, to ten nodes
    260
    """
    if len(sizes) < 2 or min(sizes) < 1:
        raise ValueError(f"sizes: expected inputs and nodes, at least [1, 1], got {list(sizes)}")
    if isinstance(activations, str | Activation):
        activations = [activations] * (len(sizes) - 1)
    if len(activations) != len(sizes) - 1:
        raise ValueError(
            f"activations: expected one a layer, {len(sizes) - 1}, got {len(activations)}"
        )
    kinds = [activation_named(activation) for activation in activations]
    processed = sizes[0]
    if preprocess is not None:
        probe = jax.ShapeDtypeStruct((sizes[0],), jnp.result_type(float))
        processed = jax.eval_shape(preprocess, probe).shape[-1]
    counts = [processed, *sizes[1:]]
    layers: list[Layer] = []
    names: list[str] = []
    last = len(counts) - 2
    for number, (inputs, nodes) in enumerate(pairwise(counts)):
        links = Links.full(inputs + bias, nodes, first=len(names))
        layers.append(
            Layer(links, kinds[number], bias) if number < last else Layer(links, bias=bias)
        )
        names += [
            f"layer {number + 1}, node {node + 1}, "
            + ("bias" if source == inputs else f"input {source + 1}")
            for node in range(nodes)
            for source in range(inputs + bias)
        ]
    return AdaptiveNetwork(
        (Subnetwork(name, tuple(layers)),),
        Preprocessed(sizes[0], preprocess),
        kinds[-1],
        tuple(names),
    )

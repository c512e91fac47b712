"""Operations of an epoch of backpropagation and of PERAL: counted, compiled, and timed.

The thesis counts floating point operations by hand (6.3.3): links that exist, the sums forward
included, quantities that do not vary between epochs left out. `counted` does so from a network's
own links; `compiled` asks the compiler for the operations of its program, where an adaptive layer
is a dense product, so that links that do not exist are multiplied as well.
"""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.training import (
    LINEAR_COMBINER,
    AbstractRule,
    AdaptiveNetwork,
    Examples,
    Plan,
    TrainingState,
    training_steps,
)


BACKPROPAGATION, PERAL_RULE = "backpropagation", "PERAL"
# Fig. 6.3-5: of a pattern, in an epoch.
THESIS_FORMULAS = {
    BACKPROPAGATION: "4ih + 7h + 2ho + 9o",  # the scan has 90
    PERAL_RULE: "7ih + 4h + 6ho + 4o",
}
THESIS_IDENTIFICATION = {BACKPROPAGATION: 1080, PERAL_RULE: 1850}
THESIS_CSLC = {BACKPROPAGATION: 2904, PERAL_RULE: 4875}
COUNTED_FORMULAS = {
    BACKPROPAGATION: "4ih + 3h + 4ho + 4o",
    PERAL_RULE: "7ih + 3h + 6ho + 2o",
}
REPEATS = 5
FEW = 128  # patterns of an analysed program


def counted(network: AdaptiveNetwork) -> dict[str, int]:
    """Operations of an epoch on one pattern in the thesis's way of counting, by rule.

    One adaptive layer a subnetwork, with or without context-sensitive layers behind it. Sums count
    one addition a link; activations, moduli and signs count nothing.

    - Backpropagation: an adaptive link's product and sum forward, and those of its change
      (3.4-9): 4. A context link's product and sum forward and back: 4. An output node's error:
      1; a sigmoid's slope and the product with it, wherever it stands: 3.
    - PERAL: forward 2, the sum of moduli 2, the product with signs 2, and the product with the
      weight's modulus (6.2-7): 7 an adaptive link. Forward, moduli and back (6.2-4): 6 a context
      link. An output node's error and quotient: 2. A hidden node's product with its modulus,
      division by how many nodes it feeds, and quotient: 3.
    """
    adaptive, _ = dense_links(network)
    context = sum(len(layer.source) for s in network.subnetworks for layer in s.contexts)
    hidden = sum(layer.inputs for s in network.subnetworks for layer in s.contexts)
    sigmoids = sum(
        layer.links.nodes
        for _, layer in network.adaptive_layers
        if layer.activation != LINEAR_COMBINER
    )
    outputs = network.outputs_count
    sigmoids += outputs if network.activation != LINEAR_COMBINER else 0
    return {
        BACKPROPAGATION: 4 * adaptive + 4 * context + outputs + 3 * sigmoids,
        PERAL_RULE: 7 * adaptive + 6 * context + 2 * outputs + 3 * hidden,
    }


def dense_links(network: AdaptiveNetwork) -> tuple[int, int]:
    """Return how many adaptive links there are, and how many a dense product multiplies.

    Two that join the same input and node are one, as in the thesis's weights matrices.
    """
    layers = [layer.links for _, layer in network.adaptive_layers]
    pairs = [len(set(zip(x.source.tolist(), x.node.tolist(), strict=True))) for x in layers]
    return sum(pairs), sum(x.inputs * x.nodes for x in layers)


def compiled(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    patterns: Examples,
    weights: Float[Array, " weights"],
) -> dict[str, float]:
    """Floating point operations that the compiled change of weights performs for one pattern.

    The difference between some patterns and half as many, so that constant operations are left
    out. `transcendental` are activations, which the compiler counts apart.
    """
    # Of larger products the compiler hands some to a library, whose operations it does not count.
    whole = min(patterns.targets.shape[-1], FEW)
    half = whole // 2
    parts = [jax.tree.map(lambda x, n=n: x[..., :n], patterns) for n in (whole, half)]
    change = _change(network, rule)
    counts = [_analysed(change, weights, part) for part in parts]
    if not all("flops" in count for count in counts):  # not every backend says
        return {"operations": float("nan"), "transcendental": float("nan")}
    return {
        name: (counts[0].get(key, 0.0) - counts[1].get(key, 0.0)) / (whole - half)
        for name, key in (("operations", "flops"), ("transcendental", "transcendentals"))
    }


def seconds_per_pattern(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    patterns: Examples,
    weights: Float[Array, " weights"],
) -> float:
    """Time of one change of weights, by the pattern: the quickest of several [s]."""
    change = _change(network, rule)
    return _quickest(lambda: change(weights, patterns), 20) / patterns.targets.shape[-1]


def seconds_per_epoch(
    network: AdaptiveNetwork,
    plan: Plan,
    patterns: Examples,
    weights: Float[Array, " weights"],
    epochs: int = 20,
) -> float:
    """Time of one epoch of one training alone, the search for its rates included [s]."""
    state = TrainingState.first(network, plan, weights, jax.random.key(0))
    return (
        _quickest(lambda: training_steps(network, plan, patterns, None, state, epochs), 3) / epochs
    )


def _analysed(change: Any, weights: Array, patterns: Examples) -> dict[str, float]:
    return change.lower(weights, patterns).compile().cost_analysis() or {}


def _change(network: AdaptiveNetwork, rule: AbstractRule) -> Callable[..., Array]:
    learning = (True,) * len(network.groups)

    def change(weights: Array, patterns: Examples) -> Array:
        return jnp.sum(patterns.change(network, rule, weights, learning), axis=0)

    return jax.jit(change)


def _quickest(call: Callable[[], object], times: int) -> float:
    jax.block_until_ready(call())
    seconds: list[float] = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(times):
            jax.block_until_ready(call())
        seconds.append((time.perf_counter() - start) / times)
    return float(np.min(seconds))

"""Changes of the weights of many trainings by one CUDA kernel.

`_kernel_statements` writes a rule's formulas as straight-line code. `_stages` divides them among
stages of a thread, and `_kernel_source` makes the source.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from ..codegen import Kernel, kernels_run
from ._kernel_source import ROW_THREADS, launch_of, row_length, rows_source, source
from ._kernel_statements import RuleStatements, rule_statements
from ._network import AdaptiveNetwork, Signals
from ._rules import AbstractRule, Counts, Numbers, Weights


def batched_by(
    function: Callable[..., Any], many: Callable[..., Any], mapped_count: int
) -> Callable[..., Any]:
    """A function of one training, with another one in place of its `vmap`, and of that's again.

    - `many`: of many trainings at once, with an axis of them on its first arguments and on its
      result.
    - `mapped_count`: how many first arguments trainings have of their own. What follows they
      share; where it is mapped over, `function` is.
    """
    single: Any = custom_vmap(function)
    several: Any = custom_vmap(many)

    def mapped(f: Callable[..., Any], batched: list[Any]) -> Callable[..., Any]:
        axes = [jax.tree.map(lambda x: 0 if x else None, part) for part in batched]
        return jax.vmap(f, axes)

    def alike(size: int, arguments: tuple[Any, ...], batched: list[Any]) -> list[Any]:
        """The trainings' own arguments, each with the axis."""
        pairs = zip(arguments[:mapped_count], batched[:mapped_count], strict=True)
        return [x if with_axis else jnp.broadcast_to(x, (size, *x.shape)) for x, with_axis in pairs]

    @single.def_vmap
    def _(size: int, batched: list[Any], *arguments: Any) -> tuple[Any, bool]:
        if any(jax.tree.leaves(batched[mapped_count:])):
            return mapped(function, batched)(*arguments), True
        return several(*alike(size, arguments, batched), *arguments[mapped_count:]), True

    @several.def_vmap
    def _(size: int, batched: list[Any], *arguments: Any) -> tuple[Any, bool]:
        shared = arguments[mapped_count:]
        if any(jax.tree.leaves(batched[mapped_count:])):
            over_trainings = jax.vmap(function, (*(0,) * mapped_count, *(None for _ in shared)))
            return mapped(over_trainings, batched)(*arguments), True
        both = [x.reshape(-1, *x.shape[2:]) for x in alike(size, arguments, batched)]
        flat = several(*both, *shared)
        return flat.reshape(size, -1, *flat.shape[1:]), True

    return single


# Patterns that a block takes at least.
_FEWEST_PATTERNS = 32


def kernel_of(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    learning: tuple[bool, ...],
    *,
    by_subnetwork: bool,
) -> RuleStatements | None:
    """The statements that a kernel has for a rule; None where there is no kernel for it, or none
    runs.

    - `by_subnetwork`: whether subnetworks learn from pairs of their own.
    """
    if not kernels_run():
        return None
    statements = rule_statements(network, rule, learning, by_subnetwork=by_subnetwork)
    return statements if statements is not None and launch_of(statements, 2**20) else None


def summed_change(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    weights: Weights,
    signals: Signals,
    targets: Numbers,
    counts: Counts,
    learning: tuple[bool, ...],
) -> Float[Array, "groups weights"]:
    """Compute `rule.change`; of many trainings on the same patterns by one kernel, if possible.

    A thread takes a training and a part of the patterns. Sums, moduli and portions of a pattern's
    nodes stay in registers; what is read of a pattern serves all trainings, and weights all
    patterns, so that hardly anything goes through memory.
    """
    statements = kernel_of(network, rule, learning, by_subnetwork=counts.ndim == 3)

    def change(weights: Array, signals: Signals, targets: Array, counts: Array) -> Array:
        return rule.change(network, weights, signals, targets, counts, learning)

    if statements is None:
        return change(weights, signals, targets, counts)
    many = partial(change_of_many, statements)
    return batched_by(change, many, 1)(weights, signals, targets, counts)


def change_of_many(
    statements: RuleStatements,
    weights: Float[Array, "trainings weights"],
    signals: Signals,
    targets: Numbers,
    counts: Counts,
) -> Float[Array, "trainings groups weights"]:
    """The changes of all trainings, by the kernel."""
    launch = launch_of(statements, len(weights))
    assert launch is not None, "checked by `kernel_of`"
    trainings, patterns = len(weights), targets.shape[-1]
    groups = -(-trainings // launch.threads)
    multiprocessors = int(getattr(jax.devices()[0], "core_count", 132))
    pieces = max(min(multiprocessors * launch.resident // groups, patterns // _FEWEST_PATTERNS), 1)
    length = -(-patterns // pieces)
    pieces = -(-patterns // length)
    sizes = jnp.array([trainings, patterns, length, groups])
    shape = jax.ShapeDtypeStruct((pieces, len(statements.sums), trainings), jnp.float64)
    kernel = Kernel("changes", source(statements, launch), launch.threads, launch.shared_bytes)
    inputs = jax.tree.leaves((signals, targets, counts.reshape(-1, patterns)))
    rows = _rows(statements, jnp.concatenate(inputs))
    (parts,) = kernel(pieces * groups, [shape], rows, weights.T, sizes)
    flat = jnp.zeros((trainings, int(np.prod(statements.shape))))
    flat = flat.at[:, np.array(statements.entries)].set(jnp.sum(parts, axis=0).T)
    return flat.reshape(trainings, *statements.shape)


def _rows(
    statements: RuleStatements, inputs: Float[Array, "inputs patterns"]
) -> Float[Array, "patterns numbers"]:
    """Compute the numbers that patterns alone decide, by a kernel of its own.

    XLA took 10 s to compile the 637 rows of a PUMA 560's PERAL, and an epoch's 0.33 ms to compute
    them, of which the kernel of changes takes 2.9.
    """
    patterns = inputs.shape[1]
    shape = jax.ShapeDtypeStruct((patterns, row_length(statements)), jnp.float64)
    kernel = Kernel("rows", rows_source(statements), ROW_THREADS)
    (rows,) = kernel(-(-patterns // ROW_THREADS), [shape], inputs, jnp.array([patterns]))
    return rows

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...adaptive import AdaptiveNetwork, Signals
from ...codegen import Kernel, kernels_run
from .._rules import AbstractRule, Counts, Numbers, Weights
from ._batching import batched_by
from ._kernel_source import ROW_THREADS, launch_of, row_length, rows_source, source
from ._statements import RuleStatements, rule_statements


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
    """`rule.change`; of many trainings on the same patterns by one kernel, where there is one.

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
    """What patterns alone decide, by a kernel of its own.

    XLA took 10 s to compile the 637 rows of a PUMA 560's PERAL, and an epoch's 0.33 ms to compute
    them, of which the kernel of changes takes 2.9.
    """
    patterns = inputs.shape[1]
    shape = jax.ShapeDtypeStruct((patterns, row_length(statements)), jnp.float64)
    kernel = Kernel("rows", rows_source(statements), ROW_THREADS)
    (rows,) = kernel(-(-patterns // ROW_THREADS), [shape], inputs, jnp.array([patterns]))
    return rows

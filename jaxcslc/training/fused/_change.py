from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from ...adaptive import AdaptiveNetwork, Signals
from ...network.straight_line import Kernel, kernels_run
from .._rules import AbstractRule, Numbers, Weights
from ._statements import RuleStatements, rule_statements


# Trainings of a block, one a thread: with 255 registers each, four blocks on a multiprocessor.
THREADS = 64
# Blocks that keep a GPU of 132 multiprocessors busy, four times over.
_BLOCKS = 2112
# Patterns that a block takes at least.
_FEWEST_PATTERNS = 32


def kernel_of(
    network: AdaptiveNetwork, rule: AbstractRule, learning: tuple[bool, ...]
) -> RuleStatements | None:
    """The statements that a kernel has for a rule; None where there is no kernel for it, or none
    runs."""
    return rule_statements(network, rule, learning) if kernels_run() else None


def summed_change(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    weights: Weights,
    signals: Signals,
    targets: Numbers,
    counts: Numbers,
    learning: tuple[bool, ...],
) -> Float[Array, "groups weights"]:
    """`rule.change`; of many trainings on the same patterns by one kernel, where there is one.

    A thread takes a training and a part of the patterns. Sums, moduli and portions of a pattern's
    nodes stay in registers; what is read of a pattern serves all trainings, and weights all
    patterns, so that hardly anything goes through memory.
    """
    statements = kernel_of(network, rule, learning)

    def change(weights: Array, signals: Signals, targets: Array, counts: Array) -> Array:
        return rule.change(network, weights, signals, targets, counts, learning)

    if statements is None:
        return change(weights, signals, targets, counts)
    return _batched(change, statements)(weights, signals, targets, counts)


def _batched(change: Callable[..., Array], statements: RuleStatements) -> Callable[..., Array]:
    """The function with a kernel in place of its `vmap` over weights, and over these again."""
    single: Any = custom_vmap(change)
    many: Any = custom_vmap(lambda *arguments: change_of_many(statements, *arguments))

    def mapped(function: Callable[..., Array], batched: list[Any]) -> Callable[..., Array]:
        axes = [jax.tree.map(lambda x: 0 if x else None, part) for part in batched]
        return jax.vmap(function, axes)

    @single.def_vmap
    def _(size: int, batched: list[Any], weights: Array, *patterns: Any) -> tuple[Array, bool]:
        del size
        if any(jax.tree.leaves(batched[1:])):
            return mapped(change, batched)(weights, *patterns), True
        return many(weights, *patterns), True

    @many.def_vmap
    def _(size: int, batched: list[Any], weights: Array, *patterns: Any) -> tuple[Array, bool]:
        if any(jax.tree.leaves(batched[1:])):
            over_weights = jax.vmap(change, (0, *(None for _ in patterns)))
            return mapped(over_weights, batched)(weights, *patterns), True
        flat = many(weights.reshape(-1, weights.shape[-1]), *patterns)
        return flat.reshape(size, -1, *flat.shape[1:]), True

    return single


def change_of_many(
    statements: RuleStatements,
    weights: Float[Array, "trainings weights"],
    signals: Signals,
    targets: Numbers,
    counts: Numbers,
) -> Float[Array, "trainings groups weights"]:
    """The changes of all trainings, by the kernel."""
    rows = jnp.stack(statements.patterns(signals, targets, counts), axis=1)
    trainings, patterns = len(weights), len(rows)
    groups = -(-trainings // THREADS)
    pieces = max(min(-(-_BLOCKS // groups), patterns // _FEWEST_PATTERNS), 1)
    length = -(-patterns // pieces)
    pieces = -(-patterns // length)
    sizes = jnp.array([trainings, patterns, length, groups])
    shape = jax.ShapeDtypeStruct((pieces, len(statements.sums), trainings), jnp.float64)
    kernel = Kernel("changes", source(statements), THREADS)
    (parts,) = kernel(pieces * groups, [shape], rows, weights.T, sizes)
    flat = jnp.zeros((trainings, int(np.prod(statements.shape))))
    flat = flat.at[:, np.array(statements.entries)].set(jnp.sum(parts, axis=0).T)
    return flat.reshape(trainings, *statements.shape)


def source(statements: RuleStatements) -> str:
    """The kernel in CUDA C."""
    functions = {"reciprocal": "reciprocal({0})"}
    lines = statements.text("row[{0}]", "weight{0}", "sum{0}", functions)
    sums = range(len(statements.sums))
    return _KERNEL.format(
        threads=THREADS,
        rows=len(statements.rows),
        weights="\n".join(
            f"const real weight{i} = weights[{i} * trainings + training];"
            for i in statements.weights
        ),
        zeros="\n".join(f"real sum{i} = 0;" for i in sums),
        statements="\n".join(lines),
        sums=len(sums),
        results="\n".join(f"result[{i} * trainings] = sum{i};" for i in sums),
    )


# NVIDIA's division has a branch for exponents at either end in each place that divides, and its
# registers: with it, PERAL on a PUMA 560 ran at 751 million pattern-epochs/s on an H200, without at
# 1,130.
_KERNEL = """typedef double real;

/* Within a unit of the last digit: two of Newton's steps from one of 20 bits, scaled from either
   end of exponents, where that one would be zero or infinite. */
__device__ __forceinline__ double reciprocal(double x)
{{
    const unsigned exponent = __double2hiint(x) & 0x7fffffff;
    const double scale = exponent < 0x10000000u ? 0x1p200 : exponent > 0x70000000u ? 0x1p-200 : 1.0;
    const double scaled = x * scale;
    double y;
    asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(scaled));
    y = fma(y, fma(-scaled, y, 1.0), y);
    return scale * fma(y, fma(-scaled, y, 1.0), y);
}}

extern "C" __global__ void __launch_bounds__({threads}) changes(
    const double* __restrict__ all_rows, const double* __restrict__ weights,
    const long long* __restrict__ sizes, double* __restrict__ results)
{{
    const long long trainings = sizes[0], patterns = sizes[1], length = sizes[2], groups = sizes[3];
    const long long group = blockIdx.x % groups, piece = blockIdx.x / groups;
    const long long training = group * {threads} + threadIdx.x;
    if (training >= trainings)
        return;
{weights}
{zeros}
    const long long last = min((piece + 1) * length, patterns);
    for (long long pattern = piece * length; pattern < last; ++pattern) {{
        const double* __restrict__ row = all_rows + pattern * {rows};
{statements}
    }}
    double* result = results + piece * {sums} * trainings + training;
{results}
}}
"""

"""CUDA kernels for many trainings: changes of their weights, and costs after changes.

`_kernel_statements` writes a rule's formulas as straight-line code, in stages of a thread. Here
stand the source, its launch layout, and the call.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float

from ..codegen import BLOCK_OVERHEAD, SHARED_MEMORY, Kernel, kernels_run, multiprocessors
from ._functions import LINEAR_COMBINER, Cost, ErrorSum, error_sum
from ._kernel_statements import MOST_STATEMENTS, KernelStage, RuleStatements, rule_statements
from ._network import AdaptiveNetwork, Signals
from ._rules import AbstractRule, Counts, Numbers, Weights


def batched_by(
    function: Callable[..., Any], many: Callable[..., Any], mapped_count: int
) -> Callable[..., Any]:
    """Give a function of one training another one as its `vmap`, and as the `vmap` of that.

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


def rule_kernel(
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
    return statements if statements is not None and launch_layout(statements, _THREADS) else None


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
    patterns, so that next to nothing goes through memory.
    """
    statements = rule_kernel(network, rule, learning, by_subnetwork=counts.ndim == 3)

    def change(weights: Array, signals: Signals, targets: Array, counts: Array) -> Array:
        return rule.change(network, weights, signals, targets, counts, learning)

    if statements is None:
        return change(weights, signals, targets, counts)
    many = partial(batched_changes, statements)
    return batched_by(change, many, 1)(weights, signals, targets, counts)


def batched_changes(
    statements: RuleStatements,
    weights: Float[Array, "trainings weights"],
    signals: Signals,
    targets: Numbers,
    counts: Counts,
) -> Float[Array, "trainings groups weights"]:
    """The changes of all trainings, by the kernel."""
    launch = launch_layout(statements, len(weights))
    assert launch is not None, "checked by `rule_kernel`"
    trainings, patterns = len(weights), targets.shape[-1]
    groups = -(-trainings // launch.threads)
    pieces = max(
        min(multiprocessors() * launch.resident // groups, patterns // _FEWEST_PATTERNS), 1
    )
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


# Threads of a multiprocessor with 255 registers each, and those that run in step.
_THREADS, _WARP = 256, 32
_MOST_PATTERNS = 8  # of a block at a time


@dataclass(frozen=True)
class Launch:
    """Launch layout of the kernel.

    Measured on one H100, 4,096 trainings of a PUMA 560 by PERAL, million pattern-epochs/s: 4702
    with 256 threads and chunks of 8, 4303 with chunks of 4; two blocks of 128 threads 4278, four of
    64 3980. More threads with fewer registers store values and read them again: 384 threads 2208,
    512 threads 936.

    **Attributes**

    - `threads`: trainings of a block, one a thread.
    - `resident`: blocks that a multiprocessor holds at once.
    - `chunk`: patterns that are in shared memory together, twice: while some are worked on, the
      next are read.
    - `shared_bytes`: of a block.
    """

    threads: int
    resident: int
    chunk: int
    shared_bytes: int


def launch_layout(statements: RuleStatements, trainings: int) -> Launch | None:
    """The layout for so many trainings; None where a multiprocessor's memory is too small."""
    threads = min(_THREADS, _WARP * -(-trainings // _WARP))
    resident = _THREADS // threads
    handed = len(statements.stages[-1].handed_in)
    of_pattern = 8 * (2 * row_length(statements) + handed * threads)
    while resident and (
        chunk := min((SHARED_MEMORY // resident - BLOCK_OVERHEAD) // of_pattern, _MOST_PATTERNS)
    ):
        if chunk > 1 or resident == 1:
            return Launch(threads, resident, chunk, chunk * of_pattern)
        resident -= 1
    return None


def row_length(statements: RuleStatements) -> int:
    """Numbers of a pattern, an even number."""
    return 2 * -(-len(statements.rows) // 2)


def source(statements: RuleStatements, launch: Launch) -> str:
    """The kernel in CUDA C."""
    functions = {"inverse": "inverse({0})"}
    ends = statements.factor_text(
        "kept(weights + {0} * trainings)",
        "result[{0} * trainings] = {1} * result[{0} * trainings];",
        functions,
    )
    seen: set[int] = set()
    stages: list[str] = []
    for stage in statements.stages:
        stages.append(_stage_text(statements, stage, functions, seen))
        seen.update(stage.sums)
    return _KERNEL.format(
        threads=launch.threads,
        resident=launch.resident,
        chunk=launch.chunk,
        pairs=row_length(statements) // 2,
        stages="\n".join(stages),
        sums=len(statements.sums),
        ends="\n".join(ends),
    )


def _stage_text(
    statements: RuleStatements, stage: KernelStage, functions: dict[str, str], seen: set[int]
) -> str:
    lines = statements.text(
        "row[{0}]", "weight{0}", "sum{0}", stage, functions, "handed[{0} * CHUNK * THREADS]"
    )
    used = sorted({int(i) for line in lines for i in re.findall(r"\bweight(\d+)\b", line)})
    return _STAGE.format(
        weights="\n".join(f"const real weight{i} = kept(weights + {i} * trainings);" for i in used),
        sums="\n".join(
            f"real sum{i} = {'' if i in seen else 'first ? 0.0 : '}result[{i} * trainings];"
            for i in stage.sums
        ),
        statements="\n".join(_with_pairs(lines)),
        stores="\n".join(f"result[{i} * trainings] = sum{i};" for i in stage.sums),
    )


def _with_pairs(lines: Sequence[str]) -> list[str]:
    """Numbers of a row read two at a time, where the first of them is needed."""
    known: set[int] = set()
    result: list[str] = []

    def half(match: re.Match[str]) -> str:
        pair, which = divmod(int(match[1]), 2)
        if pair not in known:
            known.add(pair)
            result.append(f"const double2 pair{pair} = pairs[{pair}];")
        return f"pair{pair}.{'xy'[which]}"

    for line in lines:
        text = re.sub(r"\brow\[(\d+)\]", half, line)
        result.append(text)
    return result


def rows_source(statements: RuleStatements) -> str:
    """The kernel that computes what patterns alone decide, in CUDA C: a pattern a thread."""
    lines = statements.row_text("inputs[{0} * patterns + pattern]", "row[{0}] = {1};")
    return _ROWS.format(
        threads=ROW_THREADS, length=row_length(statements), statements="\n".join(lines)
    )


_STAGE = """{{
{weights}
{sums}
#pragma unroll 1
for (int pattern = 0; pattern < count; ++pattern) {{
const double2* __restrict__ pairs = rows + pattern * PAIRS;
double* const handed = all_handed + pattern * THREADS;
{statements}
}}
if (stores) {{
{stores}
}}
asm volatile("" ::: "memory");
}}"""


ROW_THREADS = _WARP
_ROWS = """typedef double real;

extern "C" __global__ void __launch_bounds__({threads}) rows(
    const double* __restrict__ inputs, const long long* __restrict__ sizes,
    double* __restrict__ results)
{{
    const int patterns = sizes[0], pattern = blockIdx.x * {threads} + threadIdx.x;
    if (pattern >= patterns)
        return;
    double* __restrict__ const row = results + (long long)pattern * {length};
    row[{length} - 1] = 0; /* where their number is odd */
{statements}
}}
"""


_KERNEL = """typedef double real;

/* Within a unit of the last digit: 1 / x by one step of third order from one of 20 bits, which is
   set to zero, and stays there, where 1 / x is not an ordinary number. */
__device__ __forceinline__ double inverse(double x)
{{
    const int exponent = __double2hiint(x) & 0x7ff00000;
    double y;
    asm("rcp.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(x));
    y = (unsigned)(exponent - 0x00100000) < 0x7fc00000u ? y : 0.0;
    const double error = fma(-x, y, 1.0);
    return fma(y, fma(error, error, error), y);
}}

constexpr int THREADS = {threads}, CHUNK = {chunk}, PAIRS = {pairs};

/* Begins to copy a chunk's rows to shared memory. */
__device__ __forceinline__ void copy(double2* rows, const double2* all_rows, int count)
{{
    for (int i = threadIdx.x; i < count * PAIRS; i += THREADS)
        asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::
            "r"((unsigned)__cvta_generic_to_shared(rows + i)), "l"(all_rows + i));
    asm volatile("cp.async.commit_group;");
}}

/* A number that is read here, and not kept in a register, or in memory, from before. */
__device__ __forceinline__ double kept(const double* x)
{{
    double y;
    asm volatile("ld.global.nc.f64 %0, [%1];" : "=d"(y) : "l"(x));
    return y;
}}

extern "C" __global__ void __launch_bounds__(THREADS, {resident}) changes(
    const double2* __restrict__ all_rows, const double* all_weights,
    const long long* __restrict__ sizes, double* results)
{{
    extern __shared__ double2 shared[];
    const int trainings = sizes[0], patterns = sizes[1], length = sizes[2], groups = sizes[3];
    const int group = (int)blockIdx.x % groups, piece = (int)blockIdx.x / groups;
    const bool stores = group * THREADS + (int)threadIdx.x < trainings;
    const int training = stores ? group * THREADS + threadIdx.x : trainings - 1;
    const int begin = piece * length, end = min(begin + length, patterns);
    const double* const weights = all_weights + training;
    double* const all_handed = (double*)(shared + 2 * CHUNK * PAIRS) + threadIdx.x;
    double* const result = results + (long long)piece * {sums} * trainings + training;
    copy(shared, all_rows + (long long)begin * PAIRS, min(CHUNK, end - begin));
    int buffer = 0;
#pragma unroll 1
    for (int at = begin; at < end; at += CHUNK, buffer ^= 1) {{
        const bool first = at == begin;
        const int count = min(CHUNK, end - at);
        const double2* const rows = shared + buffer * CHUNK * PAIRS;
        const int next = at + CHUNK;
        if (next < end)
            copy(shared + (buffer ^ 1) * CHUNK * PAIRS, all_rows + (long long)next * PAIRS,
                min(CHUNK, end - next));
        if (next < end)
            asm volatile("cp.async.wait_group 1;" ::: "memory");
        else
            asm volatile("cp.async.wait_group 0;" ::: "memory");
        __syncthreads();
{stages}
        __syncthreads();
    }}
    if (!stores)
        return;
{ends}
}}
"""


# Warps of a block, each with a training; of 168 registers a thread, three blocks fit on a
# multiprocessor.
_WARPS, _RESIDENT = 4, 3
# Blocks for each that runs at a time: the last ones end together.
_WAVES = 4
# Bytes of shared memory that every block gets.
_COST_SHARED = 48_000


def cost_kernel(
    network: AdaptiveNetwork, cost: Cost, support: tuple[tuple[int, ...], ...], trials: int
) -> "CostKernel | None":
    """The kernel for a cost, where there is one, and it runs.

    - `support`: for each output, the weights that reach it.
    - `trials`: sets of rates; none for the cost of the weights as they are.
    """
    terms = error_sum(cost)
    if terms is None or not network.linear or network.activation != LINEAR_COMBINER:
        return None
    moved = tuple(
        tuple(sorted({int(weight) for weight in layer.links.weight}))
        for _, layer in network.adaptive_layers
    )
    kernel = CostKernel(support, moved, trials, terms)
    return kernel if kernel.fits and kernels_run() else None


@dataclass(frozen=True)
class CostKernel:
    """Costs of many trainings' weights, and after changes of them at several sets of rates.

    A warp takes a training, each of its threads a pattern: sums at the outputs, of the weights and
    of each layer's change, stay in registers for all sets of rates.

    **Attributes**

    - `support`: for each output, the weights that reach it.
    - `moved`: for each layer, the weights that its change moves.
    - `trials`: sets of rates; none for the cost of the weights as they are.
    - `cost`: what is computed of errors.
    """

    support: tuple[tuple[int, ...], ...]
    moved: tuple[tuple[int, ...], ...]
    trials: int
    cost: ErrorSum

    @property
    def costs(self) -> int:
        """Number of costs of each training."""
        return max(self.trials, 1)

    @property
    def together(self) -> int:
        """Trainings of a warp, as many as registers hold: a pattern's numbers are read for all."""
        return {0: 4, 1: 2}.get(self.trials, 1)

    def __call__(
        self,
        weights: Float[Array, "trainings weights"],
        change: Float[Array, "trainings groups weights"] | None,
        trials: Float[Array, "trainings trials groups"] | None,
        condensed: Sequence[Float[Array, "_ patterns"]],
        targets: Float[Array, "outputs patterns"],
        counts: Float[Array, "outputs patterns"],
    ) -> Float[Array, "trainings costs"]:
        """The costs of all trainings."""
        masked = (
            counts**2 if self.cost.square else counts
        )  # that errors would have been multiplied by
        rows = jnp.concatenate([*condensed, targets, self.cost.shares(counts) * masked])
        patterns, trainings = rows.shape[1], len(weights)
        tiles = -(-patterns // _WARP)
        rows = jnp.pad(rows, ((0, 0), (0, tiles * _WARP - patterns)))
        rows = rows.reshape(len(rows), tiles, _WARP).transpose(1, 0, 2)
        arrays = [weights]
        if change is not None and trials is not None:
            arrays += [change.reshape(trainings, -1), trials.reshape(trainings, -1)]
        numbers = jnp.concatenate(arrays, axis=1)[:, np.array(self._own(weights.shape[1]), int)]
        groups = -(-trainings // (_WARPS * self.together))
        pieces = min(max(_WAVES * _RESIDENT * multiprocessors() // groups, 1), tiles)
        sizes = jnp.array([trainings, tiles, pieces, groups])
        shape = jax.ShapeDtypeStruct((pieces, self.costs, trainings), jnp.float64)
        kernel = Kernel("costs", self.source, _WARPS * _WARP)
        (parts,) = kernel(pieces * groups, [shape], rows, numbers, sizes)
        return (jnp.sum(parts, axis=0) * self.cost.scale(counts)).T

    @property
    def fits(self) -> bool:
        """True if the kernel compiles in seconds and a block's numbers are in its memory."""
        outputs, groups = len(self.support), len(self.moved)
        entries = sum(map(len, self.support))
        statements = (entries + self.costs * outputs) * (2 + groups) * self.together
        return (
            statements <= MOST_STATEMENTS
            and 8 * _WARPS * self.together * self._numbers <= _COST_SHARED
        )

    @property
    def _numbers(self) -> int:
        """Number of a training's values that the kernel reads, an even number."""
        return len(self._own(max(self._weights, default=0) + 1))

    def _own(self, size: int) -> list[int]:
        """Return indices of a training's weights, changes and rates as the kernel reads them.

        Their number is even.

        - `size`: the number of weights.
        """
        groups = len(self.moved)
        order: list[int] = []
        for weight in self._weights:
            order.append(weight)
            order += [size * (1 + group) + weight for group in self._movers(weight)]
        rates = range(size * (1 + groups), size * (1 + groups) + self.trials * groups)
        order += rates
        return order + order[-1:] * (len(order) % 2)

    @property
    def _weights(self) -> list[int]:
        return sorted(set().union(*self.support))

    def _movers(self, weight: int) -> list[int]:
        """The layers whose change moves a weight."""
        return [group for group, moved in enumerate(self.moved) if self.trials and weight in moved]

    @property
    def source(self) -> str:
        """The kernel in CUDA C."""
        outputs = range(len(self.support))
        entries = [(o, weight) for o in outputs for weight in self.support[o]]
        row_of = {entry: i for i, entry in enumerate(entries)}
        targets, shares = len(entries), len(entries) + len(outputs)
        parts = sorted({(g, o) for o, weight in entries for g in self._movers(weight)})
        lines = [
            f"real e{u}_{o} = row[{_WARP * (targets + o)}];"
            for o in outputs
            for u in range(self.together)
        ]
        lines += [f"real p{u}_{g}_{o} = 0;" for g, o in parts for u in range(self.together)]
        offset = 0
        for weight in self._weights:
            movers = self._movers(weight)
            for u in range(self.together):
                lines.append(f"const real w{u}_{weight} = own{u}[{offset}];")
                lines += [
                    f"const real c{u}_{g}_{weight} = own{u}[{offset + 1 + i}];"
                    for i, g in enumerate(movers)
                ]
            offset += 1 + len(movers)
            for o in (o for o in outputs if (o, weight) in row_of):
                a = f"a{o}_{weight}"
                lines.append(f"const real {a} = row[{_WARP * row_of[o, weight]}];")
                for u in range(self.together):
                    lines.append(f"e{u}_{o} -= {a} * w{u}_{weight};")
                    lines += [f"p{u}_{g}_{o} += {a} * c{u}_{g}_{weight};" for g in movers]
        lines += [f"const real s{o} = row[{_WARP * (shares + o)}];" for o in outputs]
        groups = range(len(self.moved)) if self.trials else range(0)
        for cost in range(self.costs):
            for u in range(self.together):
                lines += ["{", "real sum = 0;"]
                lines += [f"const real r{g} = own{u}[{offset + g}];" for g in groups]
                for o in outputs:
                    steps = "".join(f" - r{g} * p{u}_{g}_{o}" for g in groups if (g, o) in parts)
                    lines.append(f"const real d{o} = e{u}_{o}{steps};")
                    size = f"d{o} * d{o}" if self.cost.square else f"fabs(d{o})"
                    lines.append(f"sum += s{o} * ({size});")
                lines += [f"total{u}_{cost} += {'root(sum)' if self.cost.root else 'sum'};", "}"]
            offset += len(groups)
        offset += offset % 2
        totals = [(u, cost) for u in range(self.together) for cost in range(self.costs)]
        return _COST_KERNEL.format(
            warps=_WARPS,
            resident=_RESIDENT,
            together=self.together,
            own=offset,
            rows=len(entries) + 2 * len(outputs),
            zeros="\n".join(f"real total{u}_{i} = 0;" for u, i in totals),
            numbers="\n".join(
                f"const double* const own{u} = own + {u * offset};" for u in range(self.together)
            ),
            statements="\n".join(lines),
            costs=self.costs,
            sums="\n".join(f"total{u}_{i} = over_warp(total{u}_{i});" for u, i in totals),
            stores="\n".join(
                f"if (first + {u} < trainings) result[{i} * trainings + {u}] = total{u}_{i};"
                for u, i in totals
            ),
        )


_COST_KERNEL = """typedef double real;

__device__ __forceinline__ real over_warp(real x)
{{
    for (int other = 16; other; other /= 2)
        x += __shfl_xor_sync(0xffffffffu, x, other);
    return x;
}}

/* Within a unit of the last digit, without the library's branch; what has no square root of its own
   kind, zero, infinity or no number, is its own. */
__device__ __forceinline__ real root(real x)
{{
    const unsigned exponent = __double2hiint(x) & 0x7ff00000;
    double y;
    asm("rsqrt.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(x));
    double g = x * y, h = 0.5 * y;
    const double error = fma(-g, h, 0.5);
    g = fma(g, error, g);
    h = fma(h, error, h);
    g = fma(fma(-g, g, x), h, g);
    return exponent - 0x00100000u < 0x7fe00000u ? g : x;
}}

extern "C" __global__ void __launch_bounds__(32 * {warps}, {resident}) costs(
    const double* __restrict__ rows, const double* __restrict__ all_own,
    const long long* __restrict__ sizes, double* __restrict__ results)
{{
    constexpr int TOGETHER = {together}, OWN = {own};
    __shared__ double2 numbers[{warps} * TOGETHER * OWN / 2];
    const int trainings = sizes[0], tiles = sizes[1], pieces = sizes[2], groups = sizes[3];
    const int group = (int)blockIdx.x % groups, piece = (int)blockIdx.x / groups;
    const int warp = (int)threadIdx.x / 32, lane = threadIdx.x % 32;
    const int first = (group * {warps} + warp) * TOGETHER;
    if (first >= trainings)
        return;
    double* const own = (double*)(numbers + warp * TOGETHER * OWN / 2);
    for (int i = lane; i < min(TOGETHER, trainings - first) * OWN; i += 32)
        own[i] = all_own[(long long)first * OWN + i];
    __syncwarp();
{numbers}
{zeros}
#pragma unroll 1
    for (int tile = piece; tile < tiles; tile += pieces) {{
        asm volatile("" ::: "memory"); /* numbers are read again: registers do not hold them */
        const double* __restrict__ row = rows + (long long)tile * {rows} * 32 + lane;
{statements}
    }}
{sums}
    if (lane)
        return;
    double* result = results + (long long)piece * {costs} * trainings + first;
{stores}
}}
"""

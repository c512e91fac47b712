"""CUDA code that computes a network's columns and their products on an NVIDIA GPU.

Generated from `_weighted_columns` by `codegen`; `_products` launches it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from ..codegen import Kernel, KernelText, Motion, Operation, Value
from ..network import CSLC
from ._weighted_columns import WeightedColumn, weighted_columns


# Of a block: so many warps share 32 patterns. Each computes a part of the columns of all 32, then
# the products of some of the joints.
WARPS = 4
_PATTERNS = 32
# Rows of patterns in shared memory, padded so that what a warp reads at once is in other banks.
_STRIDE = _PATTERNS + 4
_TILE = 8
# Blocks that a multiprocessor holds at once, so that one computes columns while another multiplies,
# and its memory for them [bytes]: of a PUMA 560 four, of a Panda two.
_MOST_RESIDENT = 4
_SHARED = 227 * 1024


@dataclass(frozen=True)
class GramKernel:
    """A kernel that computes columns and their products without writing columns to memory.

    **Attributes**

    - `kernel`: of inputs q, qd, qdd, torque, weight, packed inverses, rows and number of patterns.
    - `sizes`: for each joint its number of columns, the torque's included.
    - `resident`: blocks that a multiprocessor holds at once.
    """

    kernel: Kernel
    sizes: tuple[int, ...]
    resident: int

    @property
    def tiles(self) -> int:
        """Tiles of 8 x 8 in the lower triangles of all joints' products."""
        return sum(len(tiles_of(size)) for size in self.sizes)


def tiles_of(size: int) -> list[tuple[int, int]]:
    """Rows and columns, in tiles of 8 x 8, of a lower triangle."""
    return [(i, j) for i in range(-(-size // _TILE)) for j in range(i + 1)]


@lru_cache(maxsize=16)
def gram_kernel(network: CSLC) -> GramKernel:
    """The kernel of a network, from the expressions of its regressor's entries.

    Patterns go through three stages. Sines and cosines, and then columns, are computed as
    straight-line code, a pattern a thread; columns go to shared memory. Then each warp takes
    joints: it multiplies their rows by the inverse triangle and by each other in tiles of 8 x 8 on
    the float64 matrix units. What comes out of the first product is, in registers, what goes into
    the second one.
    """
    motion, outputs = weighted_columns(network)
    sizes = tuple(len(row) + 1 for row in network.support)
    source, shared, resident = _source(motion, sizes, outputs)
    return GramKernel(Kernel("grams", source, 32 * WARPS, shared), sizes, resident)


def _source(
    motion: Motion, sizes: Sequence[int], outputs: Sequence[WeightedColumn]
) -> tuple[str, int, int]:
    """The kernel's text, a block's shared memory [bytes], and blocks of a multiprocessor."""
    graph = motion.graph
    functions = [
        graph.operations[i]
        for i in graph.needed(output.value for output in outputs)
        if graph.operations[i].name in ("sin", "cos")
    ]
    angles = list(dict.fromkeys(operation.arguments[0] for operation in functions))

    def reading(operation: Operation) -> str | None:
        if operation.name == "input":
            return _input_text(operation.text, len(motion.q), len(sizes))
        if operation.name in ("sin", "cos"):
            angle = angles.index(operation.arguments[0])
            return f"trigonometry[{32 * (2 * angle + (operation.name == 'sin'))} + lane]"
        return None

    text = KernelText(graph, reading)
    parts = _shared_out(text, outputs)
    columns = [
        text.statements(
            (x.value, f"rows[row_of[{x.row}] * {_STRIDE} + lane] = inside ? {{0}} : 0;")
            for x in part
        )
        for part in parts
    ]
    turns = [
        text.statements(
            (Value(graph, angle), _SINE_AND_COSINE.format(64 * i, 64 * i + 32))
            for i, angle in enumerate(angles)
            if i % WARPS == warp
        )
        for warp in range(WARPS)
    ]
    products, results, accumulators = _products(sizes)
    tiles = sum(len(tiles_of(size)) for size in sizes)
    rows = sum(sizes) + 3  # what is read behind the last joint's counts for nothing
    doubles = 64 * tiles + 64 * len(angles) + _STRIDE * rows
    shared = 8 * doubles + 4 * (sum(sizes) + sum(sizes) % 2)
    resident = max(min(_SHARED // (shared + 1024), _MOST_RESIDENT), 1)
    source = _KERNEL.format(
        joints=len(motion.q),
        inverse=64 * tiles,
        trigonometry=64 * len(angles),
        rows=_STRIDE * rows,
        count=sum(sizes),
        padding=_STRIDE * sum(sizes),
        stride=_STRIDE,
        threads=32 * WARPS,
        accumulators=accumulators,
        turns=_by_warp(turns),
        columns=_by_warp(columns),
        products=_by_warp(products),
        results=_by_warp(results),
        tiles=tiles,
        resident=resident,
    )
    return source, shared, resident


def _input_text(name: str, motion: int, joints: int) -> str:
    quantity, index = name.rstrip("]").split("[")
    width = joints if quantity in ("torque", "weight") else motion
    return f"{quantity}[pattern * {width} + {index}]"


def _by_warp(parts: Sequence[Sequence[str]]) -> str:
    """Statements of which each warp computes its own."""
    cases = [
        f"if (warp == {warp}) {{\n" + "\n".join(lines) + "\n}" for warp, lines in enumerate(parts)
    ]
    return "\nelse ".join(cases)


def _shared_out(text: KernelText, outputs: Sequence[WeightedColumn]) -> list[list[WeightedColumn]]:
    """Columns by warp: all of a coefficient, or of coefficients nearby, have most in common."""
    below = {output.row: set(text.needed([output.value])) for output in outputs}

    def cut(order: Sequence[WeightedColumn], most: int) -> list[list[WeightedColumn]]:
        parts: list[list[WeightedColumn]] = [[]]
        needed: set[int] = set()
        for output in order:
            if parts[-1] and len(needed | below[output.row]) > most:
                parts.append([])
                needed = set()
            parts[-1].append(output)
            needed |= below[output.row]
        return parts

    orders = (
        sorted(outputs, key=lambda x: (x.coefficient, x.row)),
        sorted(outputs, key=lambda x: x.row),
    )
    for most in range(8, 1 << 20, 8):
        for order in orders:
            parts = cut(order, most)
            if len(parts) <= WARPS:
                return parts + [[] for _ in range(WARPS - len(parts))]
    raise AssertionError("unreachable: all columns fit into one part")


def _products(sizes: Sequence[int]) -> tuple[list[list[str]], list[list[str]], int]:
    """Return each warp's products and where they go, and the largest number of tiles of a warp."""
    tiles = [len(tiles_of(size)) for size in sizes]
    firsts = [sum(tiles[:joint]) for joint in range(len(sizes))]
    of_warp: list[list[int]] = [[] for _ in range(WARPS)]
    for joint in sorted(range(len(sizes)), key=lambda joint: -tiles[joint]):
        min(of_warp, key=lambda joints: sum(tiles[j] for j in joints)).append(joint)
    products: list[list[str]] = []
    results: list[list[str]] = []
    for joints in of_warp:
        lines, ends, used = list[str](), list[str](), 0
        for joint in joints:
            high, steps = -(-sizes[joint] // _TILE), -(-sizes[joint] // 4)
            row = sum(sizes[:joint])
            lines.append(
                f"products<{high}, {steps}>(rows + {_STRIDE * row}, inverse + {64 * firsts[joint]},"
                f" sums + {2 * used}, lane);"
            )
            ends.append(
                f"#pragma unroll\nfor (int t = 0; t < {tiles[joint]}; ++t)\n"
                f"    store(result + ({firsts[joint]} + t) * 64, sums + 2 * ({used} + t), lane);"
            )
            used += tiles[joint]
        products.append(lines)
        results.append(ends)
    return products, results, max(sum(tiles[j] for j in joints) for joints in of_warp)


_SINE_AND_COSINE = (
    "{{{{ double s, c; sincos({{0}}, &s, &c);"
    " trigonometry[{0} + lane] = c; trigonometry[{1} + lane] = s; }}}}"
)

_KERNEL = """typedef double real;

__device__ __forceinline__ void multiply_add(double* sum, double a, double b)
{{
    asm("mma.sync.aligned.m8n8k4.row.col.f64.f64.f64.f64 {{%0, %1}}, {{%2}}, {{%3}}, {{%0, %1}};"
        : "+d"(sum[0]), "+d"(sum[1]) : "d"(a), "d"(b));
}}

/* Rows of one joint times its inverse triangle, and the products of that: 16 patterns at a time. */
template <int high, int steps>
__device__ __forceinline__ void products(
    const double* rows, const double* inverse, double* sums, int lane)
{{
#pragma unroll 1
    for (int half = 0; half < 2; ++half) {{
        double x[steps][2], y[high][2][2];
#pragma unroll
        for (int k = 0; k < steps; ++k)
#pragma unroll
            for (int g = 0; g < 2; ++g)
                x[k][g] = rows[(4 * k + lane % 4) * {stride} + 16 * half + 8 * g + lane / 4];
#pragma unroll
        for (int i = 0; i < high; ++i) {{
#pragma unroll
            for (int g = 0; g < 2; ++g)
                y[i][g][0] = y[i][g][1] = 0.0;
#pragma unroll
            for (int k = 0; k < steps && k < 2 * i + 2; ++k) {{
                const double a = inverse[(i * (i + 1) + k) * 32 + lane];
#pragma unroll
                for (int g = 0; g < 2; ++g)
                    multiply_add(y[i][g], a, x[k][g]);
            }}
        }}
#pragma unroll
        for (int g = 0; g < 2; ++g)
#pragma unroll
            for (int e = 0; e < 2; ++e)
#pragma unroll
                for (int i = 0; i < high; ++i)
#pragma unroll
                    for (int j = 0; j <= i; ++j)
                        multiply_add(sums + 2 * (i * (i + 1) / 2 + j), y[i][g][e], y[j][g][e]);
    }}
}}

__device__ __forceinline__ void store(double* tile, const double* sum, int lane)
{{
    tile[lane * 2] = sum[0];
    tile[lane * 2 + 1] = sum[1];
}}

extern "C" __global__ void __launch_bounds__({threads}, {resident}) grams(
    const double* __restrict__ q, const double* __restrict__ qd, const double* __restrict__ qdd,
    const double* __restrict__ torque, const double* __restrict__ weight,
    const double* __restrict__ all_inverses, const int* __restrict__ all_rows,
    const long long* __restrict__ patterns, double* __restrict__ results)
{{
    extern __shared__ double memory[];
    double* inverse = memory;
    double* trigonometry = inverse + {inverse};
    double* rows = trigonometry + {trigonometry};
    int* row_of = (int*)(rows + {rows});
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    for (int i = threadIdx.x; i < {inverse}; i += {threads})
        inverse[i] = all_inverses[i];
    for (int i = threadIdx.x; i < {count}; i += {threads})
        row_of[i] = all_rows[i];
    for (int i = {padding} + threadIdx.x; i < {rows}; i += {threads})
        rows[i] = 0.0;
    double sums[2 * {accumulators}];
#pragma unroll
    for (int i = 0; i < 2 * {accumulators}; ++i)
        sums[i] = 0.0;
    __syncthreads();
    const long long last = patterns[0] - 1;
    for (long long start = 32LL * blockIdx.x; start <= last; start += 32LL * gridDim.x) {{
        const bool inside = start + lane <= last;
        const long long pattern = inside ? start + lane : last;
{turns}
        __syncthreads();
{columns}
        __syncthreads();
{products}
    }}
    double* result = results + 64LL * {tiles} * blockIdx.x;
{results}
}}
"""

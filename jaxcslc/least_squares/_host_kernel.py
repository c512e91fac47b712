"""C code that computes a network's columns and their products on a processor.

Generated from `_weighted_columns` by `codegen`; `_preconditioned` uses it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from ..codegen import (
    LANES_TEXT,
    LONG,
    SINES_TEXT,
    CArray,
    CFunction,
    KernelText,
    Motion,
    Operation,
    Value,
    block_row,
    block_text,
    called_functions,
)
from ..network import CSLC, AbstractLinearNetwork
from ._weighted_columns import weighted_columns


# Patterns whose columns are in memory at once: those of a Panda take 0.4 MB, a core's cache.
_BLOCK = 256
# Tiles of products are of 4 x 4 columns.
_TILE = 4
# Numbers that the widest registers have: sums of tiles have room for so many partial ones.
_LANES = 8


@dataclass(frozen=True)
class HostKernel:
    """A function in C that computes columns and their products without writing columns to memory.

    What `GramKernel` is for a GPU, for a core.

    **Attributes**

    - `source`: of the function `grams`.
    - `sizes`: for each joint its number of columns, the torque's included.
    - `memory`: numbers that it needs room for.

    Call `products` to run it.
    """

    source: str
    sizes: tuple[int, ...]
    memory: int

    def products(
        self,
        inverses: Sequence[Float[np.ndarray, "_ _"]],
        q: Float[np.ndarray, "samples motion"],
        qd: Float[np.ndarray, "samples motion"],
        qdd: Float[np.ndarray, "samples motion"],
        torque: Float[np.ndarray, "samples joints"],
        weight: Float[np.ndarray, "samples joints"] | Bool[np.ndarray, "samples joints"],
    ) -> tuple[Float[np.ndarray, "..."], ...]:
        """Return the products of weighted, preconditioned rows, per joint (s + 1, s + 1).

        The last array holds each joint's number of rows with a weight other than zero, (n,).

        One call of C does all of it, and other threads of Python run meanwhile: sixteen threads
        that come back to Python for blocks of 4,096 patterns, as for sines and cosines of NumPy's,
        wait for each other most of the time.

        **Raises** `OSError` where there is no C compiler. See `host_kernel_of`.
        """
        packed, rows = self._packed(inverses)
        tiles = np.empty((sum(_tiles(size) for size in self.sizes), _TILE * _TILE))
        counts = np.empty(len(self.sizes))
        is_bool = weight.dtype == bool
        weights = weight if is_bool else np.asarray(weight, float)
        arrays = packed, rows, np.empty(self.memory), tiles, counts
        self.grams(q, qd, qdd, torque, weights, is_bool, len(q), *arrays)
        return *self._unpacked(tiles), counts

    @property
    def grams(self) -> CFunction:
        """The function."""
        motion, joints = CArray("samples motion"), "samples joints"
        arrays = CArray("packed"), CArray("rows", np.intc)
        written = "memory", "tiles numbers", "joints"
        outputs = (CArray(axes, written=True) for axes in written)
        weight = CArray(joints, dtype=None), LONG, LONG
        kinds = (motion, motion, motion, CArray(joints), *weight, *arrays, *outputs)
        return CFunction(self.source, "grams", kinds)

    def _packed(self, inverses: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the inverses' transposes, and the rows of columns in the order of pivots.

        An inverse is a triangle whose rows are in the order of pivots: a row's pivot is the first
        entry that is not zero.
        """
        packed: list[np.ndarray] = []
        rows: list[np.ndarray] = []
        for joint, (size, inverse) in enumerate(zip(self.sizes, inverses, strict=True)):
            nonzero = inverse != 0.0
            pivots = np.where(np.any(nonzero, axis=1), np.argmax(nonzero, axis=1), size)
            order = np.argsort(pivots, kind="stable")
            wide = np.zeros((_padded(size), size))
            wide[:size] = np.tril(inverse[order].T)
            # In the order in which they are read: tiles of rows, then column after column.
            packed.append(wide.reshape(-1, _TILE, size).swapaxes(1, 2).ravel())
            rows.append(order + sum(self.sizes[:joint]))
        return np.concatenate(packed), np.concatenate(rows).astype(np.intc)

    def _unpacked(self, tiles: np.ndarray) -> tuple[np.ndarray, ...]:
        matrices: list[np.ndarray] = []
        first = 0
        for size in self.sizes:
            wide = np.zeros((_padded(size), _padded(size)))
            for i in range(0, size, _TILE):
                for j in range(0, i + 1, _TILE):
                    tile = tiles[first].reshape(_TILE, _TILE)
                    wide[i : i + _TILE, j : j + _TILE] = tile
                    wide[j : j + _TILE, i : i + _TILE] = tile.T
                    first += 1
            matrices.append(wide[:size, :size])
        return tuple(matrices)


def host_kernel_of(network: AbstractLinearNetwork) -> HostKernel | None:
    """The kernel of a network, from the expressions of its regressor's entries.

    None where there is no C compiler, and for networks that cannot be written as expressions.
    """
    if not isinstance(network, CSLC) or not network.has_host_columns:
        return None
    if not network.has_column_entries:
        return None
    kernel = host_kernel(network)
    return kernel if kernel.grams.is_available else None


@lru_cache(maxsize=16)
def host_kernel(network: CSLC) -> HostKernel:
    """The kernel of a network, whether it can be compiled or not."""
    motion, columns = weighted_columns(network)
    graph = motion.graph
    sizes = tuple(len(row) + 1 for row in network.support)
    functions = called_functions(graph, [column.value for column in columns])
    widths = {"q": motion.q, "qd": motion.qd, "qdd": motion.qdd, "torque": sizes, "weight": sizes}
    behind = sum(map(len, widths.values()))
    firsts = np.cumsum([0, *map(len, widths.values())]).tolist()
    inputs_rows = {name: ("inputs", first) for name, first in zip(widths, firsts, strict=False)}
    text = block_text(graph, _BLOCK, inputs_rows, functions, ("inputs", behind))
    rows = {graph.operations[index]: behind + i for i, index in enumerate(functions)}
    lines = text.statements(
        (column.value, f"{block_row('columns', _BLOCK, column.row)} = {{0}};") for column in columns
    )
    inputs = _BLOCK * (behind + len(functions))
    of_columns, transformed = _BLOCK * sum(sizes), _BLOCK * _padded(max(sizes))
    sums = _LANES * _TILE * _TILE * sum(map(_tiles, sizes))
    source = _KERNEL.format(
        block=_BLOCK,
        lanes=LANES_TEXT,
        sines=SINES_TEXT,
        joints=len(sizes),
        motion=len(motion.q),
        functions="\n".join(_function_lines(motion, text, functions, rows)),
        statements="\n".join(lines),
        products="\n".join(_calls(sizes)),
        inputs=inputs,
        columns=of_columns,
        transformed=transformed,
        tiles=sum(map(_tiles, sizes)),
    )
    # From the next address that vectors like best on.
    return HostKernel(source, sizes, inputs + of_columns + transformed + sums + _LANES)


def _function_lines(
    motion: Motion, text: KernelText, functions: Sequence[int], rows: dict[Operation, int]
) -> list[str]:
    """Loops over a block for each argument, and then for what is computed of it."""
    graph, lines = motion.graph, list[str]()
    row_of = {
        (operation.name, operation.arguments[0]): f"inputs + {_BLOCK * row}"
        for operation, row in rows.items()
    }
    for argument in dict.fromkeys(graph.operations[index].arguments[0] for index in functions):
        computed = text.statements([(Value(graph, argument), "argument[i] = {0};")])
        lines += ["for (int i = 0; i < BLOCK; ++i) {", *computed, "}"]
        turned = [row_of.get((name, argument)) for name in ("sin", "cos")]
        if any(turned):
            sine, cosine = (row or "unused" for row in turned)
            lines.append(f"sines_and_cosines(argument, {sine}, {cosine}, BLOCK);")
        for name in ("exp", "tanh"):
            if (row := row_of.get((name, argument))) is not None:
                lines.append(f"for (int i = 0; i < BLOCK; ++i) ({row})[i] = {name}(argument[i]);")
    return lines


def _calls(sizes: Sequence[int]) -> list[str]:
    """The products of each joint, from where its numbers are."""
    calls: list[str] = []
    packed = rows = tiles = 0
    for size in sizes:
        calls.append(
            f"products({size}, columns, inverses + {packed}, rows + {rows}, transformed,"
            f" sums + {tiles * _TILE * _TILE} * LANES);"
        )
        packed, rows, tiles = packed + _padded(size) * size, rows + size, tiles + _tiles(size)
    return calls


def _padded(size: int) -> int:
    return -(-size // _TILE) * _TILE


def _tiles(size: int) -> int:
    """Return the number of tiles of a lower triangle."""
    high = -(-size // _TILE)
    return high * (high + 1) // 2


_KERNEL = """#include <math.h>
#include <stdint.h>

#define BLOCK {block}
#define JOINTS {joints}
#define MOTION {motion}
#define TILES {tiles}
{lanes}
/* So many rows of a tile at a time that their sums, four registers each, leave some free. */
#if defined(__AVX512F__) || defined(__aarch64__)
#define ROWS 4
#else
#define ROWS 2
#endif

typedef double real;
{sines}
/* Rows of numbers of patterns as columns, each in a block of its own; behind the last one zeros. */
static void transpose(const double* rows, int width, int count, double* restrict columns)
{{
    for (int j = 0; j < width; ++j) {{
        for (int i = 0; i < count; ++i)
            columns[BLOCK * j + i] = rows[width * i + j];
        for (int i = count; i < BLOCK; ++i)
            columns[BLOCK * j + i] = 0.0;
    }}
}}

static void transpose_bytes(const unsigned char* rows, int count, double* restrict columns)
{{
    for (int j = 0; j < JOINTS; ++j) {{
        for (int i = 0; i < count; ++i)
            columns[BLOCK * j + i] = rows[JOINTS * i + j];
        for (int i = count; i < BLOCK; ++i)
            columns[BLOCK * j + i] = 0.0;
    }}
}}

/* Sines and other functions of the motion, behind the inputs that they are of. */
static void compute_functions(double* inputs)
{{
    double argument[BLOCK], unused[BLOCK];
{functions}
    (void)argument, (void)unused;
}}

/* The weighted columns of a block of patterns. */
static void compute_columns(const double* restrict inputs, double* restrict columns)
{{
    for (int i = 0; i < BLOCK; ++i) {{
{statements}
    }}
}}

/* Columns of one joint times its inverse triangle, and the products of that, 4 x 4 at a time. */
static void products(
    int size, const double* columns, const double* inverse, const int* rows,
    double* transformed, double* sums)
{{
    for (int row = 0; row < size; row += 4) {{
        const int last = row + 4 < size ? row + 4 : size;
        for (int start = 0; start < BLOCK; start += 4 * LANES)
            for (int part = 0; part < 4; part += ROWS) {{
                lanes y[ROWS][4] = {{{{{{0}}}}}};
                for (int k = 0; k < last; ++k) {{
                    const lanes* x = (const lanes*)(columns + BLOCK * rows[k] + start);
                    const double* a = inverse + 4 * k + part;
                    for (int r = 0; r < ROWS; ++r)
                        for (int c = 0; c < 4; ++c)
                            y[r][c] += a[r] * x[c];
                }}
                for (int r = 0; r < ROWS; ++r)
                    for (int c = 0; c < 4; ++c)
                        *(lanes*)(transformed + BLOCK * (row + part + r) + start + LANES * c)
                            = y[r][c];
            }}
        inverse += 4 * size;
    }}
    for (int row = 0; row < size; row += 4)
        for (int column = 0; column <= row; column += 4)
            for (int part = 0; part < 4; part += ROWS) {{
                lanes* sum = (lanes*)sums;
                lanes y[ROWS][4];
                for (int r = 0; r < ROWS; ++r)
                    for (int c = 0; c < 4; ++c)
                        y[r][c] = sum[4 * r + c];
                const double* left = transformed + BLOCK * (row + part);
                const double* right = transformed + BLOCK * column;
                for (int start = 0; start < BLOCK; start += LANES)
                    for (int r = 0; r < ROWS; ++r)
                        for (int c = 0; c < 4; ++c)
                            y[r][c] += *(const lanes*)(left + BLOCK * r + start)
                                * *(const lanes*)(right + BLOCK * c + start);
                for (int r = 0; r < ROWS; ++r)
                    for (int c = 0; c < 4; ++c)
                        sum[4 * r + c] = y[r][c];
                sums += 4 * ROWS * LANES;
            }}
}}

/* The products of all patterns, tile by tile, and how many of each joint have a weight. */
void grams(const double* q, const double* qd, const double* qdd, const double* torque,
           const void* weight, long weight_is_bytes, long samples,
           const double* inverses, const int* rows, double* memory,
           double* results, double* counts)
{{
    double* inputs = (double*)(((uintptr_t)memory + 8 * LANES - 1) / (8 * LANES) * (8 * LANES));
    double* columns = inputs + {inputs};
    double* transformed = columns + {columns};
    double* sums = transformed + {transformed};
    double* weights = inputs + BLOCK * (3 * MOTION + JOINTS);
    for (int i = 0; i < 16 * TILES * LANES; ++i)
        sums[i] = 0.0;
    for (int j = 0; j < JOINTS; ++j)
        counts[j] = 0.0;
    for (long start = 0; start < samples; start += BLOCK) {{
        const int count = samples - start < BLOCK ? samples - start : BLOCK;
        transpose(q + MOTION * start, MOTION, count, inputs);
        transpose(qd + MOTION * start, MOTION, count, inputs + BLOCK * MOTION);
        transpose(qdd + MOTION * start, MOTION, count, inputs + 2 * BLOCK * MOTION);
        transpose(torque + JOINTS * start, JOINTS, count, inputs + 3 * BLOCK * MOTION);
        if (weight_is_bytes)
            transpose_bytes((const unsigned char*)weight + JOINTS * start, count, weights);
        else
            transpose((const double*)weight + JOINTS * start, JOINTS, count, weights);
        for (int j = 0; j < JOINTS; ++j) {{
            int counted = 0;
            for (int i = 0; i < BLOCK; ++i)
                counted += weights[BLOCK * j + i] != 0.0;
            counts[j] += counted;
        }}
        compute_functions(inputs);
        compute_columns(inputs, columns);
{products}
    }}
    for (int i = 0; i < 16 * TILES; ++i) {{
        results[i] = 0.0;
        for (int lane = 0; lane < LANES; ++lane)
            results[i] += sums[LANES * i + lane];
    }}
}}
"""

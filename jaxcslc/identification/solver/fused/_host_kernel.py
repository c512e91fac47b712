import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ....network import CSLC, AbstractLinearNetwork
from ....network.straight_line import KernelText, Operation, Program, Value, c_library
from ._weighted_columns import weighted_columns


# Patterns whose columns are in memory at once: those of a Panda take 0.4 MB, a core's cache.
_BLOCK = 256
# Patterns of which NumPy computes sines and cosines at once, a whole number of blocks.
_PIECE = 4096
# Tiles of products are of 4 x 4 columns.
_TILE = 4
# Numbers that the widest registers have; results have room for so many partial sums.
_LANES = 8
# What NumPy computes: its functions are as exact as the C library's and take less time.
_OF_NUMPY = ("sin", "cos", "exp", "tanh")


@dataclass(frozen=True)
class HostKernel:
    """A function in C that computes columns and their products without writing columns to memory.

    What `GramKernel` is for a GPU, for a core.

    **Attributes**

    - `source`: of the function `grams`.
    - `functions`: sines and cosines of the motion, which NumPy computes.
    - `sizes`: for each joint its number of columns, the torque's included.
    - `motion`: the number of columns of a motion.

    Call `products` to run it.
    """

    source: str
    functions: Program
    sizes: tuple[int, ...]
    motion: int

    def products(
        self,
        inverses: Sequence[Float[np.ndarray, "_ _"]],
        q: Float[np.ndarray, "samples motion"],
        qd: Float[np.ndarray, "samples motion"],
        qdd: Float[np.ndarray, "samples motion"],
        torque: Float[np.ndarray, "samples joints"],
        weight: Float[np.ndarray, "samples joints"],
    ) -> tuple[Float[np.ndarray, "_ _"], ...]:
        """For each joint the products of weighted rows behind a preconditioner, (s + 1, s + 1).

        **Raises** `OSError` where there is no C compiler. See `host_kernel_of`.
        """
        library = c_library(self.source)
        if library is None:
            raise OSError("there is no C compiler: cc, or what the environment's CC names")
        packed, rows = self._packed(inverses)
        tiles = sum(_tiles(size) for size in self.sizes)
        sums = np.zeros((tiles, _TILE * _TILE, _LANES))
        joints, of_motion = len(self.sizes), 3 * self.motion
        inputs = np.empty((of_motion + 2 * joints + self.functions.outputs, _PIECE))
        memory = np.empty(_BLOCK * (sum(self.sizes) + _padded(max(self.sizes))))
        for start in range(0, len(q), _PIECE):
            piece = slice(start, start + _PIECE)
            length = min(len(q) - start, _PIECE)
            first = 0
            for x in (q, qd, qdd, torque, weight):
                inputs[first : first + x.shape[1], :length] = x[piece].T
                first += x.shape[1]
            states = inputs[:of_motion, :length].reshape(3, self.motion, length)
            inputs[first:, :length] = self.functions(*states)
            blocks = -(-length // _BLOCK)
            inputs[:, length : blocks * _BLOCK] = 0.0  # of weight zero
            library.grams(
                *map(_address, (inputs, packed, rows, memory, sums)), ctypes.c_long(blocks)
            )
        return self._unpacked(np.sum(sums, axis=-1))

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
    return None if c_library(kernel.source) is None else kernel


def host_kernel(network: CSLC) -> HostKernel:
    """The kernel of a network, whether it can be compiled or not."""
    motion, columns = weighted_columns(network)
    graph = motion.graph
    sizes = tuple(len(row) + 1 for row in network.support)
    functions = [
        index
        for index in graph.needed(column.value for column in columns)
        if graph.operations[index].name in _OF_NUMPY
    ]
    widths = {"q": motion.q, "qd": motion.qd, "qdd": motion.qdd, "torque": sizes, "weight": sizes}
    firsts = dict(zip(widths, np.cumsum([0, *map(len, widths.values())]).tolist(), strict=False))
    behind = sum(map(len, widths.values()))
    rows = {graph.operations[index]: behind + i for i, index in enumerate(functions)}

    def reading(operation: Operation) -> str | None:
        if operation.name == "input":
            quantity, index = operation.text.rstrip("]").split("[")
            return f"inputs[{_PIECE * (firsts[quantity] + int(index))} + i]"
        if operation.name in _OF_NUMPY:
            return f"inputs[{_PIECE * rows[operation]} + i]"
        return None

    lines = KernelText(graph, reading).statements(
        (column.value, f"columns[{_BLOCK * column.row} + i] = {{0}};") for column in columns
    )
    source = _KERNEL.format(
        block=_BLOCK,
        lanes=_LANES,
        statements="\n".join(lines),
        products="\n".join(_calls(sizes)),
        transformed=_BLOCK * sum(sizes),
    )
    program = Program.of(motion, [Value(graph, index) for index in functions])
    return HostKernel(source, program, sizes, len(motion.q))


def _calls(sizes: Sequence[int]) -> list[str]:
    """The products of each joint, from where its numbers are."""
    calls: list[str] = []
    packed = rows = tiles = 0
    for size in sizes:
        calls.append(
            f"products({size}, columns, inverses + {packed}, rows + {rows}, transformed,"
            f" sums + {tiles * _TILE * _TILE * _LANES});"
        )
        packed, rows, tiles = packed + _padded(size) * size, rows + size, tiles + _tiles(size)
    return calls


def _padded(size: int) -> int:
    return -(-size // _TILE) * _TILE


def _tiles(size: int) -> int:
    """Of a lower triangle."""
    high = -(-size // _TILE)
    return high * (high + 1) // 2


def _address(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.c_void_p)


_KERNEL = """#include <math.h>

#define BLOCK {block}
#define LANES {lanes}

typedef double real;
/* So many numbers as the widest registers hold; others are put together by the compiler. */
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));

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
        for (int start = 0; start < BLOCK; start += 4 * LANES) {{
            lanes y[4][4] = {{{{{{0}}}}}};
            for (int k = 0; k < last; ++k) {{
                const lanes* x = (const lanes*)(columns + BLOCK * rows[k] + start);
                const double* a = inverse + 4 * k;
                for (int r = 0; r < 4; ++r)
                    for (int c = 0; c < 4; ++c)
                        y[r][c] += a[r] * x[c];
            }}
            for (int r = 0; r < 4; ++r)
                for (int c = 0; c < 4; ++c)
                    *(lanes*)(transformed + BLOCK * (row + r) + start + LANES * c) = y[r][c];
        }}
        inverse += 4 * size;
    }}
    for (int row = 0; row < size; row += 4)
        for (int column = 0; column <= row; column += 4) {{
            lanes* sum = (lanes*)sums;
            lanes y[4][4];
            for (int r = 0; r < 4; ++r)
                for (int c = 0; c < 4; ++c)
                    y[r][c] = sum[4 * r + c];
            for (int start = 0; start < BLOCK; start += LANES)
                for (int r = 0; r < 4; ++r)
                    for (int c = 0; c < 4; ++c)
                        y[r][c] += *(const lanes*)(transformed + BLOCK * (row + r) + start)
                            * *(const lanes*)(transformed + BLOCK * (column + c) + start);
            for (int r = 0; r < 4; ++r)
                for (int c = 0; c < 4; ++c)
                    sum[4 * r + c] = y[r][c];
            sums += 16 * LANES;
        }}
}}

/* Adds the products of so many blocks of patterns. */
void grams(const double* inputs, const double* inverses, const int* rows, double* columns,
           double* sums, long blocks)
{{
    double* transformed = columns + {transformed};
    for (long block = 0; block < blocks; ++block) {{
        compute_columns(inputs + BLOCK * block, columns);
{products}
    }}
}}
"""

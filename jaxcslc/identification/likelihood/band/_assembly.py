import ctypes

import numpy as np
from jaxtyping import Float, Int

from ...._chunks import over_chunks
from ....network.straight_line import c_library
from ._columns import JointColumns
from ._source import SOURCE


# Equations whose products are in memory at a time, where there is no compiler.
_BLOCK = 256
# Equations that a thread adds.
_CHUNK = 4096


def add_equations(
    band: Float[np.ndarray, "inner diagonals"],
    mixed: Float[np.ndarray, "inner border"],
    position: Int[np.ndarray, "samples joints"],
    weight: Float[np.ndarray, "equations joints"],
    by_position: Float[np.ndarray, "equations joints positions"],
    by_border: JointColumns,
) -> None:
    """Adds the squares of equations of motion to normal equations, but for the border's own.

    **Arguments**

    - `band`: the lower band, a row for each of its columns, diagonal first; `mixed`: products of
      these unknowns and the border.
    - `position`: of each sample's positions among the unknowns, one after the other.
    - `weight`: of equations.
    - `by_position`: derivatives by the positions at three samples; `by_border`: by the border.
    """
    library = c_library(SOURCE)
    if library is None:
        _add_in_blocks(band, mixed, position, weight, by_position, by_border.dense)
        return
    count, n, stencil = by_position.shape
    long, columns = np.dtype(ctypes.c_long), mixed.shape[1]
    arrays = (
        np.ascontiguousarray(position[:, 0], long),
        *(np.ascontiguousarray(x, float) for x in (weight, by_position, by_border.values)),
        *(np.ascontiguousarray(x, long) for x in (by_border.joints, by_border.columns)),
        band,
        mixed,
    )
    addresses = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]
    sizes = (n, stencil // n, 0, band.shape[1], columns, len(by_border.joints))

    def add(first: int, last: int) -> None:
        memory = np.zeros((stencil + columns + 8) * n)
        integers = np.zeros((n + 1) * (columns // 2 + 1) + stencil, long)
        library.add_equations(
            *addresses,
            *(x.ctypes.data_as(ctypes.c_void_p) for x in (memory, integers)),
            *map(ctypes.c_long, (first, last, *sizes)),
        )

    # The last equations of a chunk have samples that the next chunk has, too: they follow alone.
    shared = stencil // n - 1
    over_chunks(lambda first, last: add(first, last - shared * (last < count)), count, _CHUNK)
    for last in range(_CHUNK, count, _CHUNK):
        add(last - shared, last)


def _add_in_blocks(
    band: Float[np.ndarray, "inner diagonals"],
    mixed: Float[np.ndarray, "inner border"],
    position: Int[np.ndarray, "samples joints"],
    weight: Float[np.ndarray, "equations joints"],
    by_position: Float[np.ndarray, "equations joints positions"],
    by_border: Float[np.ndarray, "equations joints border"],
) -> None:
    """The same by NumPy: products of all equations would be several times what is kept."""
    n = weight.shape[1]
    slots = by_position.shape[2] // n
    for start in range(0, len(weight), _BLOCK):
        rows = slice(start, start + _BLOCK)
        transposed = np.swapaxes(weight[rows, :, None] * by_position[rows], 1, 2)
        products, of_border = transposed @ by_position[rows], transposed @ by_border[rows]
        for slot in range(slots):
            samples = np.arange(start, start + len(products))
            blocks = slice(slot * n, (slot + 1) * n)
            mixed[position[samples + slot]] += of_border[:, blocks]
            for earlier in range(slot + 1):
                row, column = np.broadcast_arrays(
                    position[samples + slot][:, :, None], position[samples + earlier][:, None, :]
                )
                below = row >= column
                values = products[:, blocks, earlier * n : (earlier + 1) * n]
                band[column[below], (row - column)[below]] += values[below]

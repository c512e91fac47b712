import numpy as np
from jaxtyping import Float, Int

from ...._chunks import over_chunks
from ....codegen import INTEGERS, LONG, CArray, CFunction
from ._columns import JointColumns
from ._source import SOURCE


# Equations whose products are in memory at a time, where there is no compiler.
_BLOCK = 256
# Equations that a thread adds.
_CHUNK = 4096

_ADD = CFunction(
    SOURCE,
    "add_equations",
    (
        *(CArray("samples", INTEGERS), CArray("equations joints")),
        *(CArray("equations joints stencil"), CArray("equations entries")),
        *(CArray("entries", INTEGERS), CArray("entries", INTEGERS)),
        *(CArray("unknowns width", written=True), CArray("unknowns border", written=True)),
        *(CArray("numbers", written=True), CArray("integers", INTEGERS, written=True)),
        *[LONG] * 8,
    ),
)


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
    if not _ADD.is_available:
        _add_in_blocks(band, mixed, position, weight, by_position, by_border.dense)
        return
    count, n, stencil = by_position.shape
    columns = mixed.shape[1]
    of_border = by_border.values, by_border.joints, by_border.columns
    bound = _ADD.bound(position[:, 0], weight, by_position, *of_border, band, mixed)
    sizes = (n, stencil // n, 0, band.shape[1], columns, len(by_border.joints))

    def add(first: int, last: int) -> None:
        memory = np.zeros((stencil + columns + 8) * n)
        integers = np.zeros((n + 1) * (columns // 2 + 1) + stencil, INTEGERS)
        bound(memory, integers, first, last, *sizes)

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

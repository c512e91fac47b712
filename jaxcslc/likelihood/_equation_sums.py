"""Derivatives of equations without zeros, and their sums into the band and its border."""

import dataclasses
import itertools
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .._processes import over_chunks
from ..codegen import INTEGERS, LONG, CArray, CFunction
from ._banded_solver import SOURCE, add_blocks, gram


# Equations whose squares are added up at a time, and those that a thread multiplies.
_GRAM_ROWS, _SCALED_ROWS = 1024, 16_384


@dataclasses.dataclass(frozen=True)
class JointColumns:
    """Derivatives of equations by what all equations share, without zeros.

    Torque of a joint depends on links beyond it and on its own friction: of an arm with six joints,
    a third of all derivatives.

    **Attributes**

    - `values`: (equations, entries), those of the first joint, then of the second, and so on.
    - `joints`, `columns`: (entries,) joint and column of each.
    - `shape`: joints and columns.

    >>> import numpy as np
    >>> dense = np.array([[[1.0, 0.0, 2.0], [0.0, 0.0, 3.0]]])
    >>> columns = JointColumns.of(dense)
    >>> columns.values.tolist(), columns.joints.tolist(), columns.columns.tolist()
    ([[1.0, 2.0, 3.0]], [0, 0, 1], [0, 2, 2])
    >>> columns.times(np.array([1.0, 1.0, 10.0])).tolist()
    [[21.0, 30.0]]
    """

    values: Float[np.ndarray, "equations entries"]
    joints: Int[np.ndarray, " entries"]
    columns: Int[np.ndarray, " entries"]
    shape: tuple[int, int]

    @classmethod
    def of(cls, dense: Float[np.ndarray, "equations joints columns"]) -> "JointColumns":
        """Keep those that are not zero in all equations."""
        count, n, width = dense.shape
        joints, columns = np.nonzero(dense.any(axis=0))
        values = np.take(dense.reshape(count, -1), joints * width + columns, axis=1)
        return cls(values, joints, columns, (n, width))

    def widened(self, size: int) -> "JointColumns":
        """Add columns of zeros: so many in all."""
        return dataclasses.replace(self, shape=(self.shape[0], size))

    @property
    def patterns(self) -> Int[np.ndarray, " columns"]:
        """A number for each column, the same for columns of the same joints."""
        result = np.zeros((self.shape[1], self.shape[0]), int)
        result[self.columns, self.joints] = 1
        return np.unique(result, axis=0, return_inverse=True)[1].reshape(-1)

    @property
    def dense(self) -> Float[np.ndarray, "equations joints columns"]:
        """Dense array of the columns, zeros included."""
        result = np.zeros((len(self.values), *self.shape))
        result[:, self.joints, self.columns] = self.values
        return result

    def between(self, equations: slice) -> "JointColumns":
        """Return those of some equations."""
        return dataclasses.replace(self, values=self.values[equations])

    def times(self, vector: Float[np.ndarray, " columns"]) -> Float[np.ndarray, "equations joints"]:
        """Return products of rows and a vector."""
        result = np.empty((len(self.values), self.shape[0]))
        for joint, entries in enumerate(self._entries):
            result[:, joint] = self.values[:, entries] @ vector[self.columns[entries]]
        return result

    def summed(
        self, factors: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, " columns"]:
        """Return the sum of rows times factors."""
        result = np.zeros(self.shape[1])
        for joint, entries in enumerate(self._entries):
            result[self.columns[entries]] += factors[:, joint] @ self.values[:, entries]
        return result

    def square(
        self, weight: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, "columns columns"]:
        """Return the weighted sum of rows' squares; some equations at a time, for no copy of
        all."""
        result, root = np.zeros((self.shape[1],) * 2), np.sqrt(weight)
        for joint, entries in enumerate(self._entries):
            columns = self.columns[entries]
            total = np.zeros((len(columns),) * 2)
            for start in range(0, len(self.values) if len(columns) else 0, _GRAM_ROWS):
                rows = slice(start, start + _GRAM_ROWS)
                total += gram(root[rows, joint, None] * self.values[rows, entries])
            result[np.ix_(columns, columns)] += total
        return result

    def among(self, columns: Int[np.ndarray, " columns"]) -> "JointColumns":
        """Return some columns alone, in another order."""
        index = np.full(self.shape[1], -1)
        index[columns] = np.arange(len(columns))
        of_entry = index[self.columns]
        kept, shape = of_entry >= 0, (self.shape[0], len(columns))
        values = self.values if kept.all() else self.values[:, kept]
        return JointColumns(values, self.joints[kept], of_entry[kept], shape)

    def scaled(self, factors: Float[np.ndarray, " columns"]) -> "JointColumns":
        """Multiply columns by factors."""
        of_entry = factors[self.columns]
        values = np.empty(self.values.shape)

        def multiply(first: int, last: int) -> None:
            np.multiply(self.values[first:last], of_entry, out=values[first:last])

        over_chunks(multiply, len(values), _SCALED_ROWS)
        return dataclasses.replace(self, values=values)

    def rows(
        self, equations: Int[np.ndarray, " rows"], joints: Int[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "rows columns"]:
        """Return some rows with zeros."""
        result = np.zeros((len(equations), self.shape[1]))
        for joint, entries in enumerate(self._entries):
            of_joint = np.flatnonzero(joints == joint)
            some = self.values[equations[of_joint], entries]
            result[of_joint[:, None], self.columns[entries]] = some
        return result

    @cached_property
    def _entries(self) -> list[slice]:
        """Entries of each joint."""
        ends = np.searchsorted(self.joints, np.arange(self.shape[0] + 1)).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]


# Equations whose products are in memory at a time, where there is no compiler.
_BLOCK = 256
# Equations that a thread adds, and samples that they share with those of the next one.
_CHUNK, _SHARED = 4096, 2

_ADD = CFunction(
    SOURCE,
    "add_equations",
    (
        *(CArray("samples", INTEGERS), CArray("equations joints")),
        *(CArray("equations joints stencil"), CArray("equations entries")),
        *(CArray("entries", INTEGERS), CArray("entries", INTEGERS)),
        *(CArray("unknowns width", written=True), CArray("unknowns border", written=True)),
        *(CArray("numbers", written=True), CArray("integers", INTEGERS, written=True)),
        *[LONG] * 6,
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
    """Adds the squares of equations of motion to normal equations, except the border's own.

    - `band`: the lower band, a row for each of its columns, diagonal first; `mixed`: products of
      these unknowns and the border.
    - `position`: of each sample's positions among the unknowns, one after the other.
    - `weight`: of equations.
    - `by_position`: derivatives by the positions at three samples; `by_border`: by the border.
    """
    count, n, _ = by_position.shape
    if not _ADD.is_available:
        index = stencil(position)
        for start in range(0, count, _BLOCK):  # all products are several times what is kept
            rows = slice(start, start + _BLOCK)
            transposed = np.swapaxes(weight[rows, :, None] * by_position[rows], 1, 2)
            add_blocks(band, index[rows], transposed @ by_position[rows])
            np.add.at(mixed, index[rows], transposed @ by_border.between(rows).dense)
        return
    columns = mixed.shape[1]
    of_border = by_border.values, by_border.joints, by_border.columns
    bound = _ADD.bound(position[:, 0], weight, by_position, *of_border, band, mixed)
    sizes = (n, band.shape[1], columns, len(by_border.joints))

    def add(first: int, last: int) -> None:
        memory = np.zeros((3 * n + columns + 8) * n)
        integers = np.zeros((n + 1) * (columns // 2 + 1) + 3 * n, INTEGERS)
        bound(memory, integers, first, last, *sizes)

    # The last equations of a chunk have samples that the next chunk has, too: they follow alone.
    over_chunks(lambda first, last: add(first, last - _SHARED * (last < count)), count, _CHUNK)
    for last in range(_CHUNK, count, _CHUNK):
        add(last - _SHARED, last)


def stencil(
    values: Float[np.ndarray, "samples joints *shape"] | Int[np.ndarray, "samples joints"],
) -> Any:
    """Return values at the three samples of each equation, one after the other.

    >>> import numpy as np
    >>> stencil(np.arange(5)[:, None]).tolist()
    [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    """
    return np.concatenate([values[:-2], values[1:-1], values[2:]], axis=1)


ByPosition = Float[np.ndarray, "equations joints positions"]
Rows = Float[np.ndarray, "equations joints"]
Samples = Float[np.ndarray, "samples joints"]


def equation_changes(
    by_position: ByPosition,
    by_border: JointColumns,
    position: Samples,
    border: Float[np.ndarray, " border"],
) -> Rows:
    """Compute the changes of equations of motion: derivatives times changes of unknowns.

    - `by_position`: derivatives by the positions at three samples; `by_border`: by the border.
    - `position`, `border`: changes of these.

    >>> import numpy as np
    >>> by_position = np.array([[[1.0, 10.0, 100.0]], [[2.0, 20.0, 200.0]]])
    >>> by_border = JointColumns.of(np.array([[[1000.0]], [[2000.0]]]))
    >>> position = np.array([[1.0], [2.0], [3.0], [4.0]])
    >>> equation_changes(by_position, by_border, position, np.array([1.0])).tolist()
    [[1321.0], [2864.0]]
    """
    # C code takes 0.4 ms for 3,300 samples of a PUMA 560, this 0.7 ms.
    near = np.einsum("ejs,es->ej", by_position, stencil(position))
    return near + by_border.times(border)


def equation_gradients(
    by_position: ByPosition, by_border: JointColumns, force: Rows
) -> tuple[Samples, Float[np.ndarray, " border"]]:
    """Return the transpose: sums of equations' derivatives times `force`, by positions and by the
    border.

    >>> import numpy as np
    >>> by_position = np.array([[[1.0, 10.0, 100.0]], [[2.0, 20.0, 200.0]]])
    >>> by_border = JointColumns.of(np.array([[[1000.0]], [[2000.0]]]))
    >>> of_positions, of_border = equation_gradients(by_position, by_border, np.ones((2, 1)))
    >>> of_positions.ravel().tolist(), of_border.tolist()
    ([1.0, 12.0, 120.0, 200.0], [3000.0])
    """
    count, n, _ = by_position.shape
    of_positions = np.zeros((count + 2, n))
    of_equations = np.einsum("ej,ejs->es", force, by_position)
    for slot in range(3):
        of_positions[slot : slot + count] += of_equations[:, slot * n : (slot + 1) * n]
    return of_positions, by_border.summed(force)

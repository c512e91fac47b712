"""Derivatives by the border without their zeros."""

import dataclasses
import itertools
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from .._chunks import over_chunks
from ._normal_equations import gram


# Equations whose squares are added up at a time, and those that a thread multiplies.
_BLOCK, _CHUNK = 1024, 16_384


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
            for start in range(0, len(self.values) if len(columns) else 0, _BLOCK):
                rows = slice(start, start + _BLOCK)
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

        over_chunks(multiply, len(values), _CHUNK)
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

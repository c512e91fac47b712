"""Banded normal equations with a border, and their factorisation."""

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cholesky_banded
from scipy.linalg.blas import dsyrk

from ...._rank import rank_tolerance
from ._triangle import solved


@dataclasses.dataclass(frozen=True)
class Order:
    """Where positions and reversals are among the unknowns, in order of time.

    **Attributes**

    - `position`: (samples, n) index of each.
    - `turn`: (reversals,) index of each.
    - `size`: number of unknowns.

    >>> import numpy as np
    >>> order = Order.of(samples=3, joints=2, reversals=np.array([1]))
    >>> order.position.tolist(), order.turn.tolist(), order.size
    ([[0, 1], [2, 3], [5, 6]], [4], 7)
    """

    position: Int[np.ndarray, "samples joints"]
    turn: Int[np.ndarray, " reversals"]
    size: int

    @classmethod
    def of(cls, samples: int, joints: int, reversals: Int[np.ndarray, " reversals"]) -> "Order":
        """With each reversal after the positions of its sample."""
        counts = np.bincount(reversals, minlength=samples)
        before = np.concatenate([[0], np.cumsum(counts)[:-1]])
        position = (np.arange(samples) * joints + before)[:, None] + np.arange(joints)
        rank = np.empty(len(reversals), int)
        rank[np.argsort(reversals, kind="stable")] = np.arange(len(reversals))
        return cls(position, (reversals + 1) * joints + rank, samples * joints + len(reversals))


def gram(rows: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "columns columns"]:
    """Multiply the transpose by the matrix: half of the multiplications, for it is symmetric.

    >>> import numpy as np
    >>> gram(np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [[10.0, 14.0], [14.0, 20.0]]
    """
    # BLAS reads columns: C's rows are the columns of a transpose that costs nothing.
    upper = dsyrk(1.0, rows.T) if rows.flags.c_contiguous else dsyrk(1.0, rows, trans=1)
    return upper + np.triu(upper, 1).T


class BandedEquations:
    """Normal equations of unknowns in order of time, which are banded, and of some others.

    The others, the border, are in all equations. Memory and time are linear in the number of
    unknowns in order of time. Once factored, there is nothing left of them.

    **Attributes**

    - `band`: (inner, diagonals), for each unknown its products with itself and with those after it.
    - `mixed`: (inner, border), with the border; `border`: (border, border), of the border.
    """

    def __init__(self, inner: int, border: int, diagonals: int) -> None:
        # In LAPACK's order, a column of the band after the other.
        self.band = np.zeros((inner, diagonals))
        self.mixed = np.zeros((inner, border))
        self.border = np.zeros((border, border))

    def add(
        self,
        index: Int[np.ndarray, "blocks unknowns"],
        matrix: Float[np.ndarray, "blocks unknowns unknowns"],
    ) -> None:
        """Add symmetric blocks, each of some unknowns that are near in time."""
        row, column = np.tril_indices(index.shape[1])
        first, second = index[:, row], index[:, column]
        columns = np.minimum(first, second)
        below = np.maximum(first, second) - columns
        np.add.at(self.band, (columns, below), matrix[:, row, column])

    def factored(
        self, damping: Float[np.ndarray, " inner"], free: Int[np.ndarray, " free"], size: int
    ) -> "Factored":
        """Return the factorisation, with damping added to the diagonal of the banded part.

        **Arguments**

        - `free`: which unknowns of a larger border, of this `size`, these are; others are fixed.

        **Raises** `numpy.linalg.LinAlgError` if the banded part is not positive definite.
        """
        self.band[:, 0] += damping
        factor = cholesky_banded(self.band.T, lower=True, overwrite_ab=True, check_finite=False)
        return Factored(factor, self.mixed, self.border, free, size)


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """Which directions of unknowns an information matrix determines, by the rule of all fits.

    **Attributes**

    - `unit`: (size,) by which the matrix was scaled to a diagonal of ones; 1 for fixed unknowns.
    - `fixed`: (size,) unknowns without any information.
    - `values`, `vectors`: eigenvalues of the scaled matrix, ascending, and eigenvectors.
    - `counted`: (size,) eigenvalues that are more than rounding.
    """

    unit: Float[np.ndarray, " size"]
    fixed: Bool[np.ndarray, " size"]
    values: Float[np.ndarray, " size"]
    vectors: Float[np.ndarray, "size size"]
    counted: Bool[np.ndarray, " size"]

    @classmethod
    def of(cls, information: Float[np.ndarray, "size size"]) -> "Spectrum":
        """Of a matrix that is symmetric and positive semidefinite."""
        diagonal = np.diag(information)
        fixed = diagonal <= 0.0
        unit = np.sqrt(np.where(fixed, 1.0, diagonal))
        scaled = information / unit[:, None] / unit[None, :]
        scaled[fixed, fixed] = 1.0  # null vectors of the others are not to mix with these
        values, vectors = np.linalg.eigh(scaled)
        # Its entries are rounded, not their roots: the tolerance is of eigenvalues.
        tolerance = rank_tolerance(len(diagonal), np.float64(len(diagonal)))
        return cls(unit, fixed, values, vectors, values > tolerance * values[-1])

    @property
    def covariance(self) -> Float[np.ndarray, "size size"]:
        """The pseudo-inverse of the matrix."""
        half = self.vectors[:, self.counted] / np.sqrt(self.values[self.counted])
        half = np.where(self.fixed, 0.0, 1.0 / self.unit)[:, None] * half
        return half @ half.T

    @property
    def undetermined(self) -> Float[np.ndarray, "null size"]:
        """Unit vectors of the scaled unknowns that nothing is known of; none of fixed ones."""
        return self.vectors[:, ~self.counted].T


class Factored:
    """Factorised normal equations.

    **Attributes**

    - `information`: (border, border) of the border, when all else is eliminated; 0 of fixed
      unknowns.
    """

    def __init__(
        self,
        factor: Float[np.ndarray, "diagonals inner"],
        mixed: Float[np.ndarray, "inner free"],
        border: Float[np.ndarray, "free free"],
        free: Int[np.ndarray, " free"],
        size: int,
    ) -> None:
        self._factor, self._free = factor, free
        # Half of a solution: a step needs the other half of one column alone.
        self._half = solved(factor, mixed, overwrite=True)
        self._diagonal = np.diag(border)
        self._eigenvectors: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self.information = np.zeros((size, size))
        self._of_free = border - gram(self._half)
        self.information[np.ix_(free, free)] = self._of_free

    @cached_property
    def eliminated(self) -> Float[np.ndarray, "inner border"]:
        """Minus the reply of unknowns in order of time to the border."""
        result = np.zeros((len(self._half), len(self.information)))
        result[:, self._free] = solved(self._factor, self._half, transposed=True)
        return result

    def step(
        self,
        inner: Float[np.ndarray, "inner sides"],
        border: Float[np.ndarray, "border sides"],
        damping: float,
    ) -> tuple[Float[np.ndarray, "inner sides"], Float[np.ndarray, "border sides"]]:
        """Return the unknowns for right sides, of which long matrices are read once for all.

        **Arguments**

        - `inner`, `border`: the right sides.
        - `damping`: of the border, as a part of its information.
        """
        half = solved(self._factor, inner)
        right_side = border[self._free] - self._half.T @ half
        change = self._border(right_side, damping)
        half -= self._half @ change
        of_border = np.zeros_like(border)
        of_border[self._free] = change
        return solved(self._factor, half, transposed=True, overwrite=True), of_border

    def _border(
        self, right_side: Float[np.ndarray, "free sides"], damping: float
    ) -> Float[np.ndarray, "free sides"]:
        """Return the solution for the border, of least length; its eigenvectors stay for the next
        one."""
        if damping not in self._eigenvectors:
            floor = 1e-14 * self._diagonal
            matrix = self._of_free + np.diag(damping * np.diag(self._of_free) + floor)
            values, vectors = np.linalg.eigh(matrix)
            counted = np.abs(values) > 1e-15 * np.abs(values).max(initial=0.0)
            self._eigenvectors[damping] = values[counted], vectors[:, counted]
        values, vectors = self._eigenvectors[damping]
        return vectors @ ((vectors.T @ right_side) / values[:, None])

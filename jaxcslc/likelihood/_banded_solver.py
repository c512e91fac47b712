"""Banded normal equations with a border: C code, factorisation and solution, for any sizes."""

import dataclasses
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cholesky_banded
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dtbtrs

from .._processes import over_chunks
from .._rank import rank_tolerance
from ..codegen import LANES_TEXT, LONG, CArray, CFunction


SOURCE = (
    LANES_TEXT
    + """typedef double four __attribute__((vector_size(32), aligned(8)));
typedef double two __attribute__((vector_size(16), aligned(8)));

/* Rows minus factors times rows so many apart: a part of their columns that registers hold. */
#define ELIMINATED(type, parts)                                                                  \\
    {                                                                                            \\
        type sum[parts];                                                                         \\
        for (int c = 0; c < parts; ++c)                                                          \\
            sum[c] = ((type*)row)[c];                                                            \\
        for (long d = 1; d <= most; ++d) {                                                       \\
            const double x = factor[d * step];                                                   \\
            const type* const other = (const type*)(row + d * apart);                            \\
            for (int c = 0; c < parts; ++c)                                                      \\
                sum[c] -= x * other[c];                                                          \\
        }                                                                                        \\
        for (int c = 0; c < parts; ++c)                                                          \\
            ((type*)row)[c] = sum[c] * inverse;                                                  \\
        row += parts * sizeof(type) / sizeof(double);                                            \\
        left -= parts * sizeof(type) / sizeof(double);                                           \\
    }

/* A row of the right side; `step` between the factors of rows `apart`. */
static void eliminate(
    const double* factor, long step, double inverse, double* row, long apart, long most, long left)
{
    while (left >= 4 * LANES)
        ELIMINATED(lanes, 4)
    while (left >= LANES)
        ELIMINATED(lanes, 1)
    while (left)
        ELIMINATED(double, 1)
}

/* Solves with the triangle of a banded factorisation, diagonals first, a column after the other;
   or with its transpose. Columns from `first` to before `last` of (size, columns), in place. */
void solve(
    const double* factor, double* right, long size, long width, long columns, long transposed,
    long first, long last)
{
    for (long n = 0; n < size; ++n) {
        const long i = transposed ? size - 1 - n : n;
        const long most = n < width - 1 ? n : width - 1;
        const double* const diagonal = factor + i * width;
        double* const row = right + i * columns + first;
        if (transposed)
            eliminate(diagonal, 1, 1.0 / *diagonal, row, columns, most, last - first);
        else
            eliminate(diagonal, 1 - width, 1.0 / *diagonal, row, -columns, most, last - first);
    }
}

/* Adds a sum of products to so many numbers in a row: `count` factors, `step` apart, times rows
   `apart`, a part of their columns that a register holds. */
#define SUMMED(type)                                                                             \\
    {                                                                                            \\
        type sum = *(type*)to;                                                                   \\
        for (long i = 0; i < count; ++i)                                                         \\
            sum += factors[i * step] * *(const type*)(rows + i * apart);                         \\
        *(type*)to = sum;                                                                        \\
        to += sizeof(type) / sizeof(double);                                                     \\
        rows += sizeof(type) / sizeof(double);                                                   \\
        left -= sizeof(type) / sizeof(double);                                                   \\
    }

static inline void add_sum(
    double* to, const double* factors, long step, const double* rows, long apart, long count,
    long left)
{
    while (left >= LANES)
        SUMMED(lanes)
#if LANES > 4
    if (left >= 4)
        SUMMED(four)
#endif
    if (LANES > 2 && left >= 2)
        SUMMED(two)
    while (left)
        SUMMED(double)
}

/* Adds products to so many rows: of a register of the border's columns, those of so many joints
   that are not 0 there. `factors` and `rows` joint by joint. */
#define ADDED(type, joints, ...)                                                                 \\
    {                                                                                            \\
        const long each[joints] = { __VA_ARGS__ };                                               \\
        type x[joints];                                                                          \\
        const double* of[joints];                                                                \\
        for (int i = 0; i < joints; ++i) {                                                       \\
            x[i] = *(const type*)(rows + each[i] * padded + at);                                 \\
            of[i] = factors + each[i] * stencil;                                                 \\
        }                                                                                        \\
        for (long r = 0; r < stencil; ++r) {                                                     \\
            type sum = *(type*)(mixed + targets[r] + at);                                        \\
            for (int i = 0; i < joints; ++i)                                                     \\
                sum += of[i][r] * x[i];                                                          \\
            *(type*)(mixed + targets[r] + at) = sum;                                             \\
        }                                                                                        \\
    }

/* Those of up to three joints at a time. */
#define ALL_ADDED(type)                                                                          \\
    for (long i = from; i < to; i += 3)                                                          \\
        if (to - i == 1)                                                                         \\
            ADDED(type, 1, active[i])                                                            \\
        else if (to - i == 2)                                                                    \\
            ADDED(type, 2, active[i], active[i + 1])                                             \\
        else                                                                                     \\
            ADDED(type, 3, active[i], active[i + 1], active[i + 2])

/* Adds the squares of the equations from `begin` to before `end`, n each, of positions at three
   samples, the first of which has the equations' number.

   - firsts: where the n positions of each sample are in the band.
   - weight: (count, n); by_position: (count, n, 3 n).
   - values: (count, entries) derivatives by the border that are not 0, of `joints` and `indices`.
   - band: (size, width), diagonals first, a column after the other; mixed: (size, columns).
   - memory: (3 n + columns + 8) n numbers; integers: (n + 1) (columns / 2 + 1) + 3 n, all 0. */
void add_equations(
    const long* firsts, const double* weight, const double* by_position, const double* values,
    const long* joints, const long* indices, double* band, double* mixed, double* memory,
    long* integers, long begin, long end, long n, long width, long columns, long entries)
{
    const long stencil = 3 * n, parts = columns / LANES + 1, padded = parts * LANES;
    double* const factors = memory;
    double* const rows = factors + stencil * n;
    long* const ends = integers;
    long* const active = ends + parts;
    long* const targets = active + parts * n;
    long number = 0;
    for (long c = 0; c < parts; ++c) {
        for (long j = 0; j < n; ++j) {
            long some = 0;
            for (long i = 0; i < entries; ++i)
                some |= joints[i] == j && indices[i] / LANES == c;
            if (some)
                active[number++] = j;
        }
        ends[c] = number;
    }
    for (long e = begin; e < end; ++e) {
        const double* const a = by_position + e * n * stencil;
        for (long i = 0; i < entries; ++i)
            rows[joints[i] * padded + indices[i]] = values[e * entries + i];
        for (long j = 0; j < n; ++j)
            for (long r = 0; r < stencil; ++r)
                factors[j * stencil + r] = weight[e * n + j] * a[j * stencil + r];
        for (long slot = 0; slot < 3; ++slot)
            for (long m = 0; m < n; ++m) {
                const long r = slot * n + m, column = firsts[e + slot] + m;
                targets[r] = column * columns;
                /* Rows of the band one after the other, except unknowns that are no positions. */
                for (long from = r, to; from < stencil; from = to) {
                    const long row = firsts[e + from / n] + from % n;
                    to = (from / n + 1) * n;
                    while (to < stencil && firsts[e + to / n] == row + to - from)
                        to += n;
                    add_sum(band + column * width + row - column, factors + r, stencil, a + from,
                            stencil, n, to - from);
                }
            }
        for (long c = 0; c < parts; ++c) {
            const long from = c ? ends[c - 1] : 0, to = ends[c];
            if (c < parts - 1) {
                const long at = c * LANES;
                ALL_ADDED(lanes)
            } else
                for (long at = c * LANES; at < columns; ++at)
                    ALL_ADDED(double)
        }
    }
}
"""
)


# Columns that a thread solves for: all of them read the whole factor. LAPACK is as quick with few.
_COLUMNS, _FEW_COLUMNS = 32, 8
# Unknowns from which on threads are worth their start.
_LONG = 20_000

_SOLVE = CFunction(
    SOURCE, "solve", (CArray("size width"), CArray("size columns", written=True), *[LONG] * 6)
)


def solved(
    factor: Float[np.ndarray, "diagonals inner"],
    right: Float[np.ndarray, "inner columns"],
    *,
    transposed: bool = False,
    overwrite: bool = False,
) -> Float[np.ndarray, "inner columns"]:
    """Return the solution for the triangle of a banded factorisation, or for its transpose.

    LAPACK's routine solves column by column, each with one vector product a row: for the sixty
    columns of an arm's border, 19 unknowns apart at most, C code that takes all columns of a row at
    a time needs a fifth of the time.

    - `factor`: lower, as of `scipy.linalg.cholesky_banded`.
    - `right`: stays as it is, unless it is one to `overwrite`.

    >>> import numpy as np
    >>> factor = np.asfortranarray([[2.0, 1.0], [3.0, 0.0]])  # ((2, 0), (3, 1))
    >>> solved(factor, np.array([[4.0], [7.0]])).tolist()
    [[2.0], [1.0]]
    """
    if right.shape[1] < _FEW_COLUMNS or not _SOLVE.is_available:
        return dtbtrs(factor, right, uplo="L", trans="T" if transposed else "N")[0]
    columns = np.ascontiguousarray(factor.T)
    whole = overwrite and right.flags.c_contiguous
    result = right if whole else np.array(right, float, order="C")
    sizes = (*result.shape[:1], columns.shape[1], result.shape[1], int(transposed))
    solve = _SOLVE.bound(columns, result, *sizes)
    over_chunks(solve, result.shape[1], _COLUMNS if len(result) >= _LONG else result.shape[1])
    return result


@dataclasses.dataclass(frozen=True)
class Order:
    """Indices of positions and reversals among the unknowns, in order of time.

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
        """Return the order with each reversal after the positions of its sample."""
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


def add_blocks(
    band: Float[np.ndarray, "inner diagonals"],
    index: Int[np.ndarray, "blocks unknowns"],
    matrix: Float[np.ndarray, "blocks unknowns unknowns"],
) -> None:
    """Add symmetric blocks, each of some unknowns, to a band as of `BandedEquations`."""
    row, column = np.tril_indices(index.shape[1])
    first, second = index[:, row], index[:, column]
    columns = np.minimum(first, second)
    np.add.at(band, (columns, np.maximum(first, second) - columns), matrix[:, row, column])


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
        add_blocks(self.band, index, matrix)

    def factored(
        self, damping: Float[np.ndarray, " inner"], free: Int[np.ndarray, " free"], size: int
    ) -> "Factored":
        """Return the factorisation, with damping added to the diagonal of the banded part.

        - `free`: which unknowns of a larger border, of this `size`, these are; others are fixed.

        **Raises** `numpy.linalg.LinAlgError` if the banded part is not positive definite.
        """
        self.band[:, 0] += damping
        factor = cholesky_banded(self.band.T, lower=True, overwrite_ab=True, check_finite=False)
        return Factored(factor, self.mixed, self.border, free, size)


@dataclasses.dataclass(frozen=True)
class Spectrum:
    """Spectrum of an information matrix, and the directions of unknowns that it determines.

    The rule is that of all fits.

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
        """Compute the spectrum of a matrix that is symmetric and positive semidefinite."""
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

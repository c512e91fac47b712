from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from .._factors import triangle_of


# Squares of pivots of a sample's columns of unit length below which products do not resolve them.
_LEAST_SQUARE = 1e-13
# Added below a sample's rows, in lengths of their columns: directions that the sample lacks stay
# finite, and are resolved to 1e-8 of 1e-8.
_SHIFT = 1e-8
# What rounding of the products may change, in units of rounding and lengths of columns. Householder
# reflections change about ten.
LARGEST_ERROR = 100.0
# Columns behind a preconditioner count as zero up to this, in the same units.
_NEGLIGIBLE = 50.0


class Preconditioner(NamedTuple):
    """What makes regressor rows nearly orthonormal, for each joint.

    A pivoted factor R of a sample of rows: with pivots, rows of R are graded and the errors of a
    product with the inverse as small as those of substitution, at the speed of matrix products.

    **Attributes**

    - `inverses`: (s + 1, s + 1), what rows are multiplied by; the torque is a column like others.
    - `factors`: (s + 1, s + 1), their inverses.
    """

    inverses: tuple[Float[np.ndarray, "_ _"], ...]
    factors: tuple[Float[np.ndarray, "_ _"], ...]

    @classmethod
    def of_rows(cls, rows: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Of some rows of each joint, or of a triangle of them; columns of zeros are allowed."""
        pairs = [_inverse_and_factor(np.asarray(joint_rows)) for joint_rows in rows]
        inverses, factors = zip(*pairs, strict=True)
        return cls(inverses, factors)

    @classmethod
    def of_products(cls, grams: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Of the products of some rows of each joint.

        Rows are resolved to 1e-7 of their columns' lengths, which serves as well as 1e-16 with
        condition numbers up to that, and what lies beyond takes a second pass. Decomposing tens of
        columns takes a tenth of the time of thousands of rows, for which a GPU waits.
        """
        inverses, factors = zip(*map(_inverse_and_factor_of_product, grams), strict=True)
        return cls(inverses, factors)


def _inverse_and_factor(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lengths = np.linalg.norm(rows, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    size = rows.shape[1]
    shifted = np.concatenate([rows / lengths, _SHIFT * np.eye(size)])
    triangle, order = scipy.linalg.qr(shifted, mode="r", pivoting=True, check_finite=False)
    triangle = triangle[:size]
    inverse, factor = np.empty((2, size, size))
    inverse[order] = scipy.linalg.solve_triangular(triangle, np.eye(size), check_finite=False)
    factor[:, order] = triangle
    return inverse / lengths[:, None], factor * lengths


def _inverse_and_factor_of_product(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = len(gram)
    if not np.all(np.isfinite(gram)):
        return np.eye(size), np.eye(size)
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    normalized = gram / lengths[:, None] / lengths
    triangle, pivots, rank, _ = scipy.linalg.lapack.dpstrf(normalized, tol=_LEAST_SQUARE)
    order, triangle = pivots - 1, np.triu(triangle)
    # Not shifted as a whole: what depends on other columns is to vanish up to rounding.
    triangle[rank:] = np.sqrt(_LEAST_SQUARE) * np.eye(size)[rank:]
    inverse, factor = np.empty((2, size, size))
    inverse[order] = scipy.linalg.lapack.dtrtri(triangle)[0]
    factor[:, order] = triangle
    return inverse / lengths[:, None], factor * lengths


def triangles_of(
    preconditioner: Preconditioner, grams: Sequence[Float[np.ndarray, "_ _"]]
) -> tuple[tuple[Float[np.ndarray, "_ _"], ...], Float[np.ndarray, " joints"]]:
    """The triangles of rows whose products behind a preconditioner are `grams`.

    **Returns** the triangles, and for each joint a bound of their error: of the change of the
    rows, by columns, that would explain it, in units of rounding and of the columns' lengths.
    """
    pairs = [
        _triangle_and_error(factor, gram)
        for factor, gram in zip(preconditioner.factors, grams, strict=True)
    ]
    triangles, errors = zip(*pairs, strict=True)
    return triangles, np.array(errors)


def add_up(preconditioner: Preconditioner, grams: Sequence[Float[np.ndarray, "_ _"]]) -> bool:
    """Whether the triangles of such products have small errors, those of sums of them, too.

    With all eigenvalues of a Gram matrix of s columns of unit length above a, the bound of
    `triangles_of` is sqrt(s) / a at most; and those of a sum are above the least of its parts. One
    decomposition tells, where the bound and the triangles take a hundred small operations.
    """
    for factor, gram in zip(preconditioner.factors, grams, strict=True):
        if not np.all(np.isfinite(gram)):
            return False
        shifted, _ = _normalized(factor, gram)
        shifted.ravel()[:: len(gram) + 1] -= np.sqrt(len(gram)) / LARGEST_ERROR
        if scipy.linalg.lapack.dpotrf(shifted, lower=1)[1]:
            return False
    return True


def _normalized(factor: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A Gram matrix of columns of unit length, since a factor's errors do not depend on their
    scale; and the rows of the preconditioner's factor times the lengths."""
    lengths = np.sqrt(np.diag(gram))
    divisor = np.where(lengths > 0.0, lengths, 1.0)
    normalized, directions = gram / divisor[:, None] / divisor, lengths[:, None] * factor
    # What depends on other columns is left as rounding, in any direction: none of its own.
    columns = np.sqrt(np.maximum(np.sum(directions * (normalized @ directions), axis=0), 0.0))
    negligible = np.all(np.abs(directions) <= _NEGLIGIBLE * np.finfo(float).eps * columns, axis=1)
    if np.any(negligible):
        directions[negligible] = normalized[negligible] = normalized[:, negligible] = 0.0
        normalized[negligible, negligible] = 1.0
    return normalized, directions


def _triangle_and_error(factor: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, float]:
    if not np.all(np.isfinite(gram)):
        return np.full_like(gram, np.nan), np.nan
    normalized, directions = _normalized(factor, gram)
    triangle, singular = scipy.linalg.lapack.dpotrf(normalized, lower=1)
    if not singular:
        # Rounding of the products changes the factor by no more than its inverse's norm.
        half = triangle.T @ directions
        change = np.linalg.norm(scipy.linalg.lapack.dtrtri(triangle, lower=1)[0])
        columns = np.linalg.norm(half, axis=0)
        columns = np.where(columns > 0.0, columns, 1.0)
        error = change * np.max(np.linalg.norm(directions, axis=0) / columns)
        if error < LARGEST_ERROR:
            return triangle_of(half), float(error)
    values, vectors = np.linalg.eigh(normalized)
    roots = np.sqrt(np.maximum(values, 0.0))
    directions = vectors.T @ directions
    half = roots[:, None] * directions
    # Rounding of the products changes a root by this, and the columns by its part of directions.
    unit = np.finfo(float).eps
    changes = np.minimum(unit / np.maximum(roots, unit), np.sqrt(unit))
    columns = np.linalg.norm(half, axis=0)
    changed = np.linalg.norm(changes[:, None] * directions, axis=0)
    error = np.max(changed / np.where(columns > 0.0, columns, 1.0)) / unit
    return triangle_of(half), float(error)

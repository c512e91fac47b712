"""Rank, pseudo-inverse and null vectors of matrices, by one tolerance for all least-squares fits.

Columns are scaled to unit length first, so that no result depends on units.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from ._environment import array_namespace


# Rounding of a factorisation grows with its size; the factor 10 is a heuristic that keeps columns
# that are proportional in exact arithmetic from counting as two.
_ROUNDINGS = 10.0


def rank_tolerance(columns: int, rows: Any, rcond: float | None = None) -> Any:
    """The part of the largest singular value up to which others count as zero.

    For matrices with columns of unit length, so that neither rank nor condition depends on units.
    """
    if rcond is not None:
        return rcond
    return (
        _ROUNDINGS * float(np.finfo(float).eps) * array_namespace(rows).maximum(columns, rows**0.5)
    )


def numerical_rank(matrix: Float[np.ndarray, "rows columns"]) -> int:
    """The rank of a matrix by the rule of all least-squares fits.

    >>> import numpy as np
    >>> matrix = np.array([[1.0, 2e9], [3.0, 6e9], [5.0, 1e10]])  # proportional, in other units
    >>> numerical_rank(matrix), numerical_rank(matrix + np.diag([1.0, 1e9], 0)[[0, 1, 1]])
    (1, 2)
    """
    return len(_decomposed(matrix, None)[1])


def pseudo_inverse(
    matrix: Float[np.ndarray, "rows columns"], rcond: float | None = None
) -> Float[np.ndarray, "columns rows"]:
    """The least-squares inverse of a matrix, its rank by the rule of all fits.

    >>> import numpy as np
    >>> matrix = np.array([[1.0, 2e9], [3.0, 6e9]])  # of rank one
    >>> (pseudo_inverse(matrix) @ matrix[:, 0]).round(9).tolist()
    [0.5, 0.0]
    """
    left, singular, right, lengths = _decomposed(matrix, rcond)
    return (right.T[:, : len(singular)] / singular) @ left.T / lengths[:, None]


def null_vectors(
    matrix: Float[np.ndarray, "rows columns"], rcond: float | None = None
) -> Float[np.ndarray, "null columns"]:
    """Rows that the matrix maps to zero, by the same rule: all that it leaves open.

    >>> import numpy as np
    >>> null_vectors(np.array([[1.0, 2e9], [3.0, 6e9]])).shape
    (1, 2)
    """
    _, singular, right, lengths = _decomposed(matrix, rcond)
    return right[len(singular) :] / lengths


def _decomposed(
    matrix: Float[np.ndarray, "rows columns"], rcond: float | None
) -> tuple[
    Float[np.ndarray, "rows rank"],
    Float[np.ndarray, " rank"],
    Float[np.ndarray, "columns columns"],
    Float[np.ndarray, " columns"],
]:
    """Singular value decomposition of the matrix with columns of unit length, and the lengths."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    rows, columns = matrix.shape
    left, singular, right = np.linalg.svd(matrix / lengths, full_matrices=rows < columns)
    tolerance = rank_tolerance(columns, np.float64(max(rows, 1)), rcond)
    rank = int(np.sum(singular > tolerance * singular[0])) if singular.size else 0
    return left[:, :rank], singular[:rank], right, lengths

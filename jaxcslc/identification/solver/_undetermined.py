from collections.abc import Sequence

import numpy as np
import scipy
from jaxtyping import Float


# Entries of the echelon form below this part of a row's largest are rounding.
_NEGLIGIBLE = 1e-6


def describe(
    null_space: Float[np.ndarray, "rows coefficients"], names: Sequence[str]
) -> tuple[str, ...]:
    """What a null space means for named coefficients, one sentence a group.

    Coefficients that share a null vector form a group. Of a group of m coefficients with d null
    vectors, m - d combinations are still determined; the reduced echelon form of what is
    orthogonal to the null vectors names them.

    >>> import numpy as np
    >>> describe(np.array([[1.0, -2.0, 0.0], [0.0, 0.0, 0.0]]), ("a", "b", "c"))
    ('a, b: only the combination a + 0.5*b is determined',)
    """
    rows = null_space[np.linalg.norm(null_space, axis=1) > 0]
    if not rows.size:
        return ()
    echelon = _reduced_echelon(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    involved = np.abs(echelon) > _NEGLIGIBLE
    groups: list[set[int]] = []
    for row in involved:
        group = set(np.flatnonzero(row).tolist())
        for other in [other for other in groups if other & group]:
            groups.remove(other)
            group |= other
        groups.append(group)
    return tuple(_sentence(sorted(group), echelon, names) for group in sorted(groups, key=min))


def _sentence(group: list[int], echelon: np.ndarray, names: Sequence[str]) -> str:
    listed = ", ".join(names[i] for i in group)
    rows = echelon[:, group]
    rows = rows[np.linalg.norm(rows, axis=1) > _NEGLIGIBLE]
    determined = scipy.linalg.null_space(rows).T
    if not determined.size:
        return f"{listed}: nothing in the patterns depends on {'it' if len(group) == 1 else 'them'}"
    combinations = [
        _combination(row, [names[i] for i in group]) for row in _reduced_echelon(determined)
    ]
    several = len(combinations) > 1
    return (
        f"{listed}: only the combination{'s' if several else ''} {', '.join(combinations)}"
        f" {'are' if several else 'is'} determined"
    )


def _combination(row: np.ndarray, names: Sequence[str]) -> str:
    text = ""
    for value, name in zip(row, names, strict=True):
        if abs(value) > _NEGLIGIBLE:
            number = "" if np.isclose(abs(value), 1.0) else f"{abs(value):.6g}*"
            sign = "-" if value < 0 else "+"
            text += (
                f" {sign} {number}{name}" if text else f"{'-' if value < 0 else ''}{number}{name}"
            )
    return text


def _reduced_echelon(rows: np.ndarray) -> np.ndarray:
    """Gauss-Jordan with the largest pivot of each column; rounding is set to zero."""
    matrix = rows.copy()
    lead = 0
    for column in range(matrix.shape[1]):
        if lead == len(matrix):
            break
        pivot = lead + int(np.argmax(np.abs(matrix[lead:, column])))
        if abs(matrix[pivot, column]) <= _NEGLIGIBLE * max(np.abs(matrix).max(), 1e-300):
            matrix[lead:, column] = 0.0
            continue
        matrix[[lead, pivot]] = matrix[[pivot, lead]]
        matrix[lead] /= matrix[lead, column]
        for other in range(len(matrix)):
            if other != lead:
                matrix[other] -= matrix[other, column] * matrix[lead]
        lead += 1
    return matrix[:lead]

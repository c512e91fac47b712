"""Least squares within bounds, by steps of Levenberg and Marquardt on the free coordinates."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


Vector = Float[np.ndarray, " unknowns"]

# Damping, added to the diagonal of the normal equations: at first, and its least.
_DAMPING, _LEAST_DAMPING = 1e-3, 1e-12
# A step that keeps less or more than these parts of what it promised changes the damping.
_POOR, _GOOD = 0.25, 0.75
_GROWTH, _DECAY = 2.0, 5.0


class BoundedMinimum(NamedTuple):
    """Minimum of a sum of squares within bounds.

    **Attributes**

    - `x`: unknowns, none below its bound.
    - `value`: sum of squares there.
    - `converged`: whether the search ended by its tolerance.
    """

    x: Vector
    value: float
    converged: bool


def bounded_least_squares(
    residual: Callable[[Vector], Float[np.ndarray, " rows"]],
    jacobian: Callable[[Vector], Float[np.ndarray, "rows unknowns"]],
    start: Vector,
    low: Vector,
    *,
    tolerance: float,
    evaluations: int,
) -> BoundedMinimum:
    """Minimise |residual(x)|² within x ≥ low: Levenberg and Marquardt's method with an active set.

    Unknowns at their bound whose gradient points outwards stay there; others that a step would
    carry beyond theirs stop at it, and the step is computed anew for those that remain. What
    `scipy.optimize.least_squares` finds from within the bounds, whose import takes as long as five
    searches, and each of whose steps takes a singular value decomposition. (Marquardt 1963.)

    **Arguments**

    - `jacobian`: of full rank; unknowns are of order one.
    - `low`: lower bounds, -inf without one.
    - `tolerance`: the search ends where a step promises less than this part of the value, or moves
      the unknowns by less than this part of their length.
    - `evaluations`: of the residual, at most.

    **Returns** the minimum.

    >>> import numpy as np
    >>> a, b = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([1.0, -1.0])
    >>> minimum = bounded_least_squares(
    ...     lambda x: a @ x - b, lambda x: a, np.ones(2), np.zeros(2),
    ...     tolerance=1e-10, evaluations=100,
    ... )
    >>> minimum.x.round(9).tolist(), minimum.converged
    ([1.0, 0.0], True)
    """
    x = np.maximum(start, low)
    errors = residual(x)
    value, damping = float(errors @ errors), _DAMPING
    columns = jacobian(x)
    for _ in range(evaluations - 1):
        gradient, normal = columns.T @ errors, columns.T @ columns
        at_bound = (x <= low) & (gradient >= 0.0)
        damped = normal + damping * np.eye(len(x))
        step = _step(damped, gradient, low - x, at_bound)
        promise = -float(step @ (2.0 * gradient + normal @ step))
        if promise <= tolerance * value and damping <= _DAMPING:
            return BoundedMinimum(x, value, True)
        if np.linalg.norm(step) <= tolerance * (tolerance + np.linalg.norm(x)):
            return BoundedMinimum(x, value, True)
        moved = np.maximum(x + step, low)
        errors_there = residual(moved)
        value_there = float(errors_there @ errors_there)
        part = (value - value_there) / promise if promise > 0.0 else 0.0
        if not part >= _POOR:
            damping *= _GROWTH
        elif part > _GOOD:
            damping = max(damping / _DECAY, _LEAST_DAMPING)
        if value_there < value:
            x, errors, value = moved, errors_there, value_there
            columns = jacobian(x)
    return BoundedMinimum(x, value, False)


def _step(
    matrix: Float[np.ndarray, "unknowns unknowns"],
    gradient: Vector,
    least: Vector,
    at_bound: Bool[np.ndarray, " unknowns"],
) -> Vector:
    """The step that solves the damped normal equations and is nowhere less than `least`."""
    step, free = np.zeros(len(gradient)), ~at_bound
    while np.any(free):
        inner = np.ix_(free, free)
        target = gradient[free] + matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(matrix[inner], target)
        beyond = free & (step < least)
        if not np.any(beyond):
            break
        step[beyond] = least[beyond]
        free &= ~beyond
    return step

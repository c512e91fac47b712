import warnings
from typing import Any

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._rank import numerical_rank


_UPPER = [(a, b) for a in range(4) for b in range(a, 4)]


def semidefinite_least_squares(
    matrix: Float[np.ndarray, "rows unknowns"],
    target: Float[np.ndarray, " rows"],
    rows: Float[np.ndarray, "constraints unknowns"],
    values: Float[np.ndarray, " constraints"],
    *,
    bodies: int,
    bounded: Float[np.ndarray, " others"],
    least: float,
    above: Float[np.ndarray, "bounds unknowns"] | None = None,
    limits: Float[np.ndarray, " bounds"] | None = None,
) -> tuple[Float[np.ndarray, " unknowns"] | None, bool]:
    """min |matrix x - target|² with x = (X₁, …, Xₘ, y), rows @ x = values, every Xᵢ (4, 4)
    symmetric with eigenvalues ≥ least, y ≥ 0 where `bounded` is not zero, above @ x ≥ limits.

    Where no inequality is active, the optimum is that of a least-squares problem: that is tried
    first, for it is exact where a conic solver is good to some eight digits.

    **Returns**

    - The optimum, or None if the solver fails.
    - Whether the solver says that it is one.

    **Raises**

    - `ImportError`: an inequality is active, and no conic solver is installed.
    """
    from scipy.linalg import solve_triangular

    origin, span = _solutions(rows @ (expand := _expansion(bodies, len(bounded))), values)
    origin, span = expand @ origin, expand @ span
    stacked = np.concatenate([matrix @ span, (target - matrix @ origin)[:, None]], axis=1)
    triangle: Any = np.linalg.qr(stacked, mode="r")  # says all that the equations say
    size = span.shape[1]
    inverse = solve_triangular(triangle[:size, :size], np.eye(size))
    free = origin + span @ (inverse @ triangle[:size, size])
    lowest = np.min(np.linalg.eigvalsh(free[: 16 * bodies].reshape(-1, 4, 4)))
    within = above is None or limits is None or bool(np.all(above @ free >= limits))
    if lowest >= least and np.all(free[16 * bodies :][bounded > 0] >= 0) and within:
        return free, True

    cp = _conic_solver()
    # From there, in steps that cost alike: what the data fix moves the bodies little. In the
    # unknowns themselves the condition number would be that of the data.
    step = cp.Variable(size)
    steps = span @ inverse
    full = free + steps @ step
    constraints: list[Any] = [
        cp.reshape(full[16 * i : 16 * (i + 1)], (4, 4), order="C") >> least * np.eye(4)
        for i in range(bodies)
    ]
    if np.any(bounded):
        constraints.append(full[16 * bodies + np.flatnonzero(bounded)] >= 0)
    if above is not None and limits is not None and len(above):
        constraints.append(above @ full >= limits)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(step)), constraints)
    with warnings.catch_warnings():  # what they say is in the status
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.error.SolverError:
            return None, False
    if step.value is None or not np.all(np.isfinite(step.value)):
        return None, False
    return free + steps @ np.asarray(step.value), problem.status == cp.OPTIMAL


def _conic_solver() -> Any:
    """CVXPY with Clarabel; they take a second to import and few fits need them."""
    require("clarabel", "inertia")
    return require("cvxpy", "inertia")


def _expansion(bodies: int, others: int) -> Float[np.ndarray, "unknowns independent"]:
    """From the ten independent entries of each symmetric matrix to all sixteen."""
    expand = np.zeros((16 * bodies + others, 10 * bodies + others))
    for body in range(bodies):
        for entry, (a, b) in enumerate(_UPPER):
            expand[16 * body + 4 * a + b, 10 * body + entry] = 1.0
            expand[16 * body + 4 * b + a, 10 * body + entry] = 1.0
    expand[16 * bodies :, 10 * bodies :] = np.eye(others)
    return expand


def _solutions(
    rows: Float[np.ndarray, "constraints unknowns"], values: Float[np.ndarray, " constraints"]
) -> tuple[Float[np.ndarray, " unknowns"], Float[np.ndarray, "unknowns free"]]:
    """All x with rows @ x = values: one of them, and what can be added to it."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.eye(rows.shape[1])
    lengths = np.linalg.norm(rows, axis=1)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    rows, values = rows / lengths[:, None], values / lengths
    left, sizes, right = np.linalg.svd(rows)
    rank = numerical_rank(rows.T)
    return right[:rank].T @ ((left.T @ values)[:rank] / sizes[:rank]), right[rank:].T

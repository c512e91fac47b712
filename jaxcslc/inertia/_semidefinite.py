from typing import Any

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._rank import numerical_rank


# Entries of a symmetric matrix above its diagonal, column by column, and how a cone scales them so
# that their products add up to the trace of a product.
_UPPER = [(a, b) for b in range(4) for a in range(b + 1)]
_DIAGONAL = np.array([float(a == b) for a, b in _UPPER])
_TRIANGLE = np.where(_DIAGONAL > 0.0, 1.0, np.sqrt(2.0))


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

    # From there, in steps that cost alike: what the data fix moves the bodies little. In the
    # unknowns themselves the condition number would be that of the data.
    steps = span @ inverse
    others = 16 * bodies + np.flatnonzero(bounded)
    slopes, starts = [steps[others]], [free[others]]
    if above is not None and limits is not None:
        slopes.append(above @ steps)
        starts.append(above @ free - limits)
    for body in range(bodies):
        entries = 16 * body + np.array([4 * a + b for a, b in _UPPER])
        slopes.append(_TRIANGLE[:, None] * steps[entries])
        starts.append(_TRIANGLE * (free[entries] - least * _DIAGONAL))
    inequalities = sum(map(len, slopes)) - len(_UPPER) * bodies
    step, solved = _shortest(np.concatenate(slopes), np.concatenate(starts), inequalities, bodies)
    return (None, False) if step is None else (free + steps @ step, solved)


def _shortest(
    slopes: Float[np.ndarray, "rows size"],
    starts: Float[np.ndarray, " rows"],
    inequalities: int,
    bodies: int,
) -> tuple[Float[np.ndarray, " size"] | None, bool]:
    """The shortest x with starts + slopes @ x in a product of cones, by Clarabel.

    - `inequalities`: the first rows, which are ≥ 0; behind them are scaled triangles of matrices.

    **Returns** x, None where the solver fails, and whether the solver says that it is optimal.
    """
    solver = _conic_solver()
    from scipy.sparse import csc_matrix

    size = slopes.shape[1]
    options = solver.DefaultSettings()
    options.verbose = False
    cones = [solver.NonnegativeConeT(inequalities)] if inequalities else []
    cones += [solver.PSDTriangleConeT(4)] * bodies
    # min ½ x'Px + q'x subject to Ax + s = b, s in the cones
    problem = csc_matrix(2.0 * np.eye(size)), np.zeros(size), csc_matrix(-slopes), starts
    solution = solver.DefaultSolver(*problem, cones, options).solve()
    status = str(solution.status)
    x = np.asarray(solution.x)
    if status not in ("Solved", "AlmostSolved", "MaxIterations") or not np.all(np.isfinite(x)):
        return None, False
    return x, status == "Solved"


def _conic_solver() -> Any:
    """Clarabel by itself: a modelling library takes a second to import."""
    return require("clarabel", "inertia")


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

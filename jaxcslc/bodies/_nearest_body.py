"""Semidefinite least squares, and the possible body nearest to an estimate of its ten numbers.

`whitening` turns changes of coefficients into standard errors. Clarabel solves the cone
programme.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from .._environment import require
from .._rank import numerical_rank
from ._body import body_of_pseudo_inertia, principal_body, pseudo_inertia


# Noise-free coefficients have a covariance of rounding. Standard errors are taken as no less than
# this part of the coefficient that an average body would cause: finer is beyond the solver.
_FINEST = 1e-6


@runtime_checkable
class Fitted(Protocol):
    """Coefficients and their uncertainty: what an `Identification` and its file share."""

    @property
    def k(self) -> Float[Array | np.ndarray, " coefficients"]: ...
    @property
    def covariance(self) -> Float[Array | np.ndarray, "coefficients coefficients"]: ...
    @property
    def undetermined(self) -> Float[Array | np.ndarray, "rows coefficients"]: ...


def whitening(
    fit: Fitted, sizes: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "rank coefficients"]:
    """The matrix that turns a change of the coefficients into standard errors.

    The standard errors are those of independent residuals: the norm of the result is then also the
    torque that the change causes over the patterns, in units of the residual.

    A change along a combination that the data do not determine costs nothing: the covariance is
    inverted on its range only, along the undetermined combinations. The result's squared norm is
    what the change adds to the sum of squared residuals, in units of their variance.

    **Arguments**

    - `fit`: its coefficients, covariance and undetermined combinations.
    - `sizes`: of typical coefficients, in their units.

    **Returns**

    - A matrix with one row for each determined combination.

    **Raises**

    - `ValueError`: if the coefficients or their covariance are not finite.
    """
    # A covariance that allows for correlation is of low rank; torques are measured by the other.
    covariance = np.asarray(getattr(fit, "independent_covariance", fit.covariance), float)
    free = np.asarray(fit.undetermined, float)
    if not np.all(np.isfinite(covariance)) or not np.all(np.isfinite(np.asarray(fit.k))):
        raise ValueError("the fit's coefficients or covariance are not finite")
    units = np.sqrt(np.maximum(np.diag(covariance), 0.0)) + _FINEST * sizes
    free = free[np.linalg.norm(free, axis=1) > 0] / units
    if free.size:
        free = free / np.linalg.norm(free, axis=1, keepdims=True)
        free = np.linalg.svd(free, full_matrices=False)[2][: numerical_rank(free.T)]
    scaled = covariance / np.outer(units, units)
    scaled = (scaled + scaled.T) / 2 + np.diag((_FINEST * sizes / units) ** 2)
    # Numbers that changes along undetermined combinations leave as they are. The covariance's range
    # would do as well, but beside a variance of infinity it cannot be told from rounding.
    numbers = np.eye(len(units))
    if free.size:
        numbers = np.linalg.svd(free)[2][len(free) :]
    values, vectors = np.linalg.eigh(numbers @ scaled @ numbers.T)
    # Of a motion that is all rounding, variances are too, and may be below zero.
    values = np.maximum(values, np.finfo(float).eps * len(values) * values[-1:])
    return (vectors.T / np.sqrt(values)[:, None]) @ numbers / units


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
    """Minimise |matrix x - target|² with x = (X₁, …, Xₘ, y), rows @ x = values, every Xᵢ (4, 4)
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
    """Import Clarabel by itself: a modelling library takes a second to import."""
    return require("clarabel", "inertia")


def _expansion(bodies: int, others: int) -> Float[np.ndarray, "unknowns independent"]:
    """Return the matrix from ten independent entries of each symmetric matrix to all sixteen."""
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


# Of aluminium [kg/m³]: how large the ball is that a body of unknown shape is compared with.
_DENSITY = 2700.0
_LIGHTEST = 1e-3  # kg
# Farthest centre of the ball from the frame's origin [m]: an estimate of first moments without mass
# has none.
_FARTHEST = 1.0
# Sizes of typical numbers of a body [kg m², kg m, kg].
_SIZES = np.array([0.1] * 6 + [0.3] * 3 + [1.0])
# Standard errors that a change by the whole ball counts: it decides what the data leave open.
_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class _Estimate:
    k: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "10 10"]
    undetermined: Float[np.ndarray, "rows 10"]


def nearest_body(
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"] | None = None,
    *,
    least: float = 1e-3,
) -> Float[np.ndarray, "10"] | None:
    """The body that can exist nearest to an estimate of its ten numbers (`BODY`).

    The semidefinite programme of `physical_parameters` for one body: nearest in standard errors
    of `covariance`, on the combinations that are determined; along the `undetermined` ones,
    nearest to an aluminium ball of the estimate's mass around its centre. An estimate that can
    exist is its own answer, but for rounding.

    **Arguments**

    - `body`, `covariance`: the estimate, and how uncertain it is.
    - `undetermined`: combinations that the data do not determine; none if omitted.
    - `least`: the body holds at least this part of such a ball (eigenvalues of its
      pseudo-inertia, in units of the ball's).

    **Returns**

    - Ten numbers of the body; None if the solver fails.

    **Raises**

    - `ImportError`: without the conic solver, where the estimate cannot exist.

    >>> import numpy as np
    >>> body = nearest_body(np.array([-0.1, 1, 1, 0, 0, 0, 0.5, 0, 0, 2.0]), np.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(body)) > 0))
    True
    """
    if undetermined is None:
        undetermined = np.zeros((0, 10))
    ball = _ball(body, covariance, undetermined)
    unit = in_units_of(ball)
    estimate = _Estimate(body, covariance, undetermined)
    white = whitening(estimate, np.linalg.norm(unit, axis=1))
    solution, _ = semidefinite_least_squares(
        np.concatenate([white @ unit, _WEIGHT * np.eye(16)]),
        np.concatenate([white @ body, _WEIGHT * np.eye(4).ravel()]),
        np.zeros((0, 16)),
        np.zeros(0),
        bodies=1,
        bounded=np.zeros(0),
        least=least,
    )
    return None if solution is None else unit @ solution


def in_units_of(body: Float[np.ndarray, "10"]) -> Float[np.ndarray, "10 16"]:
    """Return the matrix from the entries of J̃ to the ten numbers of J = L J̃ Lᵀ.

    L Lᵀ is the pseudo-inertia of `body`.
    """
    scale = np.linalg.cholesky(pseudo_inertia(body))
    columns: list[np.ndarray] = []
    for entry in np.eye(16):
        matrix = scale @ entry.reshape(4, 4) @ scale.T
        columns.append(body_of_pseudo_inertia((matrix + matrix.T) / 2))
    return np.stack(columns, axis=1)


def _ball(
    body: Float[np.ndarray, "10"],
    covariance: Float[np.ndarray, "10 10"],
    undetermined: Float[np.ndarray, "rows 10"],
) -> Float[np.ndarray, "10"]:
    """A ball around the estimate's centre, of its mass or the mass's error, whichever is more.

    Without what is not determined, or has an error larger than any body: there the estimate is
    arbitrary, and a centre may be kilometres away. The ball is as heavy as its first moments need
    it to be within 1 m.
    """
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / _SIZES
    scaled = body / _SIZES / (1.0 + error**2)
    open_ = undetermined[np.linalg.norm(undetermined, axis=1) > 0] / _SIZES
    if open_.size:
        basis = np.linalg.svd(open_, full_matrices=False)[2][: numerical_rank(open_.T)]
        scaled = scaled - basis.T @ (basis @ scaled)
    moment = _SIZES[6:9] * scaled[6:9]
    mass = max(
        float(_SIZES[9] * scaled[9]),
        float(_SIZES[9] * min(error[9], 1.0)),
        float(np.linalg.norm(moment)) / _FARTHEST,
        _LIGHTEST,
    )
    radius = (3.0 * mass / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return principal_body(mass, moment / mass, np.full(3, mass * radius**2 / 5.0))

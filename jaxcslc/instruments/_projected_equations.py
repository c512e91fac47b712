"""Two-stage least squares: measured regressors as instruments predict them."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..least_squares import (
    Equations,
    Identification,
    LeastSquares,
    Unknowns,
    residual_weights,
    triangle_of,
)


# Rounds of weighting joints by residual.
_ROUNDS = 3


class ProjectedFit(NamedTuple):
    """The instrumental-variables fit of one set of instruments.

    - `fit`: with standard errors of residuals in which the regressor is that of measured motion.
    - `weights`: (n,) of joints.
    - `projected`: for each joint (rows, p), its regressor as instruments predict it.
    """

    fit: Identification
    weights: Float[np.ndarray, " joints"]
    projected: tuple[Float[np.ndarray, "_ coefficients"], ...]


def projected_fit(
    equations: Equations, instruments: Equations, solver: LeastSquares, samples: int
) -> ProjectedFit:
    """Two-stage least squares, which with as many instruments as coefficients is the solution of

        Zᵀ W² (torque - X k) = 0.

    The first stage replaces the regressor X by its projection on the instruments Z. The second is
    an ordinary fit by `LeastSquares`. Repeated for the projection's torque plus the residual of X,
    it has the same minimum, and the residuals, on which weights and standard errors rest, of X
    (Davidson and MacKinnon 2004, Sections 8.3 and 8.5).

    **Arguments**

    - `equations`: of measured motion; `instruments`: rows of simulated motion, one for each.
    - `solver`: its weights of joints, errors and rank rule.
    - `samples`: of the recording.

    **Raises** as `LeastSquares.fit_equations`.
    """
    n, p = len(equations.rows), equations.unknowns.size
    # The projection mixes columns: each joint's rows have those of all coefficients.
    unknowns = Unknowns(equations.unknowns.names, (tuple(range(p)),) * n)
    measured, simulated = wide_rows(equations), wide_rows(instruments)
    torques = [rows[:, -1] for rows in equations.rows]
    counts = np.array([float(len(rows)) for rows in measured])

    def second_stage(projected: list[np.ndarray], torques: list[np.ndarray]) -> Equations:
        rows = (np.column_stack(pair) for pair in zip(projected, torques, strict=True))
        return Equations(unknowns, tuple(rows), equations.sample)

    def solve(
        weights: Float[np.ndarray, " joints"],
    ) -> tuple[list[np.ndarray], np.ndarray, list[np.ndarray]]:
        """Projected regressors, coefficients, and residuals of measured regressors."""
        projected = _projection(simulated, measured, weights)
        k = _weighted(solver, weights).coefficients(second_stage(projected, torques))
        left = [y - x @ k for y, x in zip(torques, measured, strict=True)]
        return projected, k, left

    by_residual = solver.joint_weights == "residual"
    weights = np.ones(n)
    if not isinstance(solver.joint_weights, str):
        weights = np.array(solver.joint_weights, float)
    projected, k, left = solve(weights)
    for _ in range(_ROUNDS if by_residual else 0):
        error = np.array([np.sqrt(np.mean(e**2)) if len(e) else 0.0 for e in left])
        weights = np.asarray(residual_weights(error, counts))
        projected, k, left = solve(weights)
    pseudo = [x @ k + e for x, e in zip(projected, left, strict=True)]
    fit = _weighted(solver, weights).fit_equations(second_stage(projected, pseudo), samples)
    return ProjectedFit(fit, weights, tuple(projected))


def _weighted(solver: LeastSquares, weights: Float[np.ndarray, " joints"]) -> LeastSquares:
    return dataclasses.replace(solver, joint_weights=tuple(weights.tolist()))


def wide_rows(equations: Equations) -> list[Float[np.ndarray, "_ coefficients"]]:
    """Return each joint's regressor in the columns of all coefficients."""
    wide: list[np.ndarray] = []
    for support, rows in zip(equations.unknowns.support, equations.rows, strict=True):
        filled = np.zeros((len(rows), equations.unknowns.size))
        filled[:, list(support)] = rows[:, :-1]
        wide.append(filled)
    return wide


def _projection(
    simulated: list[np.ndarray], measured: list[np.ndarray], weights: Float[np.ndarray, " joints"]
) -> list[Float[np.ndarray, "_ coefficients"]]:
    """Measured regressors as instruments predict them: the first stage, for all columns at once.

    Instruments without motion predict nothing; `LeastSquares` then names what is undetermined.
    """
    both = zip(weights, simulated, measured, strict=True)
    triangle = triangle_of(np.concatenate([w * np.column_stack([z, x]) for w, z, x in both]))
    p = triangle.shape[1] // 2
    size = np.linalg.norm(triangle[:, :p], axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    scaled, *_ = np.linalg.lstsq(triangle[:, :p] / scale, triangle[:, p:], rcond=None)
    prediction = scaled / scale[:, None]
    return [z @ prediction for z in simulated]

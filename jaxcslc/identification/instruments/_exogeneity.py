import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..solver import Equations, LeastSquares, Unknowns
from ._projected_equations import ProjectedFit, wide_rows


# Columns that instruments predict to this part are predicted.
_ROUNDING = 1e-9
# Equations a coefficient that thinning leaves at least.
_FEWEST = 6


class ExogeneityTest(NamedTuple):
    """Durbin, Wu and Hausman's test of whether least squares is biased by noise of the motion.

    The null hypothesis is that the measured regressor is independent of the equations' errors, so
    that least squares and instrumental variables estimate the same.

    **Attributes**

    - `statistic`: F; `degrees_of_freedom`: of its distribution.
    - `p_value`: how probable such a statistic is or a greater one if least squares is unbiased.
    - `thinning`: of so many instants one is used, for residuals that are correlated in time.
    """

    statistic: float
    degrees_of_freedom: tuple[int, int]
    p_value: float
    thinning: int

    def __str__(self) -> str:
        verdict = "biased" if self.p_value < 0.05 else "not seen to be biased"
        return (
            f"least squares is {verdict}: F = {self.statistic:.3g}, p = {self.p_value:.2g}"
            f" (Durbin-Wu-Hausman, one of {self.thinning} instants)"
        )


def exogeneity_test(equations: Equations, projected: ProjectedFit) -> ExogeneityTest:
    """The test by an augmented regression: what instruments do not predict of the regressor is
    added to it, and has coefficients of zero if least squares is unbiased.

    As Janot, Vandanjon and Gautier revised the test for robots ('A revised Durbin-Wu-Hausman test
    for industrial robot identification', Control Engineering Practice 48, 2016), equations are
    thinned out until residuals are about white, and a rank-revealing factorisation leaves out
    columns without information. It supposes that instruments are valid: of motion that was
    simulated from noisy torques they are not.

    - `equations`: of measured motion.
    - `projected`: their fit by instruments; with correlated errors it says how many of the
      equations are independent.
    """
    unknowns = equations.unknowns
    shares = np.asarray(projected.fit.equations) / np.maximum(
        np.asarray(projected.fit.effective_equations), 1.0
    )
    thinning = max(1, math.ceil(float(np.max(shares, initial=1.0)) - 0.25))
    # A filter has left some of the samples already, which are thinned, and not too far.
    total = sum(map(len, equations.rows))
    thinning = min(thinning, max(1, total // (_FEWEST * unknowns.size)))
    instants, _ = equations.instants()
    size = int(instants[-1]) + 1
    kept = np.isin(np.arange(size), instants[::thinning])
    solver = LeastSquares(tuple(projected.weights.tolist()), errors="independent")
    added = _not_predicted(wide_rows(equations), projected.projected)
    rows = tuple(
        np.column_stack([rows[:, :-1], extra, rows[:, -1]])
        for rows, extra in zip(equations.rows, added, strict=True)
    )
    p = unknowns.size
    names = (*unknowns.names, *(f"{name} not simulated" for name in unknowns.names))
    supports = tuple((*support, *range(p, 2 * p)) for support in unknowns.support)
    augmented = Equations(Unknowns(names, supports), rows, equations.sample)
    before, after = (
        _squares(solver, some.selected(kept), size, projected.weights)
        for some in (equations, augmented)
    )
    of_added = after.rank - before.rank
    remaining = int(before.equations) - after.rank
    if of_added < 1 or remaining < 1 or not after.total > 0.0:
        return ExogeneityTest(0.0, (max(of_added, 0), max(remaining, 0)), 1.0, thinning)
    statistic = max(before.total - after.total, 0.0) / of_added / (after.total / remaining)
    p_value = float(scipy.special.fdtrc(of_added, remaining, statistic))
    return ExogeneityTest(float(statistic), (of_added, remaining), p_value, thinning)


def _not_predicted(
    measured: Sequence[np.ndarray], projected: Sequence[np.ndarray]
) -> list[Float[np.ndarray, "_ coefficients"]]:
    """What instruments do not predict of regressors; zeros where that is rounding."""
    left = [x - z for x, z in zip(measured, projected, strict=True)]
    size, whole = (
        np.sqrt(np.sum([np.sum(x**2, axis=0) for x in some], axis=0)) for some in (left, measured)
    )
    return [np.where(size > _ROUNDING * whole, x, 0.0) for x in left]


class _Squares(NamedTuple):
    """Of a fit: the weighted sum of its squared residuals, its rank, the number of equations."""

    total: float
    rank: int
    equations: float


def _squares(
    solver: LeastSquares, equations: Equations, samples: int, weights: Float[np.ndarray, " joints"]
) -> _Squares:
    fit = solver.fit_equations(equations, samples)
    counts = np.asarray(fit.equations)
    total = np.sum(counts * (weights * np.asarray(fit.torque_error)) ** 2)
    return _Squares(float(total), int(fit.rank), float(counts.sum()))

"""Loop of simulation and fit until coefficients settle, and the exogeneity test.

The test is that of Durbin, Wu and Hausman.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from .._environment import require_float64
from ..bodies import fixed_bodies, physical_parameters
from ..least_squares import Equations, Identification, LeastSquares, Settings, Unknowns
from ..network import CSLC
from ..recordings import Patterns, Recording
from ._projected_equations import ProjectedFit, wide_rows
from ._simulated_motion import AbstractSimulatedMotion, simulated_derivatives


# Columns that instruments predict to this part are predicted.
_SQUARES_ROUNDING = 1e-9
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
    """Return the part of regressors that instruments do not predict; zeros for rounding."""
    left = [x - z for x, z in zip(measured, projected, strict=True)]
    size, whole = (
        np.sqrt(np.sum([np.sum(x**2, axis=0) for x in some], axis=0)) for some in (left, measured)
    )
    return [np.where(size > _SQUARES_ROUNDING * whole, x, 0.0) for x in left]


class _Squares(NamedTuple):
    """Weighted sum of a fit's squared residuals, its rank, and the number of equations."""

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


# Fits that change by less than this part of their standard errors are the same.
_SAME = 0.05
# Without noise there is no error to compare with.
_STEP_ROUNDING = 1e-6


class SimulationFit(eqx.Module):
    """Coefficients from torques and simulated motion.

    **Attributes**

    - `network`: as it was; `fit`: its coefficients.
    - `least_squares`: the regression on measured motion that the first simulation is of.
    - `exogeneity`: the test of whether that regression is biased; None where there is none.
    - `distance`: (n,) root mean square of simulated minus recorded positions [rad or m].
    - `steps`: simulations; `converged`: whether the last one changed nothing beyond a twentieth of
      a standard error.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(800)[:, None] * 0.005
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> result = jc.InstrumentalVariables().fit(network, recording)
    >>> result.converged, result.fit.names, np.round(result.k, 3).tolist()
    (True, ('kB1', 'kv1'), [0.5, 0.2])
    """

    network: CSLC
    fit: Identification
    least_squares: Identification
    exogeneity: ExogeneityTest | None
    distance: Float[np.ndarray, " joints"]
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.fit.k

    def __repr__(self) -> str:
        ended = "converged" if self.converged else "did not converge"
        tested = "" if self.exogeneity is None else f"; {self.exogeneity}"
        return f"SimulationFit({ended} after {self.steps} simulations{tested}; {self.fit})"


class Simulated(NamedTuple):
    """Motion under some coefficients, beside the measured motion of the same samples.

    - `measured`: patterns of the recording; `simulated`: those of the simulation.
    - `distance`: (n,) root mean square of their positions' difference.
    """

    measured: Patterns
    simulated: Patterns
    distance: Float[np.ndarray, " joints"]


def fit_by_simulation(
    network: CSLC,
    recording: Recording,
    motion: AbstractSimulatedMotion,
    settings: Settings,
    start: Identification | None,
    iterations: int,
    solve: Callable[[Simulated], tuple[Identification, ExogeneityTest | None]],
    progress: Callable[[str], None] | None,
) -> SimulationFit:
    """Simulates and solves in turn until coefficients do not change beyond their errors.

    - `solve`: from motion to coefficients.
    - the others: as of `InstrumentalVariables.fit`.

    **Raises** as `InstrumentalVariables.fit`.
    """
    require_float64()
    _check(network, recording, settings)
    report = progress or (lambda words: None)
    measured = settings.patterns(recording)
    report("regression on measured motion")
    least_squares = settings.fit(network, measured)
    fit, exogeneity = least_squares if start is None else start, None
    distance, converged, steps = np.zeros(network.joint_count), False, 0
    while steps < iterations and not converged:
        steps += 1
        report(f"simulation {steps}")
        k = _possible(network, fit, measured)
        derivatives = simulated_derivatives(motion, network, k, recording, settings)
        patterns = settings.preparation.patterns(recording, derivatives)
        distance = np.sqrt(np.mean((derivatives[0] - recording.position) ** 2, axis=0))
        before = np.asarray(fit.k)
        fit, exogeneity = solve(Simulated(measured, patterns, distance))
        error = np.asarray(fit.standard_error)
        known = np.isfinite(error) & (error > 0.0)
        change = np.abs(np.asarray(fit.k) - before)
        converged = bool(np.all((change <= _SAME * error + _STEP_ROUNDING * np.abs(before))[known]))
    return SimulationFit(network, fit, least_squares, exogeneity, distance, steps, converged)


def _possible(network: CSLC, fit: Identification, measured: Patterns) -> np.ndarray:
    """Coefficients to simulate by: those of a fit, or of the nearest bodies that can exist, where
    the fit's mass matrix is that of no body somewhere along the motion."""
    mass = np.asarray(network.mass_matrix(fit.k, jnp.asarray(measured.q)))
    if np.all(np.linalg.eigvalsh(mass)[:, 0] > 0.0):
        return np.asarray(fit.k)
    return np.asarray(physical_parameters(network, fit, fixed=fixed_bodies(network.robot)).k)


def _check(network: CSLC, recording: Recording, settings: Settings) -> None:
    """**Raises** `ValueError` as `InstrumentalVariables.fit`."""
    if network.payload is not None:
        raise ValueError(f"{network.name!r} has a payload; expected a network without one")
    if recording.position.shape[1] != network.joint_count:
        raise ValueError(
            f"the recording has {recording.position.shape[1]} joints; expected"
            f" {network.joint_count}, those of {network.name!r}"
        )
    if settings.solver.loss != "squared":
        raise ValueError(
            f"loss is {settings.solver.loss!r}; expected 'squared': instruments have no other"
        )


def both_masks(simulated: Simulated) -> tuple[Patterns, Patterns]:
    """Measured and simulated patterns, with the pairs that count in both."""
    mask = np.asarray(simulated.measured.mask) & np.asarray(simulated.simulated.mask)
    measured, of_simulation = (
        dataclasses.replace(patterns, backlash_mask=mask, friction_mask=mask)
        for patterns in (simulated.measured, simulated.simulated)
    )
    return measured, of_simulation

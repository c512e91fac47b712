"""The estimators `InstrumentalVariables` (IDIM-IV) and `DirectDynamics` (DIDIM).

Both simulate and fit in turn until coefficients settle (`AbstractSimulationFit`). Instruments
enter by two-stage least squares (`projected_fit`). `exogeneity_test` says whether least squares is
biased.
"""

import abc
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
from ..least_squares import (
    Equations,
    Identification,
    LeastSquares,
    Settings,
    Unknowns,
    triangle_of,
    weights_by_residual,
)
from ..network import CSLC
from ..recordings import Patterns, Recording
from ._simulation import (
    AbstractSimulatedMotion,
    ControlledMotion,
    CorrectedMotion,
    simulated_derivatives,
)


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

    The first stage replaces the regressor X by its projection on the instruments Z, rows of
    simulated motion. The second is an ordinary fit by `LeastSquares`. Repeated for the projection's
    torque plus the residual of X, it has the same minimum, and the residuals, on which weights and
    standard errors rest, of X (Davidson and MacKinnon 2004, Sections 8.3 and 8.5).
    """
    n, p = len(equations.rows), equations.unknowns.size
    # The projection mixes columns: each joint's rows have those of all coefficients.
    unknowns = Unknowns(equations.unknowns.names, (tuple(range(p)),) * n)
    measured, simulated = wide_rows(equations), wide_rows(instruments)
    torques = [rows[:, -1] for rows in equations.rows]

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

    def errors(weights: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " joints"]:
        return np.array([np.sqrt(np.mean(e**2)) if len(e) else 0.0 for e in solve(weights)[2]])

    given = solver.joint_weights
    weights = np.ones(n) if isinstance(given, str) else np.array(given, float)
    if given == "residual":
        scale = equations.counts(), equations.torque_scale(), equations.unknowns.joint_sizes
        weights = np.asarray(weights_by_residual(errors, weights, *scale))
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


def _possible(network: CSLC, fit: Identification, measured: Patterns) -> np.ndarray:
    """Coefficients to simulate by: those of a fit, or of the nearest bodies that can exist, where
    the fit's mass matrix is that of no body somewhere along the motion."""
    mass = np.asarray(network.mass_matrix(fit.k, jnp.asarray(measured.q)))
    if np.all(np.linalg.eigvalsh(mass)[:, 0] > 0.0):
        return np.asarray(fit.k)
    return np.asarray(physical_parameters(network, fit, fixed=fixed_bodies(network.robot)).k)


def _check(network: CSLC, recording: Recording, settings: Settings) -> None:
    """**Raises** `ValueError` as `AbstractSimulationFit.fit`."""
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


@dataclasses.dataclass(frozen=True)
class AbstractSimulationFit(abc.ABC):
    """Estimator that simulates and fits in turn, until coefficients settle.

    **Attributes**

    - `motion`: how the arm is simulated.
    - `settings`: of preparation and fit; None for the defaults of `Settings`.
    - `iterations`: simulations at most.

    **Raises** `ValueError`: no iterations.
    """

    motion: AbstractSimulatedMotion
    settings: Settings | None = None
    iterations: int = 10

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations is {self.iterations}; expected 1 or more")

    @abc.abstractmethod
    def solve(
        self, network: CSLC, settings: Settings, measured: Patterns, simulated: Patterns
    ) -> tuple[Identification, ExogeneityTest | None]:
        """Return the coefficients of measured and simulated motion, and the test of the former."""

    def fit(
        self,
        network: CSLC,
        recording: Recording,
        start: Identification | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> SimulationFit:
        """Fit the coefficients of a recording.

        **Arguments**

        - `network`: n joints, p coefficients, with its slopes of static friction; without a
          payload.
        - `recording`: sampled uniformly.
        - `start`: coefficients of the first simulation; by default those of least squares. Where
          they are of no body that can exist, those of the nearest bodies are simulated.
        - `progress`: is called with a few words at each stage.

        **Returns** a `SimulationFit`; look at `converged` and `exogeneity`.

        **Raises**

        - `ValueError`: recording and network differ in joints, the network has a payload, times
          that are not uniform, a loss other than squares, or as `AbstractSimulatedMotion.simulate`.
        - `RuntimeError`: a fit that fails, or simulated motion that leaves the recorded one.
        """
        require_float64()
        settings = (self.settings or Settings()).for_network(network)
        _check(network, recording, settings)
        report = progress or (lambda words: None)
        measured = settings.patterns(recording)
        report("regression on measured motion")
        least_squares = settings.fit(network, measured)
        fit, exogeneity = least_squares if start is None else start, None
        distance, converged, steps = np.zeros(network.joint_count), False, 0
        while steps < self.iterations and not converged:
            steps += 1
            report(f"simulation {steps}")
            k = _possible(network, fit, measured)
            derivatives = simulated_derivatives(self.motion, network, k, recording, settings)
            simulated = settings.preparation.patterns(recording, derivatives)
            distance = np.sqrt(np.mean((derivatives[0] - recording.position) ** 2, axis=0))
            before = np.asarray(fit.k)
            fit, exogeneity = self.solve(network, settings, measured, simulated)
            error = np.asarray(fit.standard_error)
            known = np.isfinite(error) & (error > 0.0)
            change = np.abs(np.asarray(fit.k) - before)
            converged = bool(
                np.all((change <= _SAME * error + _STEP_ROUNDING * np.abs(before))[known])
            )
        return SimulationFit(network, fit, least_squares, exogeneity, distance, steps, converged)


@dataclasses.dataclass(frozen=True)
class InstrumentalVariables(AbstractSimulationFit):
    """Identification by instruments from simulated motion: IDIM-IV.

    Noise of positions is in the regressor X and, through it, in the residual: least squares is
    biased, more so with less smoothing. The regressor Z of motion that was simulated with the
    identified model is nearly that of the true motion, and independent of the noise:

        Zᵀ W² (torque - X k) = 0

    has no such bias. Each solution is simulated in turn (Janot, Vandanjon and Gautier, 'A generic
    instrumental variable approach for industrial robot identification', IEEE Transactions on
    Control Systems Technology 22, 2014). Noise that changes signs of velocities remains: slow pairs
    are excluded, as in least squares.

    **Attributes**

    - `motion`: how the arm is simulated: `ControlledMotion` where controller and reference of the
      recording are known, `CorrectedMotion` otherwise.
    - `settings`: by which X is prepared, and its fit; None for the defaults of `Settings`.
    - `iterations`: simulations at most.

    **Raises** `ValueError`: no iterations.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> exact = jc.examples.swing_recording(network, [0.5, 0.2])
    >>> noise = 2e-4 * np.random.default_rng(0).standard_normal(exact.position.shape)
    >>> recording = jc.Recording(exact.time, exact.position + noise, exact.torque)
    >>> rough = jc.Settings(jc.Preparation(jc.recordings.CentralDifferences()))
    >>> result = jc.InstrumentalVariables(settings=rough).fit(network, recording)
    >>> result.k.round(2).tolist(), result.least_squares.k.round(2).tolist()
    ([0.5, 0.2], [0.12, 0.19])
    >>> result.exogeneity.p_value < 1e-6, result.converged
    (True, True)
    """

    motion: AbstractSimulatedMotion = dataclasses.field(default_factory=CorrectedMotion)

    def solve(
        self, network: CSLC, settings: Settings, measured: Patterns, simulated: Patterns
    ) -> tuple[Identification, ExogeneityTest]:
        """Return the coefficients of measured motion by instruments of simulated motion."""
        mask = np.asarray(measured.mask) & np.asarray(simulated.mask)  # pairs that count in both
        equations, instruments = (
            settings.solver.equations(
                network, dataclasses.replace(patterns, backlash_mask=mask, friction_mask=mask)
            )
            for patterns in (measured, simulated)
        )
        result = projected_fit(equations, instruments, settings.solver, measured.samples)
        return result.fit, exogeneity_test(equations, result)


@dataclasses.dataclass(frozen=True)
class DirectDynamics(AbstractSimulationFit):
    """Identification from torques alone, by simulated motion: DIDIM.

    The simulated arm follows the reference of the recording under its controller; its torque is
    compared with the recorded one. Because the controller makes simulated motion nearly independent
    of the coefficients, the derivative of that torque is nearly the regressor Z of simulated
    motion, and Gauss and Newton's step is an ordinary regression

        min ‖W (torque - Z k)‖

    Each solution is simulated in turn (Gautier, Janot and Vandanjon, 'A new closed-loop output
    error method for parameter identification of robot dynamics', IEEE Transactions on Control
    Systems Technology 21, 2013). No recorded position is used except in the first simulation and to
    see that the simulated arm follows. With a controller or reference that is not the recording's,
    Z is of another motion than the torques, and the fit is biased.

    **Attributes**

    - `motion`: a `ControlledMotion` with the controller and the reference of the recording.
    - `settings`: alignment of torques, masks and fit; None for the defaults of `Settings`.
    - `iterations`: simulations at most.

    **Raises** `ValueError`: no iterations.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, Reference
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> t = np.arange(1000)[:, None] * 0.002
    >>> desired = Reference(0.5 - 0.5 * np.cos(4 * t), 2 * np.sin(4 * t), 8 * np.cos(4 * t))
    >>> pid = PID(1, position_gain=200.0, velocity_gain=20.0)
    >>> motion = jc.instruments.ControlledMotion(pid, desired)
    >>> start = jc.Recording(t[:, 0], desired.q, desired.q)
    >>> q, qd, qdd = motion.simulate(network, np.array([0.5, 0.2]), start, jc.Settings())
    >>> recording = jc.Recording(t[:, 0], q, 0.5 * qdd + 0.2 * qd)
    >>> jc.DirectDynamics(motion).fit(network, recording).k.round(2).tolist()
    [0.5, 0.2]
    """

    motion: ControlledMotion

    def solve(
        self, network: CSLC, settings: Settings, measured: Patterns, simulated: Patterns
    ) -> tuple[Identification, None]:
        """Return the coefficients of recorded torques along simulated motion."""
        del measured
        return settings.fit(network, simulated), None

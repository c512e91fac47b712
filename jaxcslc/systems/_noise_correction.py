"""Correction of coefficients for the bias of measurement noise and smoothing.

Draws of noise go through smoothing and fit. What they make of equations and coefficients is the
bias, the standard errors, and a test of whether noise explains the errors. Smoothing's bias is seen
on motion that is smoothed once more.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from ..least_squares import Equations, Identification, Settings, Unknowns, WeightedEquations
from ..recordings import Patterns, away_from_reversals
from ._network import SystemNetwork
from ._recording import (
    SystemRecording,
    check_noise,
    level_error,
    measurement_noise,
    system_derivatives,
    with_simulated_noise,
)
from ._system import System


# Filters and splines ring at the ends for a few times what they reach: at once what they reach, the
# rate of a sine that splines smoothed was off by 6 %.
REACHES = 3

Motion = Float[np.ndarray, "3 samples variables"]
"""Values, first and second derivatives of all variables."""


def stacked_motion(patterns: Patterns) -> Motion:
    """Return the motion of patterns as one array of NumPy's."""
    return np.stack([np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd)])


def with_motion(network: SystemNetwork, patterns: Patterns, motion: Motion) -> Patterns:
    """Return the samples with another motion, and the known sides that go with it."""
    q, qd, qdd = motion
    known = np.asarray(_known(network, q, qd, qdd))
    return dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=known)


@eqx.filter_jit
def _known(network: SystemNetwork, q: Any, qd: Any, qdd: Any) -> Array:
    return network.known(q, qd, qdd)


@dataclasses.dataclass(frozen=True)
class SmoothingBias:
    """Change of the coefficients of a fit by smoothing, seen on motion that is smoothed once more.

    What smoothing takes out of motion that is smooth already is nearly what it took out of the
    true motion (Tukey's twicing): smoothing S leaves S x of x, so that S S x - S x is the bias
    S x - x smoothed, and differs from it by (S - 1)² x only.

    Samples count that smoothing once more says something of: not those at the ends, where the
    motion that comes in is that of windows cut short; nor those within twice the margin that a
    preparation keeps from reversals, over which jumps spread that the fit does not see.

    **Attributes**

    - `system`, `settings`: whose states were smoothed, and how.
    - `patterns`: of the fit, with a mask that leaves these samples in.
    - `problem`: their equations, with weights.
    """

    system: System
    settings: Settings
    patterns: Patterns
    problem: WeightedEquations

    @classmethod
    def of(
        cls,
        system: System,
        settings: Settings,
        patterns: Patterns,
        fit: Identification,
        reach: int,
    ) -> "SmoothingBias | None":
        """Return the bias of a fit.

        It is None for a system without states, and where the samples do not determine what the fit
        determines.

        - `reach`: of the smoothing, in samples.
        """
        if not system.states:
            return None
        sample = np.arange(patterns.samples)
        ends = REACHES * reach
        mask = (sample >= ends) & (sample < patterns.samples - ends)
        margin = 2 * settings.preparation.reversal_margin
        for arguments in system.signs if margin else ():
            if arguments:
                values = system.evaluate(arguments, *stacked_motion(patterns))
                mask &= np.all(away_from_reversals(values, margin), axis=1)
        inner = dataclasses.replace(
            patterns, friction_mask=np.asarray(patterns.friction_mask) & mask[:, None]
        )
        if not np.all(np.any(np.asarray(inner.mask), axis=0)):
            return None
        equations = settings.solver.equations(system.network, inner)
        problem = WeightedEquations.of(equations, np.asarray(fit.k), settings.solver)
        determined = np.asarray(problem.solution(equations).determined)
        if np.any(np.asarray(fit.determined) & ~determined):
            return None
        return cls(system, settings, inner, problem)

    def again(self, motion: Motion) -> Motion:
        """Return motion of all samples smoothed once more.

        Each derivative is sent through by itself: velocities and accelerations are integrated,
        exactly, as cubic splines, and smoothing differentiates the integrals. Positions that were
        smoothed have noise left which only the smoothing's own derivatives suppress: exact
        derivatives of them would be mostly noise.
        """
        preparation = self.settings.preparation
        time, smoothing = np.asarray(self.patterns.time, float), preparation.smoothing
        states, inputs = list(self.system.states), self.system.inputs
        again, before = motion.copy(), motion[:, :, states]
        for order in range(max(self.system.network.highest) + 1):
            position = _integral(time, before, order)
            again[order][:, states] = smoothing.smooth(time, position)[order]
        # Derivatives that were measured are treated as by `system_derivatives`.
        variables = [self.system.variables[i] for i in states]
        rates = np.array([variable.rate is not None for variable in variables])
        second = np.array([variable.second_rate is not None for variable in variables])
        at = np.array(states)
        if np.any(rates):
            speed = smoothing.low_pass(time, before[1])
            integral = scipy.interpolate.CubicSpline(time, before[2]).antiderivative(1)(time)
            slope = np.gradient(smoothing.low_pass(time, integral), time, axis=0, edge_order=2)
            again[1][:, at[rates]], again[2][:, at[rates]] = speed[:, rates], slope[:, rates]
        if np.any(second):
            again[2][:, at[second]] = smoothing.low_pass(time, before[2])[:, second]
        if inputs and preparation.smooth_torque:
            again[0][:, inputs] = smoothing.low_pass(time, motion[0][:, inputs])
        return again

    def solution(self, motion: Motion) -> Float[np.ndarray, " coefficients"]:
        """Return the coefficients that fit another motion of the samples."""
        patterns = with_motion(self.system.network, self.patterns, motion)
        equations = self.settings.solver.equations(self.system.network, patterns)
        return self.problem.solution(equations).k

    def estimate(
        self,
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, " coefficients"]]:
        """Return the bias, and by how much it may be off.

        The bias is the difference of the coefficients of motion smoothed twice and once. It may be
        off by as much as it differs from that of three times and twice.
        """
        once = stacked_motion(self.patterns)
        twice = self.again(once)
        first, second, third = map(self.solution, (once, twice, self.again(twice)))
        return second - first, (second - first) - (third - second)


def _integral(
    time: Float[np.ndarray, " samples"], motion: Motion, order: int
) -> Float[np.ndarray, "samples variables"]:
    """Return positions whose derivatives of an order are those of a motion.

    Polynomials, which smoothing does not change, bring them near the motion's positions.
    """
    if order == 0:
        return motion[0]
    spline = scipy.interpolate.CubicSpline(time, motion[order])
    position = spline.antiderivative(order)(time)
    powers = ((time - time[0]) / np.ptp(time))[:, None] ** np.arange(order)
    return position + powers @ np.linalg.lstsq(powers, motion[0] - position, rcond=None)[0]


# Chance by which a fit of equations that hold, with white noise, is said to have other errors.
_CHANCE = 0.001
# Fits of noise alone that show how far the standard errors of residuals scatter.
_REFITTED = 40
# Of eigenvalues of a matrix whose diagonal is near one.
_ROUNDING = 1e-9
# Errors of all equations that are so many times those that noise makes are not looked into further.
_NEGLIGIBLE = 30.0
# With more stretches of a recording, what is left uncertain is the level of its noise.
_STRETCHES = 64

Noise = Mapping[str, float] | Literal["estimated"] | None
"""Standard deviation of the noise of columns; or whether to estimate it."""
OfEquations = list[Float[np.ndarray, "_ draws"]]
"""For each equation of the system, changes of its rows draw by draw."""


class EquationsUndefined(ValueError):
    """Equations have no finite values where simulated noise takes a recording."""


@dataclasses.dataclass(frozen=True)
class NoiseCorrection:
    """Effect of measurement noise on the coefficients of a system, and the corrected fit.

    **Attributes**

    - `noise`: standard deviation of the noise of each column, measured or assumed.
    - `bias`: (p,) what noise adds to each coefficient on average; taken off those of `fit`.
    - `smoothing_bias`: (p,) what smoothing takes out of the motion adds to each; taken off, too.
    - `smoothing_remainder`: (p,) by how much that may be off; part of the standard errors of `fit`.
    - `standard_error`: (p,) that the simulated noise makes.
    - `ratio`: (n,) root mean square of each equation's error over that which noise makes.
    - `explained`: whether noise explains the errors of the equations. Otherwise standard errors of
      `fit` are those of its residuals.
    - `draws`: of simulated noise.
    - `fit`: the corrected `Identification`.
    - `warnings`: one sentence each.
    """

    noise: Mapping[str, float]
    bias: Float[np.ndarray, " coefficients"]
    smoothing_bias: Float[np.ndarray, " coefficients"]
    smoothing_remainder: Float[np.ndarray, " coefficients"]
    standard_error: Float[np.ndarray, " coefficients"]
    ratio: Float[np.ndarray, " equations"]
    explained: bool
    draws: int
    fit: Identification
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        noise = ", ".join(f"{name} {value:.3g}" for name, value in self.noise.items())
        error = np.asarray(self.fit.standard_error)
        known = (error > 0.0) & (error < np.inf)
        of_noise, of_smoothing = (
            float(np.max(np.abs(bias[known] / error[known]), initial=0.0))
            for bias in (self.bias, self.smoothing_bias)
        )
        source = f"{self.draws} draws of this noise" if self.explained else "the residuals"
        return (
            f"noise of the columns: {noise}\nits bias is taken off: up to {of_noise:.2g} standard"
            f" errors; that of smoothing, too: up to {of_smoothing:.2g}; standard errors from"
            f" {source}"
        )


def correct_for_noise(
    system: System,
    recording: SystemRecording,
    patterns: Patterns,
    settings: Settings,
    fit: Identification,
    noise: Noise = "estimated",
    *,
    draws: int = 100,
    pairs: int = 6,
    seed: int = 0,
) -> NoiseCorrection:
    """Takes the bias of measurement noise and of smoothing off the coefficients of a system.

    Noise of states is in the regressor, squared and multiplied with itself, so that least squares
    is off by a part that no amount of data averages out: coefficients of noisy derivatives shrink,
    also where the known side of an equation is zero ("errors in variables"). Simulation and
    extrapolation (Cook and Stefanski, 'Simulation-extrapolation estimation in parametric
    measurement error models', JASA 1994, doi:10.1080/01621459.1994.10476871) needs no model of how:
    noise of the same strength is added to the recording, which then goes through the same
    smoothing, equations and filter. What the coefficients move by on average is the bias for once
    more noise, which is in proportion to the noise's variance as long as that is small: it is
    taken off once. Draws are used with both signs, so that what is linear in the noise drops out.

    That linear part, draw by draw, is what the noise of this recording did to the coefficients by
    chance: its covariance replaces that of the residuals, which has as many degrees of freedom as
    a short recording has independent stretches. Noise in stretches that are not neighbours moves
    coefficients independently, so that products of such moves are excluded: the rest is as
    certain as several times as many draws would make it. Unless noise does not explain the errors
    of the equations (their size, or what they would do to the coefficients, beyond a chance of one
    in a thousand): noise that is not white, or a term that is missing. Then the standard errors of
    the residuals remain, and a warning says so.

    Smoothing takes out the same part of the motion in every recording. Motion that is smoothed once
    more shows what: the difference of the coefficients that fit it is taken off, too, as it is of
    every draw above, so that its noise is in the standard errors. By how much a third smoothing
    changes the difference is added to their squares. (Least-squares splines change what they have
    made less than they changed the true motion: of their bias a part remains, which this shows.)

    **Arguments**

    - `system`: without constants that are searched.
    - `recording`, `patterns`, `settings`, `fit`: the training recording, what `settings` made of
      it, and its fit. Masks and weights remain those of the fit.
    - `noise`: standard deviation of the white noise of columns, by name, 0 for the others; by
      default of `measurement_noise`.
    - `draws`: of simulated noise, for standard errors; fewer where noise makes next to nothing of
      the errors.
    - `pairs`: how many of them are fitted with both signs, for the bias.
    - `seed`: of the draws.

    **Returns** a `NoiseCorrection`.

    **Raises** `ValueError`: constants that are searched, noise of no column or below zero, fewer
    than two draws, fewer than one pair, or more pairs than draws; or noise that takes the recording
    out of what the equations allow, as a root of a level near zero.

    >>> import numpy as np, sympy, jaxcslc as jc
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable
    >>> from jaxcslc.systems import correct_for_noise, system_patterns
    >>> u, v, a = sympy.symbols("u v a")
    >>> line = System(
    ...     "line", {"v": sympy.Eq(v, a * u)},
    ...     (Variable(u, kind="state"), Variable(v)), (Constant(a),),
    ... )
    >>> time, random = np.arange(4000) * 0.1, np.random.default_rng(0)
    >>> columns = {"u": np.sin(time) + 0.5 * random.normal(size=4000), "v": 3 * np.sin(time)}
    >>> recording = SystemRecording(time, columns)
    >>> settings = jc.Settings(jc.Preparation(jc.SavitzkyGolay(7, 5)))
    >>> patterns = system_patterns(line, recording, settings.preparation)
    >>> fit = settings.fit(line.network, patterns)
    >>> correction = correct_for_noise(line, recording, patterns, settings, fit, {"u": 0.5})
    >>> round(float(fit.k[0]), 1), round(float(correction.fit.k[0]), 1)
    (2.4, 2.7)
    """
    if system.nonlinear:
        raise ValueError(
            f"{system.name}: constants are searched; expected a system that is linear in them all"
        )
    if not (draws >= 2 and 1 <= pairs <= draws):
        raise ValueError(
            f"draws is {draws}, pairs is {pairs}; expected two draws or more, and one pair or more"
            " but no more than draws"
        )
    solver, k = settings.solver, np.asarray(fit.k)
    levels = measurement_noise(system, recording) if noise == "estimated" else dict(noise or {})
    check_noise(system, levels)
    problem = WeightedEquations.of(solver.equations(system.network, patterns), k, solver)
    trim = (recording.samples - patterns.samples) // 2
    smoothing = SmoothingBias.of(system, settings, patterns, fit, trim)
    bias = (np.zeros_like(k),) * 2 if smoothing is None else smoothing.estimate()
    through = _Simulation(system, settings, patterns, smoothing, problem, k)
    noisy = lambda count: with_simulated_noise(recording, levels, count, seed)
    simulation = through.draws(noisy(draws), pairs)
    ratio, factor = judged_ratio(problem, fit, simulation.errors, recording.samples)
    warnings = unexplained(system.network, ratio, factor)
    if not warnings:
        of_fit = np.sqrt(np.mean(problem.shifts(simulation.errors) ** 2, axis=1))
        refitted = lambda count: map(through.refitted, noisy(count))
        warnings = lasting_errors(
            system.network, fit, of_fit, simulation.count, recording.samples, refitted
        )
    if np.any(ratio * factor < 1.0):  # noise that is too strong
        simulation = dataclasses.replace(simulation, even=np.zeros_like(simulation.even))
    of_level = level_error(recording.samples) if noise == "estimated" else 0.0
    determined = np.asarray(fit.determined)
    of_noise, of_smoothing, remainder = taken = [
        np.where(determined, x, 0.0) for x in (np.mean(simulation.even, axis=0), *bias)
    ]
    return NoiseCorrection(
        levels,
        of_noise,
        of_smoothing,
        remainder,
        np.sqrt(np.diag(simulation.covariance)),
        ratio,
        not warnings,
        simulation.count,
        _corrected(fit, problem, taken, None if warnings else simulation, of_level),
        tuple(warnings),
    )


@dataclasses.dataclass(frozen=True)
class Draws:
    """Effect of simulated noise on the coefficients.

    - `count`: of draws.
    - `errors`: of the equations, that the noise makes draw by draw; its linear part.
    - `linear`: (stretches, p, draws) changes of the corrected coefficients by the linear part, from
      the equations of stretches of the recording, of which only neighbours have errors in common.
    - `even`: (pairs, p) changes of the corrected coefficients that both signs of a draw share.
    """

    count: int
    errors: OfEquations
    linear: Float[np.ndarray, "stretches coefficients draws"]
    even: Float[np.ndarray, "pairs coefficients"]

    @property
    def products(self) -> Float[np.ndarray, "draws coefficients coefficients"]:
        """Draw by draw, what has the covariance of the linear part for its mean: products of
        changes by the same stretch and by neighbours."""
        around = self.linear.copy()
        around[1:] += self.linear[:-1]
        around[:-1] += self.linear[1:]
        products = np.einsum("spd,sqd->dpq", self.linear, around)
        whole = np.sum(self.linear, axis=0)
        size = np.sqrt(np.mean(whole**2, axis=1))
        scale = np.where(size > 0.0, size, 1.0)
        if np.linalg.eigvalsh(np.mean(products, axis=0) / np.outer(scale, scale))[0] < -_ROUNDING:
            # So few draws that this is no covariance. That of whole recordings always is.
            return np.einsum("pd,qd->dpq", whole, whole)
        return products

    @property
    def covariance(self) -> Float[np.ndarray, "coefficients coefficients"]:
        """Covariance of the corrected coefficients.

        It adds that of the linear part, that of the part of second order about its mean, and that
        of this mean over the pairs. The mean is taken off the coefficients.
        """
        covariance = np.mean(self.products, axis=0)
        pairs = len(self.even)
        if pairs > 1:
            about = self.even - np.mean(self.even, axis=0)
            covariance = covariance + about.T @ about / (pairs - 1) * (1.0 + 1.0 / pairs)
        return covariance

    @property
    def variance_error(self) -> Float[np.ndarray, " coefficients"]:
        """Relative standard error of the variances, by how they scatter over the draws."""
        squares = np.diagonal(self.products, axis1=1, axis2=2)
        error = np.std(squares, axis=0, ddof=1) / np.sqrt(self.count)
        return error / np.maximum(np.mean(squares, axis=0), np.finfo(float).tiny)


@dataclasses.dataclass(frozen=True)
class _Simulation:
    """Smoothing and fit that draws of noise are sent through.

    - `smoothing`: whose bias is taken off.
    - `problem`: the equations of the patterns, with the weights of the fit.
    - `k`: of the fit.
    """

    system: System
    settings: Settings
    patterns: Patterns
    smoothing: SmoothingBias | None
    problem: WeightedEquations
    k: Float[np.ndarray, " coefficients"]

    @property
    def edges(self) -> Int[np.ndarray, " edges"]:
        """Edges of long stretches of the patterns.

        Noise in a stretch changes only its own equations and those of its neighbours.
        """
        time, samples = np.asarray(self.patterns.time), self.patterns.samples
        states = max(len(self.system.states), 1)
        preparation = dataclasses.replace(self.settings.preparation, trim=None)
        reach = REACHES * preparation.trimmed_of(time, states)
        cutoff = self.settings.solver.cutoff
        if cutoff is not None:
            reach += int(np.ceil((len(time) - 1) / (cutoff * np.ptp(time))))
        stretches = min(samples // max(2 * reach, 1), _STRETCHES)
        return np.linspace(0, samples, max(stretches, 1) + 1).astype(int)

    def again(self, motion: Motion) -> Motion:
        """Motion smoothed once more, if smoothing's bias is taken off."""
        return motion if self.smoothing is None else self.smoothing.again(motion)

    def corrected(self, once: Motion, twice: Motion) -> np.ndarray:
        """Coefficients of motion smoothed once, without the bias of smoothing."""
        network = self.system.network
        patterns = with_motion(network, self.patterns, once)
        k = self.problem.solution(self.settings.solver.equations(network, patterns)).k
        if self.smoothing is None:
            return k
        return k - (self.smoothing.solution(twice) - self.smoothing.solution(once))

    def noisy(self, recording: SystemRecording) -> Motion:
        """The motion of a recording with further noise, at the samples of the patterns."""
        trim = (recording.samples - self.patterns.samples) // 2
        motion = system_derivatives(self.system, recording, self.settings.preparation)
        return np.stack(motion)[:, trim : recording.samples - trim]

    def refitted(self, recording: SystemRecording) -> Identification:
        """A fit whose errors are the linear part of further noise alone."""
        motion = stacked_motion(self.patterns)
        error = self.odd_error(motion, self.noisy(recording) - motion)
        output = self.system.network.torque(self.k, *motion)
        patterns = dataclasses.replace(self.patterns, torque=np.asarray(output) + error)
        return self.settings.solver.fit(self.system.network, patterns)

    def odd_error(self, motion: Motion, change: Motion) -> Float[np.ndarray, "samples equations"]:
        """Return the part of the equations' errors that changes sign with the motion's change."""
        error = np.asarray(_odd_error(self.system.network, self.k, motion, change))
        if not np.all(np.isfinite(error[np.asarray(self.patterns.mask)])):
            raise EquationsUndefined(
                f"{self.system.name}: further noise like the recording's takes it out of what the"
                " equations allow, as a root of a level near zero"
            )
        return error

    def filtered(
        self, patterns: Patterns, error: Float[np.ndarray, "samples equations"]
    ) -> list[Float[np.ndarray, "_ 1"]]:
        """Return the errors of one draw, filtered as the equations of patterns are."""
        equations = Equations.of(
            Unknowns(("draw",), ((0,),) * self.system.network.joint_count),
            error[..., None],
            np.zeros(error.shape),
            np.asarray(patterns.mask),
            time=np.asarray(patterns.time),
            cutoff=self.settings.solver.cutoff,
        )
        return [rows[:, :-1] for rows in equations.rows]

    def draws(self, recordings: Iterator[SystemRecording], pairs: int) -> Draws:
        """Send recordings with further noise through smoothing, smoothing once more, and the fit.

        The first `pairs` are fitted with both signs. No more follow if noise is next to nothing of
        the equations' errors: it needs no standard errors of its own.
        """
        once = stacked_motion(self.patterns)
        twice = self.again(once)
        before = self.corrected(once, twice)
        left = self.problem.equations.errors(self.k)
        errors: list[list[np.ndarray]] = []
        further: list[list[np.ndarray]] = []
        even: list[np.ndarray] = []
        for count, recording in enumerate(recordings):
            negligible = lambda: np.all(_ratio(_sizes(left), _sizes(_joined(errors))) > _NEGLIGIBLE)
            if count == pairs and negligible():
                break
            moved = self.noisy(recording)
            change, again = moved - once, self.again(moved) - twice
            error = self.odd_error(once, change)
            errors.append(self.filtered(self.patterns, error))
            if self.smoothing is not None:
                more = self.odd_error(twice, again) - error
                further.append(self.filtered(self.smoothing.patterns, more))
            if count < pairs:
                both = [
                    self.corrected(once + sign * change, twice + sign * again)
                    for sign in (1.0, -1.0)
                ]
                even.append(np.mean(both, axis=0) - before)
        made = _joined(errors)
        linear = self.problem.shifts_of_stretches(made, self.edges)
        if self.smoothing is not None:
            problem = self.smoothing.problem
            linear = linear - problem.shifts_of_stretches(_joined(further), self.edges)
        return Draws(len(errors), made, linear, np.array(even))


@eqx.filter_jit
def _odd_error(network: SystemNetwork, k: Any, motion: Any, change: Any) -> Array:
    """The part of the equations' error that changes its sign with the noise, (samples, n)."""
    plus, minus = (network.residual(k, *(motion + sign * change)) for sign in (1.0, -1.0))
    return (plus - minus) / 2.0


def _joined(draws: Sequence[Sequence[np.ndarray]]) -> OfEquations:
    """Return draws side by side."""
    return [np.concatenate(parts, axis=1) for parts in zip(*draws, strict=True)]


def _sizes(errors: Sequence[np.ndarray]) -> Float[np.ndarray, " equations"]:
    """Return the root mean square of each equation's errors."""
    return np.array([np.sqrt(np.mean(e**2)) if e.size else 0.0 for e in errors])


def _ratio(left: np.ndarray, made: np.ndarray) -> Float[np.ndarray, " equations"]:
    """Return what is left of equations over what noise makes; 1 where both are nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = left / made
    return np.where(np.isnan(ratio), 1.0, ratio)


def judged_ratio(
    problem: WeightedEquations, fit: Identification, made: OfEquations, samples: int
) -> tuple[Float[np.ndarray, " equations"], Float[np.ndarray, " equations"]]:
    """Compare the errors of equations with those that noise makes.

    The ratio is what is left of the equations over what fits leave of errors that noise makes. With
    it comes the factor by which the two may differ by chance.

    Each draw of noise is fitted like the recording: a fit of few independent errors leaves clearly
    less than there was. How much the draws' errors differ in size is the chance; it needs no model
    of how the errors are correlated, or of where in a recording they are large. That of the noise's
    level, which is estimated from so many samples, adds to it.
    """
    equations = problem.equations
    shifts = problem.shifts(made)
    after = [
        errors - rows[:, :-1] @ shifts[list(support)]
        for errors, rows, support in zip(
            made, equations.rows, equations.unknowns.support, strict=True
        )
    ]
    left = _sizes(equations.errors(np.asarray(fit.k)))
    sizes = np.array(
        [np.sqrt(np.mean(e**2, axis=0)) if e.size else np.zeros(e.shape[1]) for e in after]
    )
    typical = np.sqrt(np.mean(sizes**2, axis=1))
    quantile = scipy.special.ndtri(1.0 - _CHANCE / (2 * len(typical)))
    relative = sizes / np.where(typical > 0.0, typical, 1.0)[:, None]
    spread = np.std(np.log(np.maximum(relative, np.finfo(float).tiny)), axis=1)
    chance = np.sqrt(spread**2 * (1.0 + 1.0 / sizes.shape[1]) + level_error(samples) ** 2)
    return _ratio(left, typical), np.exp(quantile * chance)


def unexplained(
    network: SystemNetwork,
    ratio: Float[np.ndarray, " equations"],
    factor: Float[np.ndarray, " equations"],
) -> list[str]:
    """Return one sentence per equation whose errors noise does not explain by their size.

    - `ratio`, `factor`: as of `judged_ratio`.
    """
    warnings: list[str] = []
    for name, value, most in zip(network.output_names, ratio, factor, strict=True):
        if value * most < 1.0:
            warnings.append(
                f"{name}: its errors are {value:.2g} times those that the noise of the columns"
                " would make: no bias is taken off; expected noise that is white, or `noise` in"
                " its right strength"
            )
        elif value > most:
            warnings.append(
                f"{name}: its errors are {value:.3g} times those that the noise of the columns"
                " makes: a term may be missing, or smoothing takes out motion"
            )
    return warnings


def lasting_errors(
    network: SystemNetwork,
    fit: Identification,
    simulated: Float[np.ndarray, " coefficients"],
    draws: int,
    samples: int,
    refitted: Callable[[int], Iterator[Identification]],
) -> list[str]:
    """Return a sentence on the coefficient that long-lasting errors move most beyond noise, if any.

    They are seen by the standard error that residuals give it. Where this looks too large by
    Fisher's distribution, it is compared with those of fits of simulated noise: residuals that are
    large in a small part of a recording have fewer degrees of freedom than their number of cosine
    components.

    - `simulated`: standard errors that the noise makes in the fit, by so many draws.
    - `samples`: of the recording.
    - `refitted`: fits of so many draws of noise.
    """
    determined = np.asarray(fit.determined)
    # Standard errors for independent errors do not know how long smoothing makes them last.
    if fit.errors != "correlated" or not np.any(determined):
        return []
    larger = _enlargement(fit, simulated)
    limit = scipy.special.fdtri(
        float(fit.degrees_of_freedom), draws, 1.0 - _CHANCE / int(np.sum(determined))
    )
    if np.max(larger) ** 2 <= limit:
        return []
    logs = np.log([np.max(_enlargement(other, simulated)) for other in refitted(_REFITTED)])
    spread = np.hypot(np.std(logs, ddof=1), level_error(samples))
    quantile = scipy.special.stdtrit(_REFITTED - 1, 1.0 - _CHANCE)
    if np.log(np.max(larger)) <= np.mean(logs) + quantile * spread:
        return []
    return [
        f"{network.names[int(np.argmax(larger))]}: errors of the equations that last longer than"
        f" white noise make its standard error {np.max(larger):.2g} times larger: a term may be"
        " missing, or noise is correlated in time"
    ]


def _enlargement(
    fit: Identification, simulated: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, " coefficients"]:
    """Standard errors of residuals over those of simulated noise; 0 for what is not determined."""
    residual, determined = np.asarray(fit.standard_error), np.asarray(fit.determined)
    return np.where(determined, residual, 0.0) / np.maximum(simulated, np.finfo(float).tiny)


def _corrected(
    fit: Identification,
    problem: WeightedEquations,
    taken: Sequence[Float[np.ndarray, " coefficients"]],
    simulation: Draws | None,
    level_error: float,
) -> Identification:
    """The fit with other coefficients and standard errors.

    - `taken`: the bias of noise, that of smoothing, and what of that remains unknown.
    - `simulation`: whose standard errors are used; those of the residuals if None.
    - `level_error`: relative standard error of the noise that was simulated.
    """
    bias, smoothing, remainder = taken
    k = np.asarray(fit.k) - bias - smoothing
    covariance = np.asarray(fit.covariance) if simulation is None else simulation.covariance
    covariance = covariance + np.outer(remainder, remainder)
    error = np.where(np.asarray(fit.determined), np.sqrt(np.diag(covariance)), np.inf)
    factors = problem.equations.factors()
    changed: dict[str, Any] = {
        "k": jnp.asarray(k),
        "torque_error": jnp.asarray(factors.root_mean_squares(problem.equations.unknowns, k)),
        "covariance": jnp.asarray(covariance),
        "standard_error": jnp.asarray(error),
    }
    if simulation is not None:
        # A variance of so many degrees of freedom has a relative variance of two over them, and
        # varies by twice as much as the level of the noise.
        worst = np.max(simulation.variance_error, where=np.asarray(fit.determined), initial=0.0)
        relative = max(worst**2 + 4.0 * level_error**2, np.finfo(float).eps)
        changed |= {"degrees_of_freedom": jnp.asarray(2.0 / relative), "errors": "simulated"}
    return dataclasses.replace(fit, **changed)

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from ..identification import Identification, Settings
from ..identification.solver import Equations, Unknowns, WeightedEquations
from ..motion import Patterns
from ._measurement_noise import check_noise, measurement_noise, with_simulated_noise
from ._network import SystemNetwork
from ._patterns import system_derivatives
from ._recording import SystemRecording
from ._system import System


# A positive estimate of the noise of a column is good to about this part.
_LEVEL_ERROR = 0.05
# Chance by which a fit of equations that hold, with white noise, is said to have other errors.
_CHANCE = 0.001
# Errors of all equations that are so many times those that noise makes are not looked into further.
_NEGLIGIBLE = 30.0
# Draws whose motion is in memory at a time, in numbers.
_AT_ONCE = 1 << 22


class EquationsUndefined(ValueError):
    """Equations have no finite values where simulated noise takes a recording."""


Noise = Mapping[str, float] | Literal["estimated"] | None
"""Standard deviation of the noise of columns; or whether to estimate it."""


@dataclasses.dataclass(frozen=True)
class NoiseCorrection:
    """What measurement noise does to the coefficients of a system.

    **Attributes**

    - `noise`: standard deviation of the noise of each column, measured or assumed.
    - `bias`: (p,) what noise adds to each coefficient on average; taken off those of `fit`.
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
        share = float(np.max(np.abs(self.bias[known] / error[known]), initial=0.0))
        source = f"{self.draws} draws of this noise" if self.explained else "the residuals"
        return (
            f"noise of the columns: {noise}\nits bias is taken off: up to {share:.2g} standard"
            f" errors; standard errors from {source}"
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
    """Takes the bias of measurement noise off the coefficients of a system.

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
    a short recording has independent stretches. Unless noise does not explain the errors of the
    equations (their size, or what they would do to the coefficients, beyond a chance of one in a
    thousand): noise that is not white, or a term that is missing. Then the standard errors of the
    residuals remain, and a warning says so.

    **Arguments**

    - `system`: without constants that are searched.
    - `recording`, `patterns`, `settings`, `fit`: the training recording, what `settings` made of
      it, and its fit. Masks and weights remain those of the fit.
    - `noise`: standard deviation of the white noise of columns, by name, 0 for those left out;
      by default of `measurement_noise`.
    - `draws`: of simulated noise, for standard errors; fewer where noise makes next to nothing of
      the errors.
    - `pairs`: how many of them are fitted with both signs, for the bias.
    - `seed`: of the draws.

    **Returns** a `NoiseCorrection`.

    **Raises**

    - `ValueError`: constants that are searched, noise of no column or below zero, fewer than two
      draws, fewer than one pair, or more pairs than draws; or noise that takes the recording out of
      what the equations allow, as a root of a level near zero.

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
    network, solver, k = system.network, settings.solver, np.asarray(fit.k)
    levels = measurement_noise(system, recording) if noise == "estimated" else dict(noise or {})
    check_noise(system, levels)
    equations = solver.equations(network, patterns)
    problem = WeightedEquations.of(equations, k, solver)
    bias, parts = np.zeros(network.size), _Parts(network, patterns, solver.cutoff)
    motion = _motion(patterns)
    left = equations.errors(k)
    for number, noisy in enumerate(with_simulated_noise(recording, levels, draws, seed)):
        # Noise that is next to nothing of the errors needs no standard errors of its own.
        if number == pairs and np.all(_ratio(left, parts.filtered()) > _NEGLIGIBLE):
            draws = pairs
            break
        change = _change(system, noisy, settings, patterns)
        error = np.asarray(_odd_error(network, k, motion, change))
        if not np.all(np.isfinite(error[np.asarray(patterns.mask)])):
            raise EquationsUndefined(
                f"{system.name}: further noise like the recording's takes it out of what the"
                " equations allow, as a root of a level near zero"
            )
        for sign in (1.0, -1.0) if number < pairs else ():
            moved = _with_motion(network, patterns, motion, change, sign)
            bias += (problem.solution(solver.equations(network, moved)).k - k) / (2 * pairs)
        parts.add(error)
    filtered = parts.filtered()
    shifts = problem.shifts(filtered)
    return _corrected(
        network,
        fit,
        levels,
        np.where(np.asarray(fit.determined), bias, 0.0),
        shifts @ shifts.T / draws,
        _ratio(left, filtered),
        problem,
        draws,
    )


Motion = tuple[Array | np.ndarray, Array | np.ndarray, Array | np.ndarray]


def _motion(patterns: Patterns) -> Motion:
    return patterns.q, patterns.qd, patterns.qdd


def _change(
    system: System, noisy: SystemRecording, settings: Settings, patterns: Patterns
) -> Motion:
    """What further noise changes the motion of patterns by."""
    trim = (noisy.samples - patterns.samples) // 2
    inside = slice(trim, noisy.samples - trim)
    derivatives = system_derivatives(system, noisy, settings.preparation)
    q, qd, qdd = (
        values[inside] - np.asarray(before)
        for values, before in zip(derivatives, _motion(patterns), strict=True)
    )
    return q, qd, qdd


def _with_motion(
    network: SystemNetwork, patterns: Patterns, motion: Motion, change: Motion, sign: float
) -> Patterns:
    """The same samples with another motion, and the known sides that go with it."""
    q, qd, qdd = (
        np.asarray(x) + sign * np.asarray(dx) for x, dx in zip(motion, change, strict=True)
    )
    known = np.asarray(_known(network, q, qd, qdd))
    return dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=known)


@eqx.filter_jit
def _known(network: SystemNetwork, q: Any, qd: Any, qdd: Any) -> Array:
    return network.known(q, qd, qdd)


@eqx.filter_jit
def _odd_error(network: SystemNetwork, k: Any, motion: Motion, change: Motion) -> Array:
    """The part of the equations' error that changes its sign with the noise, (samples, n)."""
    plus, minus = (
        network.residual(k, *(x + sign * dx for x, dx in zip(motion, change, strict=True)))
        for sign in (1.0, -1.0)
    )
    return (plus - minus) / 2.0


class _Parts:
    """Errors of equations draw by draw, filtered as the equations are, some draws at a time."""

    def __init__(self, network: SystemNetwork, patterns: Patterns, cutoff: float | None) -> None:
        self.patterns, self.cutoff = patterns, cutoff
        self.joints = network.joint_count
        self.waiting: list[np.ndarray] = []
        self.done: list[tuple[np.ndarray, ...]] = []

    def add(self, error: Float[np.ndarray, "samples equations"]) -> None:
        """Errors of one draw."""
        self.waiting.append(error)
        if error.size * len(self.waiting) > _AT_ONCE:
            self._filter()

    def filtered(self) -> list[Float[np.ndarray, "_ draws"]]:
        """For each equation of the system (rows, draws)."""
        self._filter()
        return [np.concatenate(parts, axis=1) for parts in zip(*self.done, strict=True)]

    def _filter(self) -> None:
        if not self.waiting:
            return
        names = tuple(f"draw {number + 1}" for number in range(len(self.waiting)))
        patterns = self.patterns
        equations = Equations.of(
            Unknowns(names, (tuple(range(len(names))),) * self.joints),
            np.stack(self.waiting, axis=-1),
            np.zeros(patterns.torque.shape),
            np.asarray(patterns.mask),
            time=np.asarray(patterns.time),
            cutoff=self.cutoff,
        )
        self.done.append(tuple(rows[:, :-1] for rows in equations.rows))
        self.waiting = []


def _ratio(
    left: list[Float[np.ndarray, " _"]], made: list[Float[np.ndarray, "_ draws"]]
) -> Float[np.ndarray, " equations"]:
    """Root mean square of what is left of equations over that of what noise makes."""
    size = lambda x: float(np.sqrt(np.mean(x**2))) if x.size else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.array([size(e) for e in left]) / np.array([size(part) for part in made])
    return np.where(np.isnan(ratio), 1.0, ratio)


def _corrected(
    network: SystemNetwork,
    fit: Identification,
    levels: Mapping[str, float],
    bias: Float[np.ndarray, " coefficients"],
    covariance: Float[np.ndarray, "coefficients coefficients"],
    ratio: Float[np.ndarray, " equations"],
    problem: WeightedEquations,
    draws: int,
) -> NoiseCorrection:
    """The correction, as far as noise explains what is left of the equations."""
    chance = scipy.special.ndtri(1.0 - _CHANCE / (2 * len(ratio)))
    effective = np.maximum(np.asarray(fit.effective_equations), 1.0)
    limit = chance * np.sqrt(0.5 / effective + _LEVEL_ERROR**2)
    simulated = np.sqrt(np.diag(covariance))
    residual = np.asarray(fit.standard_error)
    determined = np.asarray(fit.determined)
    largest = scipy.special.fdtri(
        float(fit.degrees_of_freedom), draws, 1.0 - _CHANCE / max(int(np.sum(determined)), 1)
    )
    # Standard errors for independent errors do not know how long smoothing makes them last.
    further = determined & (fit.errors == "correlated") & (residual**2 > largest * simulated**2)
    warnings: list[str] = []
    for name, value, most in zip(network.output_names, ratio, limit, strict=True):
        if value < 1.0 - most:
            warnings.append(
                f"{name}: its errors are {value:.2g} times those that the noise of the columns"
                " would make: no bias is taken off; expected noise that is white, or `noise` in"
                " its right strength"
            )
        elif value > 1.0 + most:
            warnings.append(
                f"{name}: its errors are {value:.3g} times those that the noise of the columns"
                " makes: a term may be missing, or smoothing takes out motion"
            )
    if not warnings and np.any(further):
        larger = residual[further] / np.maximum(simulated[further], np.finfo(float).tiny)
        name = np.array(network.names)[further][np.argmax(larger)]
        warnings.append(
            f"{name}: errors of the equations that last longer than white noise make its standard"
            f" error {np.max(larger):.2g} times larger: a term may be missing, or noise is"
            " correlated in time"
        )
    too_strong = bool(np.any(ratio < 1.0 - limit))
    if too_strong:
        bias = np.zeros_like(bias)
    k = np.asarray(fit.k) - bias
    factors = problem.equations.factors()
    changed: dict[str, Any] = {
        "k": jnp.asarray(k),
        "torque_error": jnp.asarray(factors.root_mean_squares(problem.equations.unknowns, k)),
    }
    if not warnings:
        changed |= {
            "standard_error": jnp.asarray(np.where(determined, simulated, np.inf)),
            "covariance": jnp.asarray(covariance),
            "degrees_of_freedom": jnp.asarray(float(draws)),
            "errors": "simulated",
        }
    return NoiseCorrection(
        levels,
        bias,
        simulated,
        ratio,
        not warnings,
        draws,
        dataclasses.replace(fit, **changed),
        tuple(warnings),
    )

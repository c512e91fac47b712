"""Errors that simulated noise makes in equations and coefficients, and tests of them."""

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np
import scipy
from jaxtyping import Float

from ..least_squares import Equations, Identification, Unknowns, WeightedEquations
from ..recordings import Patterns
from ._measurement_noise import level_error
from ._network import SystemNetwork


# Chance by which a fit of equations that hold, with white noise, is said to have other errors.
_CHANCE = 0.001
# Fits of noise alone that show how far the standard errors of residuals scatter.
_REFITTED = 40
# Of eigenvalues of a matrix whose diagonal is near one.
_ROUNDING = 1e-9
# Draws whose motion is in memory at a time, in numbers.
_AT_ONCE = 1 << 22

OfEquations = list[Float[np.ndarray, "_ draws"]]
"""For each equation of the system, changes of its rows draw by draw."""


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


class FilteredErrors:
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

    def filtered(self) -> OfEquations:
        """Return the filtered errors of each equation of the system, (rows, draws)."""
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


def error_ratio(
    left: list[Float[np.ndarray, " _"]], made: OfEquations
) -> Float[np.ndarray, " equations"]:
    """Root mean square of what is left of equations over that of what noise makes."""
    return _ratio(np.array([_size(e) for e in left]), np.array([_size(part) for part in made]))


def _size(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2))) if errors.size else 0.0


def _ratio(left: np.ndarray, made: np.ndarray) -> np.ndarray:
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
    left = np.array([_size(e) for e in equations.errors(np.asarray(fit.k))])
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
    ratio = np.where(determined, residual, 0.0) / np.maximum(simulated, np.finfo(float).tiny)
    return np.where(determined, ratio, 0.0)

from typing import Literal, NamedTuple, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._factors import JointFactors, Unknowns
from ._fixed import Fixed
from ._identification import RESULTS, Identification
from ._minimum import Solution
from ._rows import AbstractRows, CosineSums


Errors = Literal["independent", "correlated"]
ERRORS: tuple[str, ...] = get_args(Errors)

# Every cosine component adds one degree of freedom to the variance of a sum: with more than these,
# Student's t hardly differs from a normal distribution; with fewer, intervals are wide and
# uncertain themselves.
COMPONENTS = 32
_FEWEST_COMPONENTS = 8
# A fit that leaves less of the noise than this part has as good as no residuals.
_LEAST_LEFT = 0.05
# Autocorrelation further apart than this part of the recording is mostly chance.
_FURTHEST = 4


class Residuals(NamedTuple):
    """What the errors of a fit are judged by: its solution, the weights of joints that went with
    it, and (instants, n) residuals, of a robust loss those of its pseudo-values."""

    solution: Solution
    weights: Float[Array, " joints"]
    residual: Float[Array, "instants joints"]


def ordinary_residuals(
    rows: AbstractRows, solution: Solution, weights: Float[Array, " joints"]
) -> Residuals:
    """Of a fit that minimised squares."""
    error = rows.counts * (rows.torque - rows.predicted(solution.k))
    return Residuals(solution, weights, error)


def identification_of(
    unknowns: Unknowns,
    factors: JointFactors,
    solution: Solution,
    covariance: Float[Array, "coefficients coefficients"],
    *,
    degrees_of_freedom: Float[Array, ""],
    effective: Float[Array | np.ndarray, " joints"],
    errors: str,
    fixed: Fixed | None = None,
) -> Identification:
    """The result of a fit; `factors` are those of all equations that take part, unweighted.

    Errors of fixed coefficients are independent of those of this recording: covariances add up.
    """
    fitted = unknowns.size if fixed is None else len(fixed.free)
    equations = jnp.sum(factors.counts)
    result = RESULTS.where(solution.rank < fitted, RESULTS.rank_deficient, RESULTS.successful)
    result = RESULTS.where(equations < fitted, RESULTS.no_equations, result)
    result = RESULTS.where(solution.finite, result, RESULTS.nonfinite)
    independent = solution.variance * solution.inverse_gram
    if fixed is not None and solution.inherited is not None:
        inherited = solution.inherited
        covariance = covariance + inherited @ fixed.covariance @ inherited.T
        independent = independent + inherited @ fixed.independent_covariance @ inherited.T
        degrees_of_freedom = jnp.minimum(degrees_of_freedom, fixed.degrees_of_freedom)
    return Identification(
        k=jnp.asarray(solution.k),
        standard_error=jnp.where(solution.determined, jnp.sqrt(jnp.diag(covariance)), jnp.inf),
        covariance=jnp.asarray(covariance),
        independent_covariance=jnp.asarray(independent),
        torque_error=jnp.asarray(factors.root_mean_squares(unknowns, solution.k)),
        equations=jnp.asarray(factors.counts),
        effective_equations=jnp.asarray(effective),
        degrees_of_freedom=jnp.asarray(degrees_of_freedom),
        rank=jnp.asarray(solution.rank),
        condition=jnp.asarray(solution.condition),
        undetermined=jnp.asarray(solution.undetermined),
        determined=jnp.asarray(solution.determined),
        result=result,
        names=unknowns.names,
        errors=errors,
    )


def independent_errors(
    unknowns: Unknowns, factors: JointFactors, solution: Solution, fixed: Fixed | None = None
) -> Identification:
    """The fit with standard errors that allow for independent errors of one variance."""
    return identification_of(
        unknowns,
        factors,
        solution,
        solution.variance * solution.inverse_gram,
        degrees_of_freedom=jnp.maximum(jnp.sum(factors.counts) - solution.rank, 1.0),
        effective=factors.counts,
        errors="independent",
        fixed=fixed,
    )


def with_errors(
    rows: AbstractRows,
    factors: JointFactors,
    residuals: Residuals,
    errors: Errors,
    fixed: Fixed | None = None,
) -> Identification:
    """The fit with standard errors that allow for independent or for correlated errors."""
    solution, weights, residual = residuals
    if errors == "independent":
        return independent_errors(rows.unknowns, factors, solution, fixed)
    effective = effective_counts(residual, rows.counts)
    used = components_for(effective)
    sums = rows.cosine_sums(weights[None, :] ** 2 * residual, weights, used)
    covariance = correlated_covariance(sums, solution.inverse_gram, used)
    return identification_of(
        rows.unknowns,
        factors,
        solution,
        covariance,
        degrees_of_freedom=jnp.sum(used),
        effective=effective,
        errors=errors,
        fixed=fixed,
    )


def effective_counts(
    error: Float[Array, "instants joints"], counts: Float[Array, "instants joints"]
) -> Float[Array, " joints"]:
    """How many independent errors each joint's errors are worth.

    Their number over the sum of all their squared autocorrelations: the degrees of freedom that
    an estimate of their variance has (Bartlett 1946; Bayley and Hammersley 1946). It does not
    matter whether smoothing has taken out the quick noise or the slow: what counts is how much of
    the band is left.

    >>> import jax.numpy as jnp, numpy as np
    >>> white = np.random.default_rng(0).normal(size=(4000, 1))
    >>> alike = np.repeat(white[:1000], 4, axis=0)
    >>> both = jnp.asarray(np.concatenate([white, alike], axis=1))
    >>> few, many = sorted(float(n) for n in effective_counts(both, jnp.ones(both.shape)))
    >>> bool(3500 < many <= 4000 and 1200 < few < 1800)
    True
    """
    instants = error.shape[0]
    # Twice the length, so that the ends do not meet.
    power = lambda x: jnp.abs(jnp.fft.rfft(x, 2 * instants, axis=0)) ** 2
    lagged = lambda x: jnp.fft.irfft(power(x), 2 * instants, axis=0)[:instants]
    pairs = jnp.round(lagged(counts))
    products = lagged(error * counts)
    variance = products[0] / jnp.maximum(pairs[0], 1.0)
    scale = jnp.where(variance > 0.0, variance, 1.0)
    # Zeros behind the end are no part of the recording.
    lag = jnp.arange(instants)
    end = jnp.max(jnp.where(jnp.any(counts > 0.0, axis=1), lag + 1, 0))
    used = ((lag > 0) & (_FURTHEST * lag < end))[:, None] & (pairs > 0.5)
    number = jnp.maximum(pairs, 1.0)
    square = jnp.sum(jnp.where(used, (products / number / scale[None, :]) ** 2, 0.0), axis=0)
    # By chance alone, each square is this sum over the number of pairs (Bartlett): taken off.
    chance = jnp.sum(jnp.where(used, 1.0 / number, 0.0), axis=0)
    total = jnp.maximum((1.0 + 2.0 * square) / (1.0 + 2.0 * chance), 1.0)
    return pairs[0] / jnp.where(variance > 0.0, total, 1.0)


def components_for(effective: Float[Array, " joints"]) -> Float[Array, " components"]:
    """Which cosine components to average over: 1 for the lowest ones, 0 for the others.

    Lazarus, Lewis, Stock and Watson's 0.4 N^(2/3), of the joint with the least effective count N.
    """
    some = jnp.where(effective > 0.0, effective, jnp.inf)
    least = jnp.where(jnp.any(effective > 0.0), jnp.min(some), 1.0)
    number = jnp.clip(jnp.round(0.4 * least ** (2.0 / 3.0)), _FEWEST_COMPONENTS, COMPONENTS)
    return (jnp.arange(1, COMPONENTS + 1) <= number).astype(float)


def correlated_covariance(
    sums: CosineSums,
    inverse_gram: Float[Array, "coefficients coefficients"],
    used: Float[Array, " components"],
) -> Float[Array, "coefficients coefficients"]:
    """The covariance of a fit whose errors are correlated in time and across joints.

    The error of a fit is a sum over time, of the scores of each instant's errors of all joints.
    The variance of a sum of correlated terms is the height of their spectrum at
    frequency zero. Here it is the mean over the lowest cosine components: the 'equal-weighted
    cosine' estimator (Müller 2004; Phillips 2005; Lazarus, Lewis, Stock and Watson, 'HAR
    inference: recommendations for practice', JBES 2018, doi:10.1080/07350015.2018.1506926). It is
    never negative, needs no model of the noise, whose strength may vary with the motion, and
    each component is one degree of freedom, so that Student's t with their number is the right
    distribution.

    A fit reduces its residuals most in the components that look like its regressor's columns, the
    more the shorter a recording is. The share of white noise that a fit leaves is known, component
    by component; every standard error is divided by its root, which makes the variances unbiased
    for white noise.

    (On simulated PUMA 560 recordings with quantised encoders, kernel estimators of Newey and
    West's kind gave standard errors 10 to 20 % too small; the usual ones, for independent noise,
    were up to twice too large: what is left of quantisation noise in accelerations is mostly
    quick, and filters on both sides take it out.)

    **Arguments**

    - `sums`: of the equations and their weighted residuals.
    - `inverse_gram`: (p, p), the inverse of the weighted regressor's Gram matrix.
    - `used`: of `components_for`.
    """
    number = jnp.sum(used)
    off = sums.sums @ inverse_gram
    covariance = off.T @ off / number
    # Of unit white noise: what the components have before the fit, and what it takes off them.
    before = jnp.sum((inverse_gram @ sums.power) * inverse_gram.T, axis=1)
    bent = jnp.matmul(sums.grams, inverse_gram[None]) @ sums.grams
    taken = jnp.sum((inverse_gram @ jnp.sum(bent, axis=0)) * inverse_gram.T, axis=1)
    whole = number * jnp.diag(inverse_gram)
    left = jnp.where(whole > 0.0, (before - taken) / jnp.where(whole > 0.0, whole, 1.0), 1.0)
    # Where next to nothing is left, nothing can be said; a floor keeps it finite.
    root = jnp.sqrt(jnp.maximum(left, _LEAST_LEFT))
    return covariance / root[:, None] / root[None, :]

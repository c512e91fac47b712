"""Standard errors of a fit for independent errors, or for errors correlated in time."""

from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from .._environment import array_namespace, as_jax
from ._factors import JointFactors, Unknowns
from ._fixed import Fixed
from ._identification import RESULTS, Identification
from ._minimum import Numbers, Solution
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


class FitResiduals(NamedTuple):
    """Solution of a fit, the weights of joints that went with it, and its residuals.

    Residuals have shape (instants, n); those of a robust loss are of its pseudo-values.
    """

    solution: Solution
    weights: Float[Numbers, " joints"]
    residual: Float[Numbers, "instants joints"]


def ordinary_residuals(
    rows: AbstractRows, solution: Solution, weights: Float[Numbers, " joints"]
) -> FitResiduals:
    """Return the residuals of a fit that minimised squares."""
    error = rows.counts * (rows.torque - rows.predicted(solution.k))
    return FitResiduals(solution, weights, error)


def identification_of(
    unknowns: Unknowns,
    factors: JointFactors,
    solution: Solution,
    covariance: Float[Numbers, "coefficients coefficients"],
    *,
    degrees_of_freedom: Float[Numbers, ""],
    effective: Float[Numbers, " joints"],
    errors: str,
    fixed: Fixed | None = None,
) -> Identification:
    """The result of a fit; `factors` are those of all equations that take part, unweighted.

    Errors of fixed coefficients are independent of those of this recording: covariances add up.
    """
    xp = array_namespace(solution.k, covariance)
    fitted = unknowns.size if fixed is None else len(fixed.free)
    equations = xp.sum(factors.counts)
    result = _result(solution.rank < fitted, equations < fitted, solution.finite)
    independent = solution.variance * solution.inverse_gram
    if fixed is not None and solution.inherited is not None:
        inherited = solution.inherited
        covariance = covariance + inherited @ fixed.covariance @ inherited.T
        independent = independent + inherited @ fixed.independent_covariance @ inherited.T
        degrees_of_freedom = xp.minimum(degrees_of_freedom, fixed.degrees_of_freedom)
    deviation = xp.sqrt(xp.diag(covariance))
    # Put on the device together: one by one they take longer than the decomposition.
    arrays: dict[str, Any] = as_jax(
        {
            "k": solution.k,
            "standard_error": xp.where(solution.determined, deviation, np.inf),
            "covariance": covariance,
            "independent_covariance": independent,
            "torque_error": factors.root_mean_squares(unknowns, solution.k),
            "equations": factors.counts,
            "effective_equations": effective,
            "degrees_of_freedom": degrees_of_freedom,
            "rank": solution.rank,
            "condition": solution.condition,
            "undetermined": solution.undetermined,
            "determined": solution.determined,
        }
    )
    return Identification(**arrays, result=result, names=unknowns.names, errors=errors)


def _result(rank_deficient: Any, too_few: Any, finite: Any) -> RESULTS:
    """Return the outcome of a fit from the faults that it has."""
    cases = (
        (rank_deficient, RESULTS.rank_deficient),
        (too_few, RESULTS.no_equations),
        (~finite, RESULTS.nonfinite),
    )
    result = RESULTS.successful
    for case, meaning in cases:
        if isinstance(case, Tracer):
            result = RESULTS.where(case, meaning, result)
        elif case:
            result = meaning
    return result


def independent_errors(
    unknowns: Unknowns, factors: JointFactors, solution: Solution, fixed: Fixed | None = None
) -> Identification:
    """The fit with standard errors that allow for independent errors of one variance."""
    xp = array_namespace(factors.counts, solution.k)
    return identification_of(
        unknowns,
        factors,
        solution,
        solution.variance * solution.inverse_gram,
        degrees_of_freedom=xp.maximum(xp.sum(factors.counts) - solution.rank, 1.0),
        effective=factors.counts,
        errors="independent",
        fixed=fixed,
    )


def with_errors(
    rows: AbstractRows,
    factors: JointFactors,
    residuals: FitResiduals,
    errors: Errors,
    fixed: Fixed | None = None,
) -> Identification:
    """The fit with standard errors that allow for independent or for correlated errors."""
    solution, weights, residual = residuals
    if errors == "independent":
        return independent_errors(rows.unknowns, factors, solution, fixed)
    effective = effective_counts(residual, rows.counts)
    used = components_for(effective)
    if isinstance(used, np.ndarray):  # sums of the others would be zeros
        used = used[used > 0]
    sums = rows.cosine_sums(weights[None, :] ** 2 * residual, weights, used)
    covariance = correlated_covariance(sums, solution.inverse_gram, used)
    return identification_of(
        rows.unknowns,
        factors,
        solution,
        covariance,
        degrees_of_freedom=used.sum(),
        effective=effective,
        errors=errors,
        fixed=fixed,
    )


def effective_counts(
    error: Float[Numbers, "instants joints"], counts: Float[Numbers, "instants joints"]
) -> Float[Numbers, " joints"]:
    """Return the number of independent errors that each joint's errors are worth.

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
    xp = array_namespace(error, counts)
    instants = error.shape[0]
    # Twice the length, so that the ends do not meet; a power of two is transformed quickly.
    length = 1 << (2 * instants - 1).bit_length()
    power = lambda x: xp.abs(xp.fft.rfft(x, length, axis=0)) ** 2
    lagged = lambda x: xp.fft.irfft(power(x), length, axis=0)[:instants]
    pairs = xp.round(lagged(counts))
    products = lagged(error * counts)
    variance = products[0] / xp.maximum(pairs[0], 1.0)
    scale = xp.where(variance > 0.0, variance, 1.0)
    # Zeros behind the end are no part of the recording.
    lag = xp.arange(instants)
    end = xp.max(xp.where(xp.any(counts > 0.0, axis=1), lag + 1, 0))
    used = ((lag > 0) & (_FURTHEST * lag < end))[:, None] & (pairs > 0.5)
    number = xp.maximum(pairs, 1.0)
    square = xp.sum(xp.where(used, (products / number / scale[None, :]) ** 2, 0.0), axis=0)
    # By chance alone, each square is this sum over the number of pairs (Bartlett): taken off.
    chance = xp.sum(xp.where(used, 1.0 / number, 0.0), axis=0)
    total = xp.maximum((1.0 + 2.0 * square) / (1.0 + 2.0 * chance), 1.0)
    return pairs[0] / xp.where(variance > 0.0, total, 1.0)


def components_for(effective: Float[Numbers, " joints"]) -> Float[Numbers, " components"]:
    """Select the cosine components to average over: 1 for the lowest ones, 0 for the others.

    Lazarus, Lewis, Stock and Watson's 0.4 N^(2/3), of the joint with the least effective count N.
    """
    xp = array_namespace(effective)
    some = xp.where(effective > 0.0, effective, xp.inf)
    least = xp.where(xp.any(effective > 0.0), xp.min(some), 1.0)
    number = xp.clip(xp.round(0.4 * least ** (2.0 / 3.0)), _FEWEST_COMPONENTS, COMPONENTS)
    return (xp.arange(1, COMPONENTS + 1) <= number).astype(float)


def correlated_covariance(
    sums: CosineSums,
    inverse_gram: Float[Numbers, "coefficients coefficients"],
    used: Float[Numbers, " components"],
) -> Float[Numbers, "coefficients coefficients"]:
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
    xp = array_namespace(inverse_gram)
    number = xp.sum(used)
    off = sums.sums @ inverse_gram
    covariance = off.T @ off / number
    # Of unit white noise: what the components have before the fit, and what it takes off them.
    before = xp.sum((inverse_gram @ sums.power) * inverse_gram.T, axis=1)
    bent = xp.matmul(sums.grams, inverse_gram[None]) @ sums.grams
    taken = xp.sum((inverse_gram @ xp.sum(bent, axis=0)) * inverse_gram.T, axis=1)
    whole = number * xp.diag(inverse_gram)
    left = xp.where(whole > 0.0, (before - taken) / xp.where(whole > 0.0, whole, 1.0), 1.0)
    # Where next to nothing is left, nothing can be said; a floor keeps it finite.
    root = xp.sqrt(xp.maximum(left, _LEAST_LEFT))
    return covariance / root[:, None] / root[None, :]

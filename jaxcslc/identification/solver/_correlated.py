from typing import Literal, get_args

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._rows import Waves


Errors = Literal["independent", "correlated"]
ERRORS: tuple[str, ...] = get_args(Errors)

# Of the variance of a sum, every cosine tells one degree of freedom: with more than these,
# Student's t hardly differs from a normal distribution; with fewer, intervals are wide and tell
# little of themselves.
WAVES = 32
_FEWEST_WAVES = 8
# A fit that leaves less of the noise than this part has as good as no residuals.
_LEAST_LEFT = 0.05
# Autocorrelation further apart than this part of the recording is mostly chance.
_FURTHEST = 4


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


def waves_for(effective: Float[Array, " joints"]) -> Float[Array, " waves"]:
    """Which cosines to average over, 1 for each that counts, the lowest ones.

    Lazarus, Lewis, Stock and Watson's 0.4 N^(2/3), of the joint with the least effective count N.
    """
    some = jnp.where(effective > 0.0, effective, jnp.inf)
    least = jnp.where(jnp.any(effective > 0.0), jnp.min(some), 1.0)
    number = jnp.clip(jnp.round(0.4 * least ** (2.0 / 3.0)), _FEWEST_WAVES, WAVES)
    return (jnp.arange(1, WAVES + 1) <= number).astype(float)


def correlated_covariance(
    waves: Waves,
    inverse_gram: Float[Array, "coefficients coefficients"],
    used: Float[Array, " waves"],
) -> Float[Array, "coefficients coefficients"]:
    """The covariance of a fit whose errors are correlated in time and across joints.

    A fit's error is the sum over time of what each instant's errors, of all joints, pull at the
    coefficients. The variance of a sum of correlated terms is the height of their spectrum at
    frequency zero. Here it is the mean over the lowest cosine components: the 'equal-weighted
    cosine' estimator (Müller 2004; Phillips 2005; Lazarus, Lewis, Stock and Watson, 'HAR
    inference: recommendations for practice', JBES 2018, doi:10.1080/07350015.2018.1506926). It is
    never negative, needs no model of the noise, whose strength may vary with the motion, and
    each component is one degree of freedom, so that Student's t with their number is the right
    distribution.

    A fit takes most off its residuals where it can bend to them: in the components that look like
    its own columns, the more the shorter a recording is. What is left of white noise after a fit
    is known, component by component; every standard error is divided by the root of it, which
    makes the variances unbiased for white noise.

    (On simulated PUMA 560 recordings with quantised encoders, kernel estimators of Newey and
    West's kind gave standard errors 10 to 20 % too small; the usual ones, for independent noise,
    were up to twice too large: what is left of quantisation noise in accelerations is mostly
    quick, and filters on both sides take it out.)

    **Arguments**

    - `waves`: of the equations, pulled at by their weighted residuals.
    - `inverse_gram`: (p, p), the inverse of the weighted regressor's Gram matrix.
    - `used`: of `waves_for`.
    """
    number = jnp.sum(used)
    off = waves.sums @ inverse_gram
    covariance = off.T @ off / number
    # Of unit white noise: what the components have before the fit, and what it takes off them.
    before = jnp.sum((inverse_gram @ waves.power) * inverse_gram.T, axis=1)
    bent = jnp.matmul(waves.grams, inverse_gram[None]) @ waves.grams
    taken = jnp.sum((inverse_gram @ jnp.sum(bent, axis=0)) * inverse_gram.T, axis=1)
    whole = number * jnp.diag(inverse_gram)
    left = jnp.where(whole > 0.0, (before - taken) / jnp.where(whole > 0.0, whole, 1.0), 1.0)
    # Where next to nothing is left, nothing can be said; a floor keeps it finite.
    root = jnp.sqrt(jnp.maximum(left, _LEAST_LEFT))
    return covariance / root[:, None] / root[None, :]

"""A second pass over the equations of a fit: residuals, and standard errors of correlated errors.

`Rows` read the equations chunk by chunk, kept or computed again. `_losses` has a use for them, too.
"""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

from .._environment import array_namespace, as_jax
from .._processes import over_chunks
from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._columns import columns_of, rows_of, torque_by, traced
from ._equations import Equations
from ._factors import JointFactors, Unknowns, joined_factors
from ._identification import RESULTS, Identification
from ._minimum import Fixed, Numbers, Solution


Errors = Literal["independent", "correlated"]
"""Models of the residuals' errors, for standard errors."""
ERRORS: tuple[str, ...] = get_args(Errors)
Result = TypeVar("Result")

# Every cosine component adds one degree of freedom to the variance of a sum: with more than these,
# Student's t barely differs from a normal distribution; with fewer, intervals are wide and
# uncertain themselves.
COMPONENTS = 32
_FEWEST_COMPONENTS = 8
# A fit that leaves less of the noise than this part has as good as no residuals.
LEAST_LEFT = 0.05
# Autocorrelation further apart than this part of the recording is mostly chance.
_FURTHEST = 4
# Half a block in the phase of the highest cosine [rad], and powers of the time within a block that
# a cosine is interpolated by: to 0.25^7 / (2^6 7!) = 2e-10.
_HALF_BLOCK = 0.25
_POWERS = 7
# Instants that a core takes at a time: a Panda's columns of them take 12 MB.
_CHUNK = 8192


@dataclasses.dataclass(frozen=True)
class Rows:
    """The equations of a fit: one of each joint at each instant. NumPy's arrays, or traced ones.

    **Attributes**

    - `unknowns`: the coefficients.
    - `torque`: (instants, n), the right-hand sides [N m or N].
    - `counts`: (instants, n) 1 for an equation that takes part, 0 for one that does not.
    - `phase`: (instants,), the time of an instant over the length of the recording.
    - `columns`: a function of a slice of instants that gives each joint's columns, (s, instants).
    """

    unknowns: Unknowns
    torque: Float[Numbers, "instants joints"]
    counts: Float[Numbers, "instants joints"]
    phase: Float[np.ndarray, " instants"]
    columns: Callable[[slice], tuple[Any, ...]]

    @classmethod
    def from_equations(cls, equations: Equations, samples: int) -> "Rows":
        """Join the equations of several joints at each instant of a recording of `samples`."""
        kept, indices = equations.instants()
        torque, counts = np.zeros((2, len(kept), len(equations.rows)))
        columns: list[np.ndarray] = []
        for joint, (rows, at) in enumerate(zip(equations.rows, indices, strict=True)):
            filled = np.zeros((rows.shape[1] - 1, len(kept)))
            filled[:, at], torque[at, joint], counts[at, joint] = rows[:, :-1].T, rows[:, -1], 1.0
            columns.append(filled)
        phase = (kept + 0.5) / samples
        read = lambda part: tuple(of_joint[:, part] for of_joint in columns)
        return cls(equations.unknowns, torque, counts, phase, read)

    @classmethod
    def from_patterns(cls, network: AbstractLinearNetwork, patterns: Patterns) -> "Rows":
        """Take patterns whose columns are computed again in each pass, or are traced."""
        phase = (np.arange(len(patterns.q)) + 0.5) / len(patterns.q)
        if traced((network, patterns)):
            patterns = jax.tree.map(jnp.asarray, patterns)
            whole = network.columns(patterns.q.T, patterns.qd.T, patterns.qdd.T)
            read = lambda part: tuple(of_joint[:, part] for of_joint in whole)
        else:
            read = lambda part: columns_of(network, rows_of(patterns, part))
            patterns = jax.tree.map(np.asarray, patterns)
        counts = patterns.mask.astype(float)
        return cls(Unknowns.of(network), patterns.torque, counts, phase, read)

    def factors(self, weight: Float[Numbers, "instants joints"]) -> JointFactors:
        """Return the factors of the equations that take part, both sides multiplied by `weight`."""

        def of_chunk(part: slice) -> JointFactors:
            weights = self.counts[part] * weight[part]
            xp = array_namespace(weights)
            rows = (
                xp.concatenate([columns, self.torque[part, j][None]]) * weights[None, :, j]
                for j, columns in enumerate(self.columns(part))
            )
            return JointFactors.from_rows(
                tuple(x.T for x in rows), 1.0 * xp.sum(weights != 0, axis=0)
            )

        parts = self._over_chunks(of_chunk)
        return parts[0] if len(parts) == 1 else joined_factors(parts)

    def residuals(self, k: Float[Numbers, " coefficients"]) -> Float[Numbers, "instants joints"]:
        """Return the errors that `k` leaves in the equations that take part, 0 in the others."""
        support = self.unknowns.support
        parts = self._over_chunks(lambda part: torque_by(support, self.columns(part), k))
        return self.counts * (self.torque - array_namespace(*parts).concatenate(parts))

    def cosine_sums(
        self,
        residual: Float[Numbers, "instants joints"],
        weights: Float[Numbers, " joints"],
        used: Float[Numbers, " components"],
    ) -> "CosineSums":
        """Return sums over all instants, each multiplied by cosines of time.

        - `residual`: weighted, what multiplies each row in `CosineSums.sums`.
        - `weights`: of joints.
        - `used`: 1 for the cosine components that take part, the lowest ones.
        """
        size, components = self.unknowns.size, len(used)
        number = np.arange(1, components + 1)

        def of_chunk(part: slice) -> CosineSums:
            phase = self.phase[part]
            cosines = (
                used[:, None] * np.sqrt(2.0) * np.cos(np.pi * number[:, None] * phase[None, :])
            )
            square = (cosines**2).sum(axis=0)
            total = CosineSums.empty(size, components)
            for joint, (support, rows) in enumerate(
                zip(self.unknowns.support, self.columns(part), strict=True)
            ):
                weight = self.counts[part, joint] * weights[joint] ** 2
                place = np.eye(size)[list(support)]
                if isinstance(rows, np.ndarray):
                    grams = used[:, None, None] * cosine_grams(rows, weight, phase, components)
                else:
                    grams = jax.lax.map(
                        lambda x, r=rows, w=weight: ((x * w)[None, :] * r) @ r.T, cosines
                    )
                total = CosineSums(
                    total.sums + (cosines * residual[None, part, joint]) @ rows.T @ place,
                    total.grams + place.T[None] @ grams @ place[None],
                    total.power + place.T @ (((weight * square)[None, :] * rows) @ rows.T) @ place,
                )
            return total

        return CosineSums(*map(sum, zip(*self._over_chunks(of_chunk), strict=True)))

    def _over_chunks(self, function: Callable[[slice], Result]) -> list[Result]:
        instants = len(self.torque)
        if isinstance(self.torque, Tracer):  # which belong to one thread
            return [function(slice(0, instants))]
        return over_chunks(lambda first, last: function(slice(first, last)), instants, _CHUNK)


class CosineSums(NamedTuple):
    """Sums over all instants, each multiplied by a cosine of a number of half periods.

    - `sums`: (components, p), of the regressor rows times the weighted residuals.
    - `grams`: (components, p, p), of the outer products of weighted rows with themselves.
    - `power`: (p, p), the same times the sum of the squares of the cosines that take part.
    """

    sums: Float[Numbers, "components coefficients"]
    grams: Float[Numbers, "components coefficients coefficients"]
    power: Float[Numbers, "coefficients coefficients"]

    @classmethod
    def empty(cls, size: int, components: int) -> "CosineSums":
        """Return the sums over no instants."""
        shapes = (components, size), (components, size, size), (size, size)
        return cls(*map(np.zeros, shapes))


def cosine_grams(
    rows: Float[np.ndarray, "columns instants"],
    weight: Float[np.ndarray, " instants"],
    phase: Float[np.ndarray, " instants"],
    components: int,
) -> Float[np.ndarray, "components columns columns"]:
    r"""Return products of weighted columns with each other, times a cosine, summed over time.

    $\sqrt 2 \sum_t \cos(c \pi \varphi_t)\, w_t\, r_t r_t^T$ for $c = 1, 2, \dots$ Within a block
    of time in which the highest cosine barely turns, all of them are polynomials of time: a few
    moments of the block's products serve all components. That takes a third of the
    multiplications of all components one by one, and no memory for products of pairs of columns.

    **Arguments**

    - `rows`, `weight`: of each instant.
    - `phase`: the time of an instant over the length of the recording, ascending.
    - `components`: how many cosines.
    """
    size, count = len(rows), int(np.ceil(components * np.pi / (2.0 * _HALF_BLOCK)))
    block = np.minimum((phase * count).astype(int), count - 1)
    shares = _shares(components, count)
    within = 2.0 * count * phase - (2.0 * block + 1.0)
    powers = weight * np.vander(within, _POWERS, increasing=True).T
    result = np.zeros((components, size * size))
    edges = np.searchsorted(block, np.arange(block[0], block[-1] + 2)) if block.size else [0]
    for number, (start, stop) in enumerate(pairwise(edges), int(block[0]) if block.size else 0):
        scaled = powers[:, None, start:stop] * rows[:, start:stop]
        moments = scaled.reshape(_POWERS * size, -1) @ rows[:, start:stop].T
        result += shares[:, number] @ moments.reshape(_POWERS, -1)
    return result.reshape(components, size, size)


def _shares(components: int, count: int) -> Float[np.ndarray, "components blocks powers"]:
    """Return polynomials of the time in a block, from -1 to 1: the cosines there, times √2."""
    # Interpolated at Chebyshev's nodes.
    nodes = np.cos(np.pi * (np.arange(_POWERS) + 0.5) / _POWERS)
    inverse = np.linalg.inv(np.vander(nodes, increasing=True))
    phase = (np.arange(count)[:, None] + 0.5 + 0.5 * nodes) / count
    turns = np.pi * np.arange(1, components + 1)
    return np.sqrt(2.0) * np.cos(turns[:, None, None] * phase) @ inverse.T


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
    """Return the result of a fit; `factors` are those of all equations that take part, unweighted.

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
    # As many coefficients as equations follow any torque: what is left says nothing of noise.
    told = solution.determined & (equations > solution.rank)
    deviation = xp.sqrt(xp.diag(covariance))
    # Put on the device together: one by one they take longer than the decomposition.
    arrays: dict[str, Any] = as_jax(
        {
            "k": solution.k,
            "standard_error": xp.where(told, deviation, np.inf),
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
    """Return the fit with standard errors that allow for independent errors of one variance."""
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


def correlated_errors(
    rows: Rows,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Numbers, " joints"],
    residual: Float[Numbers, "instants joints"],
    fixed: Fixed | None = None,
) -> Identification:
    """Return the fit with standard errors that allow for errors correlated in time and space.

    - `weights`: of joints.
    - `residual`: that the fit leaves; of a robust loss that of its pseudo-values.
    """
    effective = effective_counts(residual, rows.counts)
    used = components_for(effective)
    if isinstance(used, np.ndarray):  # sums of the others would be zeros
        used = used[used > 0]
    sums = rows.cosine_sums(weights[None, :] ** 2 * residual, weights, used)
    return identification_of(
        rows.unknowns,
        factors,
        solution,
        correlated_covariance(sums, solution.inverse_gram, used),
        degrees_of_freedom=used.sum(),
        effective=effective,
        errors="correlated",
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
    """Return the covariance of a fit whose errors are correlated in time and across joints.

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
    root = xp.sqrt(xp.maximum(left, LEAST_LEFT))
    return covariance / root[:, None] / root[None, :]

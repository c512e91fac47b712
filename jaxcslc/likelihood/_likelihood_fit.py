"""The result of maximum likelihood with its errors, and the misfit of fixed coefficients."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int

from .._display import html_of, html_table
from .._environment import as_jax
from .._processes import over_chunks
from ..bodies import PhysicalParameters
from ..least_squares import (
    LEAST_LEFT,
    RESULTS,
    UNDETERMINED_SHARE,
    CosineSums,
    Errors,
    Identification,
    components_for,
    correlated_covariance,
    effective_counts,
)
from ..network import CSLC
from ..uncertainty import SystematicError, missing_terms
from ._banded_solver import Factored, Spectrum, gram
from ._equation_sums import stencil
from ._laws import score_share
from ._objective import Linear
from ._point import Point
from ._search import Minimum
from ._spacing import NoiseExcitation, SpacingChoice


# Stretches of time in which products of rows are summed.
_STRETCHES = 256


@dataclasses.dataclass(frozen=True)
class RowSums:
    """Sums of the rows of equations and readings for the border, with positions eliminated.

    With positions eliminated, a fit is a regression; see `eliminated_rows`. Its rows are several
    times as large as all matrices of a fit together, so that they are computed stretch by stretch.

    **Attributes**

    - `scores`: (samples, border), sums of an instant's rows times residuals.
    - `grams`: (stretches, border, border), products of rows; `middles`: (stretches,) of their
      samples, counted from 0.
    - `noise`: (border, border), the variance of the sum of scores for white noise of the levels
      that weights assume.
    """

    scores: Float[np.ndarray, "samples border"]
    grams: Float[np.ndarray, "stretches border border"]
    middles: Float[np.ndarray, " stretches"]
    noise: Float[np.ndarray, "border border"]

    @classmethod
    def of(cls, linear: Linear, factored: Factored) -> "RowSums":
        """Sum up rows of equations at the minimum."""
        samples, intervals = len(linear.order.position), linear.objective.readings.intervals
        ends = np.linspace(0, samples, min(_STRETCHES, samples) + 1).astype(int)
        size = len(linear.objective.scale)
        scores, grams = np.empty((samples, size)), np.empty((len(ends) - 1, size, size))
        shares = None if intervals is None else score_share(intervals.edge)

        def add(first: int, last: int) -> np.ndarray:
            noise = np.zeros((size, size))
            for number in range(first, last):
                stretch = slice(int(ends[number]), int(ends[number + 1]))
                rows, scores[stretch] = eliminated_rows(linear, factored, stretch)
                grams[number] = gram(rows.reshape(-1, size))
                if shares is not None:
                    rows[:, -shares.shape[1] :] *= np.sqrt(shares[stretch])[:, :, None]
                    noise += gram(rows.reshape(-1, size))
            return noise

        parts = over_chunks(add, len(grams), 1 + len(grams) // 16)
        noise = np.sum(grams if shares is None else parts, axis=0)
        return cls(scores, grams, 0.5 * (ends[1:] + ends[:-1] - 1), noise)

    def independent_covariance(
        self, inverse: Float[np.ndarray, "border border"]
    ) -> Float[np.ndarray, "border border"]:
        """Return the Cramér-Rao bound; for counts that are intervals, what replaces it.

        The bound of sharp intervals is none: errors fall with the number of readings, not with its
        root. With edges of some width, scores vary less than curvatures say (`score_share`): a
        sandwich of both.

        - `inverse`: of the information, in units of the border's scale.
        """
        return inverse - inverse @ (np.sum(self.grams, axis=0) - self.noise) @ inverse


def eliminated_rows(
    linear: Linear, factored: Factored, stretch: slice
) -> tuple[Float[np.ndarray, "samples rows border"], Float[np.ndarray, "samples border"]]:
    """Return rows of a stretch's instants in standard deviations, and their sums times residuals.

    With positions eliminated, a fit is a regression whose rows are what an equation or a reading
    says of the border beyond what it says of positions: n equations, then n readings. The first
    and the last sample of all have readings and no equation.
    """
    objective, order, eliminated = linear.objective, linear.order, factored.eliminated
    weights, residuals = linear.weights, linear.residuals
    first, last = stretch.start, stretch.stop
    equations = slice(max(first - 1, 0), max(min(last - 1, len(order.position) - 2), 0))
    count, n = last - first, linear.readings.joints
    motion = linear.motion
    within = equations.start + 1 - first  # of the first equation among the samples

    torque = motion.by_border.between(equations).dense
    near = eliminated[order.position[equations.start : equations.stop + 2]]
    torque -= np.matmul(motion.by_position[equations], stencil(near))
    for reversals, equation, joint, derivative in motion.turns:
        inside = np.flatnonzero((equation >= equations.start) & (equation < equations.stop))
        turned = derivative[inside, None] * eliminated[order.turn[reversals[inside]]]
        np.subtract.at(torque, (equation[inside] - equations.start, joint[inside]), turned)
    reading = -eliminated[order.position[stretch]]
    sample, joints = np.indices((count, n))
    offset = linear.readings.offset[stretch]
    reading[sample, joints, offset] += objective.scale[offset]

    of_torque, of_position = weights["torque"][equations], weights["position"][stretch]
    result, scaled = np.zeros((count, 2 * n, len(objective.scale))), np.zeros((count, 2 * n))
    rows = slice(within, within + len(of_torque))
    result[rows, :n] = torque * np.sqrt(of_torque)[:, :, None]
    result[:, n:] = reading * np.sqrt(of_position)[:, :, None]
    scaled[rows, :n] = residuals["torque"][equations] * np.sqrt(of_torque)
    scaled[:, n:] = residuals["position"][stretch] * np.sqrt(of_position)
    return result, np.matmul(scaled[:, None], result)[:, 0]


Inputs = Float[np.ndarray, "equations joints inputs"]


def systematic_errors(
    linear: Linear,
    factored: Factored,
    point: Point,
    counted: Bool[np.ndarray, "equations joints"],
    effective: Float[np.ndarray, " joints"],
) -> SystematicError:
    """Return what a wrong time of torques and missing terms may do to coefficients.

    As `systematic_error` of least squares, without the causes that are smoothing's: each of
    `missing_terms` is added to the equations, for all joints that lack it, and so is the derivative
    of recorded torques by time (`"torque timing"`). With inputs C, what is left of them beside
    positions and coefficients is C' (Frisch and Waugh 1933); their coefficients are
    (C'ᵀ W C)⁻¹ Cᵀ W r for residuals r, and the fit changes by as much as it explains of C. Of the
    square of this change its variance is taken off, from the lowest cosine components of C'ᵀ W r as
    for the fit itself: a term that the recording does not show makes no part.

    **Arguments**

    - `linear`, `factored`: the equations at the minimum `point`.
    - `counted`: equations that count fully.
    - `effective`: (n,) how many independent equations each joint's are worth.

    **Returns** by cause, (p,) of each coefficient.
    """
    p, components = len(point.k), int(np.sum(components_for(np.asarray(effective))))
    parts: dict[str, np.ndarray] = {}
    for cause, inputs in _inputs(linear, point, counted).items():
        change = _change(linear, factored, inputs, components) * linear.objective.scale
        parts[cause] = np.abs(change[:p])
    return SystematicError(parts)


def _inputs(
    linear: Linear, point: Point, counted: Bool[np.ndarray, "equations joints"]
) -> Mapping[str, Inputs]:
    """Return inputs of terms by cause."""
    motion = linear.objective.motion
    record, equations = motion.record, motion.equations
    step = equations.intervals[:, None]
    velocity = np.diff(point.q, axis=0) / step
    velocity = (velocity[1:] * step[:-1] + velocity[:-1] * step[1:]) / (step[1:] + step[:-1])
    predicted = record.averaged - linear.present["torque"]
    n = predicted.shape[1]
    result: dict[str, Inputs] = {"torque timing": record.rate[:, :, None]}
    terms = missing_terms(equations.network, velocity, predicted, counted, np.zeros(n))
    for cause, columns in terms.items():
        inputs = np.zeros((len(predicted), n, sum(part.shape[1] for part in columns)))
        first = 0
        for joint, part in enumerate(columns):
            inputs[:, joint, first : first + part.shape[1]] = part
            first += part.shape[1]
        if first:
            result[cause] = inputs
    return result


def _change(
    linear: Linear, factored: Factored, inputs: Inputs, components: int
) -> Float[np.ndarray, " border"]:
    """Return by how much inputs change the border, beyond noise; in its scale."""
    objective, weights = linear.objective, linear.weights
    # Inputs of a joint that rests, or of torques that never bend, say nothing.
    size = np.sqrt(np.sum(weights["torque"][:, :, None] * inputs**2, axis=(0, 1)))
    inputs = inputs[:, :, size > 0.0] / size[size > 0.0]
    count = inputs.shape[2]
    explained = np.zeros((count, len(objective.scale)))
    scores = np.zeros((len(weights["position"]), count))
    gram = np.zeros((count, count))
    of_inputs = [linear.zeros(torque=inputs[:, :, number]) for number in range(count)]
    steps = linear.steps(factored, of_inputs) if of_inputs else []
    for number, (step, of_input) in enumerate(zip(steps, of_inputs, strict=True)):
        left = linear.after(step, of_input)
        explained[number] = step.border
        weighted = weights["torque"] * left["torque"]
        gram[number] = np.einsum("ij,ijk->k", weighted, inputs)
        scores[1:-1, number] += np.sum(weighted * linear.residuals["torque"], axis=1)
        scores[:, number] += np.sum(
            weights["position"] * left["position"] * linear.residuals["position"], axis=1
        )
    inverse = np.linalg.pinv(0.5 * (gram + gram.T), rcond=1e-9, hermitian=True)
    values = inverse @ np.einsum(
        "ijk,ij->k", inputs, weights["torque"] * linear.residuals["torque"]
    )
    phase = (np.arange(len(scores)) + 0.5) / len(scores)
    cosines = np.sqrt(2.0) * np.cos(np.pi * np.arange(1, components + 1)[:, None] * phase)
    noise = cosines @ scores @ inverse @ explained
    variance = np.mean(noise**2, axis=0)
    return np.sqrt(np.maximum((values @ explained) ** 2 - variance, 0.0))


# How often white residuals are taken for correlated ones: intervals of 95 % are then no less right.
_LEVEL = 0.05


@dataclasses.dataclass(frozen=True)
class Whiteness:
    """Test whether slow parts of scores are as large as those of white noise of the assumed levels.

    Scores are products of rows and residuals; what they sum up to is the error of a fit. Of white
    noise, cosine components of scores are independent, and their squares in units of the
    information add up to a chi-squared variable. Unlike correlations of residuals themselves, these
    have little to do with what positions take up of quick noise.

    **Attributes**

    - `components`: how many of the lowest were looked at.
    - `ratio`: of the sum of squares of all coefficients together to what white noise has.
    - `degrees_of_freedom`: of that sum.
    """

    components: int
    ratio: float
    degrees_of_freedom: float

    @classmethod
    def of(
        cls,
        sums: CosineSums,
        inverse: Float[np.ndarray, "border border"],
        gram: Float[np.ndarray, "border border"],
        components: int,
    ) -> "Whiteness":
        """Test a fit.

        - `sums`: of rows and scores, of so many `components`.
        - `inverse`: of the information, in units of the border's scale.
        - `gram`: variance of the sum of scores were residuals white, `RowSums.noise`.
        """
        values, grams = np.asarray(sums.sums), np.asarray(sums.grams)
        square = float(np.sum((values @ inverse) * values))
        # A fit takes a part off each component, the more the more it looks like columns.
        before = float(np.sum(inverse * np.asarray(sums.power)))
        bent = inverse @ grams
        taken = float(np.sum(bent * np.swapaxes(bent, 1, 2)))
        spread = inverse @ gram
        total = float(np.trace(spread))
        expected = components * total * max(1.0 - taken / before, LEAST_LEFT)
        count = components * total**2 / float(np.sum(spread * spread.T))
        return cls(components, square / expected, count)

    def white(self) -> bool:
        """Return whether white noise explains all coefficients together."""
        return self.ratio <= _most(self.degrees_of_freedom)

    def exceeds(self, ratio: Float[np.ndarray, " border"]) -> Bool[np.ndarray, " border"]:
        """Return which variances of the sandwich over the bound's are more than chance."""
        return ratio > _most(float(self.components))


def _most(count: float) -> float:
    """Return the mean square of so many standard normal variables that is seldom exceeded."""
    return float(scipy.special.chdtri(count, _LEVEL) / count)


class CorrelatedErrors(NamedTuple):
    """Errors of a fit whose residuals need not be white.

    - `covariance`: (border, border), in units of the border's scale.
    - `degrees_of_freedom`: of Student's t.
    - `effective`: (n,) how many independent equations each joint's are worth.
    """

    covariance: Float[np.ndarray, "border border"]
    degrees_of_freedom: float
    effective: Float[np.ndarray, " joints"]

    def at_least(self, bound: Float[np.ndarray, "border border"]) -> "CorrelatedErrors":
        """Return the same with no variance below that of a bound.

        Few readings are near the edges of their intervals. Each of them is fitted more closely than
        it would be otherwise, and the spread of scores says less than the truth.
        """
        variance, least = np.diag(self.covariance), np.diag(bound)
        growth = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
        return self._replace(covariance=self.covariance * growth[:, None] * growth)


def reported_errors(
    linear: Linear,
    sums: RowSums,
    inverse: Float[np.ndarray, "border border"],
    bound: Float[np.ndarray, "border border"],
    counted: Bool[np.ndarray, "equations joints"],
) -> CorrelatedErrors:
    """Return errors of a fit: the bound where residuals are white, else what correlated ones do to
    it.

    The bound is known as well as noise levels are, the sandwich from a few components of a
    spectrum: so the sandwich is for where residuals say that it is needed (White 1982, the
    information matrix test). They say so of all coefficients together, and then all errors are
    those of the sandwich, with its degrees of freedom; or of some, which then have its variance.

    - `linear`: the equations at the minimum; `sums`: of their rows.
    - `inverse`: of the information; `bound`: of `RowSums.independent_covariance`; both in units of
      the border's scale.
    - `counted`: (equations, n) whether an equation has its full weight.
    """
    residual = np.where(counted, linear.residuals["torque"][:, : counted.shape[1]], 0.0)
    effective = np.asarray(effective_counts(residual, counted.astype(float)))
    used = np.asarray(components_for(effective))
    components = cosine_sums(sums, used)
    sandwich = _sandwich(linear, inverse, components, used, effective)
    whiteness = Whiteness.of(components, inverse, sums.noise, int(used.sum()))
    if not whiteness.white():
        return sandwich if linear.objective.readings.intervals is None else sandwich.at_least(bound)
    least = np.diag(bound)
    ratio = np.diag(sandwich.covariance) / np.where(least > 0.0, least, np.inf)
    growth = np.sqrt(np.where(whiteness.exceeds(ratio), ratio, 1.0))
    count = max(float(counted.sum()) - len(bound), 1.0)
    return CorrelatedErrors(growth[:, None] * bound * growth, count, effective)


def _sandwich(
    linear: Linear,
    inverse: Float[np.ndarray, "border border"],
    sums: CosineSums,
    used: Float[np.ndarray, " components"],
    effective: Float[np.ndarray, " joints"],
) -> CorrelatedErrors:
    """Return what residuals as they are, correlated in time and across joints, do to a fit.

    With positions eliminated, a fit is a regression whose rows are what an equation or a reading
    says of the border beyond what it says of positions. The sum over time of these rows times
    residuals makes the error of the fit; its variance is the height of its spectrum at frequency
    zero, estimated as for least squares (`correlated_covariance`). For white noise of the levels
    that weights assume, it is the inverse of the information; for a model that lacks something it
    is larger, often by far. What is known beforehand adds its part, for it is no sum over time.
    """
    covariance = correlated_covariance(sums, inverse, used)
    objective = linear.objective
    known = inverse * (objective.scale**2 * objective.weights["border"])
    total = np.asarray(covariance) + known @ inverse
    return CorrelatedErrors(0.5 * (total + total.T), float(used.sum()), effective)


def cosine_sums(rows: RowSums, used: Float[np.ndarray, " components"]) -> CosineSums:
    """Return components of scores, and how much of rows is in each."""
    samples = len(rows.scores)
    frequency = np.arange(1, len(used) + 1)[:, None]

    def cosines(samples_from_0: np.ndarray) -> np.ndarray:
        phase = (samples_from_0 + 0.5) / samples
        return used[:, None] * np.sqrt(2.0) * np.cos(np.pi * frequency * phase)

    middle = cosines(rows.middles)
    return CosineSums(
        cosines(np.arange(samples)) @ rows.scores,
        np.tensordot(middle, rows.grams, axes=1),
        np.tensordot(np.sum(middle**2, axis=0), rows.grams, axes=1),
    )


class LikelihoodFit(eqx.Module):
    """Coefficients, positions and noise levels that make a recording most likely.

    **Attributes**

    - `network`: with the slopes that were fitted: `network.torque(fit.k, ...)` predicts.
    - `fit`: its coefficients. `independent_covariance` is the inverse of the information that
      positions, slopes, encoder offsets and reversals leave: the Cramér-Rao bound for noise of the
      estimated levels, or what the edges of encoders' intervals leave. `covariance` allows for
      what `MaximumLikelihood.errors` says.
    - `slopes`: (n,) of static friction [s/rad or s/m]; `slope_error`: their standard deviations.
      Zeros for a network without static friction.
    - `offset`: (recordings, n) of each encoder within a step [rad or m]; `offset_error`.
    - `position`: (samples, n) estimated positions [rad or m], of one recording after the other; at
      every `MaximumLikelihood.every`-th sample.
    - `torque_noise`: (recordings, n) [N m or N]; `position_noise`: (recordings, n) [rad or m]:
      standard deviations.
    - `edge`: (recordings, n) widths of the edges of counts that are intervals, in steps of the
      encoder; 0 where readings count as normally distributed.
    - `reversal_moments`: (samples, n) when a joint reverses next to a sample, in intervals after
      it; NaN where it does not.
    - `reversals`: how many moments of reversals were estimated.
    - `steps`: of the search; `converged`: whether it ended at a minimum.
    - `bodies`: with `MaximumLikelihood.possible`, those whose coefficients `fit` has; its standard
      errors are those of coefficients that nothing confines, an upper bound. `free`: the fit
      without bodies. Both are None otherwise.
    - `every`: positions were unknown at every so many samples.
    - `systematic`: what a wrong time of torques, and terms that the network lacks, may do to `fit`
      beyond its standard errors, by cause (`uncertainty_interval(fit, systematic)`); None with
      `errors="independent"`, and where more than joints moves.
    - `presliding_distance`: (n,) [rad or m], as that of `MaximumLikelihood`: dry friction of these
      joints is for motion that slides. Standard errors are for known distances.
    - `spacing`: why positions are as far apart as they are, where `every` was `"auto"`; None
      otherwise.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable("viscous"), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.2], samples=200)
    >>> result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    >>> result.converged, result.position.shape, result.fit.names
    (True, (200, 1), ('kB1', 'kv1'))
    """

    network: CSLC
    fit: Identification
    slopes: Float[np.ndarray, " joints"]
    slope_error: Float[np.ndarray, " joints"]
    offset: Float[np.ndarray, "recordings joints"]
    offset_error: Float[np.ndarray, "recordings joints"]
    position: Float[np.ndarray, "samples joints"]
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]
    edge: Float[np.ndarray, "recordings joints"]
    reversal_moments: Float[np.ndarray, "samples joints"]
    presliding_distance: Float[np.ndarray, " joints"]
    reversals: int = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    converged: bool = eqx.field(static=True)
    bodies: PhysicalParameters | None = None
    free: Identification | None = None
    systematic: SystematicError | None = None
    every: int = eqx.field(static=True, default=1)
    spacing: SpacingChoice | None = eqx.field(static=True, default=None)
    noise_excitation: NoiseExcitation | None = eqx.field(static=True, default=None)

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients, (p,)."""
        return self.fit.k

    def at(self, samples: Bool[np.ndarray, " samples"]) -> "LikelihoodFit":
        """Return the same with some of the estimated positions."""
        return dataclasses.replace(
            self,
            position=self.position[samples],
            reversal_moments=self.reversal_moments[samples],
        )

    def __repr__(self) -> str:
        noise = "; ".join(
            ", ".join(f"{level:.2g}" for level in levels) for levels in self.torque_noise
        )
        ended = "converged" if self.converged else "did not converge"
        return (
            f"LikelihoodFit({ended} after {self.steps} steps; torque noise [{noise}]; {self.fit!r})"
        )

    def _repr_html_(self) -> str:
        """Return tables of the torque noise and of the coefficients, for notebooks."""
        joints = {"joint": self.network.output_labels}
        noise = {f"recording {i + 1}": levels for i, levels in enumerate(self.torque_noise)}
        title = "LikelihoodFit: standard deviation of the torque noise [N m or N]"
        return html_table(title, {**joints, **noise}) + html_of(self.fit)


@dataclasses.dataclass(frozen=True)
class Misfit:
    """Residuals of recordings with fixed coefficients, when positions are estimated.

    **Attributes**

    - `error`: (equations, n), root of the squares of an equation's torque residual and of its
      reading, each in standard deviations of its noise.
    - `torque`: (equations, n) residuals [N m or N].
    - `mask`: (equations, n), equations that count: neither next to a reversal nor at standstill.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable("viscous"), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.2], samples=200)
    >>> levels = np.array([0.01]), np.array([1e-5])
    >>> estimator = jc.MaximumLikelihood(torque_sampling="sampled")
    >>> right, wrong = (
    ...     np.mean(estimator.misfit(network, recording, np.array(k), *levels).error)
    ...     for k in ([0.5, 0.2], [0.5, 0.3])
    ... )
    >>> bool(right < 0.1 * wrong)
    True
    """

    error: Float[np.ndarray, "equations joints"]
    torque: Float[np.ndarray, "equations joints"]
    mask: Bool[np.ndarray, "equations joints"]

    @classmethod
    def of(cls, minimum: Minimum, part: Int[np.ndarray, " samples"]) -> "Misfit":
        """Read it off the minimum of a search; `part`: number of the recording of each sample."""
        left, of_equation = minimum.linear.residuals, part[1:-1]
        error = np.hypot(
            left["torque"] / minimum.torque_noise[of_equation],
            left["position"][1:-1] / minimum.position_noise[of_equation],
        )
        return cls(error, left["torque"], minimum.counted)


class BorderErrors(NamedTuple):
    """Errors of all that equations share, for independent or correlated residuals.

    - `reported`: of the border in units of its scale; `spectrum`: of its information.
    - `covariance`, `independent_covariance`: (border, border).
    - `error`: (border,) standard errors; infinite for what the recording does not determine.
    """

    reported: CorrelatedErrors
    spectrum: Spectrum
    covariance: Float[np.ndarray, "border border"]
    independent_covariance: Float[np.ndarray, "border border"]
    error: Float[np.ndarray, " border"]


def border_errors(minimum: Minimum, errors: Errors) -> BorderErrors:
    """Return the errors of the end of a search; `errors`: as of `MaximumLikelihood`."""
    spectrum, scale = Spectrum.of(minimum.factored.information), minimum.objective.scale
    counts, inverse = minimum.counted.sum(axis=0).astype(float), spectrum.covariance
    sums = RowSums.of(minimum.linear, minimum.factored)
    bound = sums.independent_covariance(inverse)
    freedom = max(float(counts.sum()) - len(minimum.point.k), 1.0)
    reported = CorrelatedErrors(bound, freedom, counts)
    if errors == "correlated":
        reported = reported_errors(minimum.linear, sums, inverse, bound, minimum.counted)
    independent, covariance = (
        matrix * scale[:, None] * scale[None, :] for matrix in (bound, reported.covariance)
    )
    unclear = np.sqrt(np.sum(spectrum.undetermined**2, axis=0)) >= UNDETERMINED_SHARE
    error = np.where(unclear, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return BorderErrors(reported, spectrum, covariance, independent, error)


SPACED = ("every", "spacing", "noise_excitation")
"""Fields of `LikelihoodFit` that say how far apart positions are."""


def likelihood_fit(network: CSLC, minimum: Minimum, errors: Errors, **fields: Any) -> LikelihoodFit:
    """Return the result of a search, with standard errors for independent or correlated residuals.

    - `fields`: those of `SPACED`, with the defaults of `LikelihoodFit`.
    """
    point, p, n = minimum.point, network.size, network.joint_count
    residual, used = minimum.linear.residuals["torque"], minimum.counted
    counts = used.sum(axis=0).astype(float)
    reported, spectrum, covariance, independent, error = border_errors(minimum, errors)
    systematic = None
    if errors == "correlated":
        systematic = systematic_errors(
            minimum.linear, minimum.factored, point, used, reported.effective
        )
    null = spectrum.undetermined[:, :p]
    undetermined = np.zeros((p, p))
    undetermined[: len(null)] = null * (minimum.objective.scale / spectrum.unit)[:p]
    squares = np.sum(np.where(used, residual, 0.0) ** 2, axis=0)
    complete = len(null) == 0
    # Put on the device together: one by one, each is a program of its own.
    arrays: dict[str, Any] = as_jax(
        {
            "k": point.k,
            "standard_error": error[:p],
            "covariance": covariance[:p, :p],
            "independent_covariance": independent[:p, :p],
            "torque_error": np.sqrt(squares / np.maximum(counts, 1.0)),
            "equations": counts,
            "effective_equations": reported.effective,
            "degrees_of_freedom": np.float64(reported.degrees_of_freedom),
            "rank": p - len(null),
            "condition": np.sqrt(spectrum.values[-1] / spectrum.values[spectrum.counted][0]),
            "undetermined": undetermined,
            "determined": np.isfinite(error[:p]),
        }
    )
    result = RESULTS.successful if complete else RESULTS.rank_deficient
    fit = Identification(**arrays, result=result, names=network.names, errors=errors)
    static = network.static_slopes is not None
    slopes = np.exp(point.slopes) if static else np.zeros(n)
    intervals, part = minimum.objective.readings.intervals, minimum.objective.readings.part
    return LikelihoodFit(
        network=network.with_static_slopes(slopes) if static else network,
        fit=fit,
        slopes=slopes,
        slope_error=slopes * error[p : p + n],
        offset=point.offset,
        offset_error=error[point.layout.part("offset")].reshape(point.offset.shape),
        position=point.q,
        torque_noise=minimum.torque_noise,
        position_noise=minimum.position_noise,
        edge=np.zeros_like(point.offset) if intervals is None else intervals.edges(part),
        reversal_moments=minimum.objective.motion.signs.moments(point.turn, len(point.q)),
        presliding_distance=minimum.objective.motion.equations.presliding_distance,
        reversals=len(minimum.objective.motion.signs.samples),
        steps=minimum.steps,
        converged=minimum.converged,
        systematic=systematic,
        **fields,
    )

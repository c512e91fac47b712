from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..solver import CosineSums, components_for, correlated_covariance, effective_counts
from ._band import Factored
from ._linear import Linear
from ._readings import score_share


# Stretches of time in which products of rows are summed before they are multiplied by cosines.
_STRETCHES = 256


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
        """The same with no variance below that of a bound.

        Few readings are near the edges of their intervals. Each of them is fitted more closely than
        it would be otherwise, and the spread of scores says less than the truth.
        """
        variance, least = np.diag(self.covariance), np.diag(bound)
        growth = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
        return self._replace(covariance=self.covariance * growth[:, None] * growth)


def correlated_errors(
    linear: Linear,
    factored: Factored,
    inverse: Float[np.ndarray, "border border"],
    counted: Bool[np.ndarray, "equations joints"],
) -> CorrelatedErrors:
    """The sandwich: what residuals as they are, correlated in time and across joints, do to a fit.

    With positions eliminated, a fit is a regression whose rows are what an equation or a reading
    says of the border beyond what it says of positions. The sum over time of these rows times
    residuals makes the error of the fit; its variance is the height of its spectrum at frequency
    zero, estimated as for least squares (`correlated_covariance`). For white noise of the levels
    that weights assume, it is the inverse of the information; for a model that lacks something it
    is larger, often by far. What is known beforehand adds its part, for it is no sum over time.

    **Arguments**

    - `linear`, `factored`: the equations at the minimum.
    - `inverse`: of the information, in units of the border's scale.
    - `counted`: (equations, n) whether an equation has its full weight.
    """
    rows, scores = eliminated_rows(linear, factored)
    residual = np.where(counted, linear.residuals.torque, 0.0)
    effective = effective_counts(jnp.asarray(residual), jnp.asarray(counted, float))
    used = components_for(effective)
    sums = _sums(rows, scores, np.asarray(used))
    covariance = correlated_covariance(sums, jnp.asarray(inverse), used)
    objective = linear.objective
    known = inverse * (objective.scale**2 * objective.weights.border)
    total = np.asarray(covariance) + known @ inverse
    return CorrelatedErrors(0.5 * (total + total.T), float(used.sum()), np.asarray(effective))


def eliminated_rows(
    linear: Linear, factored: Factored
) -> tuple[Float[np.ndarray, "samples rows border"], Float[np.ndarray, "samples border"]]:
    """Rows of each instant in standard deviations, and their sums times residuals.

    The first and the last sample have readings and no equation.
    """
    objective, order = linear.objective, linear.order
    weights, residuals, eliminated = linear.weights, linear.residuals, factored.eliminated
    samples, n = order.position.shape
    of_position = eliminated[order.position]  # (samples, n, border)
    torque = linear.by_border.copy()
    for i, equations, of_equation in linear.stencil_parts:
        stencil = linear.by_position[equations, :, i * n : (i + 1) * n]
        torque[equations] -= np.matmul(stencil, of_position[of_equation])
    for reversals, equation, joint, derivative in linear.turn_parts:
        turned = derivative[:, None] * eliminated[order.turn[reversals]]
        np.subtract.at(torque, (equation, joint), turned)
    reading = -of_position
    sample, joints = np.indices(weights.position.shape)
    reading[sample, joints, linear.offset] += objective.scale[linear.offset]

    root = np.sqrt(weights.torque)
    rows = np.zeros((samples, 2 * n, len(objective.scale)))
    rows[1:-1, :n] = torque * root[:, :, None]
    rows[:, n:] = reading * np.sqrt(weights.position)[:, :, None]
    scaled = np.zeros((samples, 2 * n))
    scaled[1:-1, :n] = residuals.torque * root
    scaled[:, n:] = residuals.position * np.sqrt(weights.position)
    return rows, np.einsum("srb,sr->sb", rows, scaled)


def independent_covariance(
    linear: Linear, factored: Factored, inverse: Float[np.ndarray, "border border"]
) -> Float[np.ndarray, "border border"]:
    """The Cramér-Rao bound; for counts that are intervals, what replaces it.

    The bound of sharp intervals is none: errors fall with the number of readings, not with its
    root. With edges of some width, scores vary less than curvatures say (`score_share`): a sandwich
    of both.

    **Arguments**

    - `linear`, `factored`: the equations at the minimum.
    - `inverse`: of the information, in units of the border's scale.
    """
    intervals = linear.objective.intervals
    if intervals is None:
        return inverse
    rows, _ = eliminated_rows(linear, factored)
    n = intervals.edge.shape[1]
    readings = rows[:, n:] * np.sqrt(1.0 - score_share(intervals.edge))[:, :, None]
    flat = readings.reshape(-1, rows.shape[2])
    return inverse - inverse @ (flat.T @ flat) @ inverse


def _sums(
    rows: Float[np.ndarray, "samples rows border"],
    scores: Float[np.ndarray, "samples border"],
    used: Float[np.ndarray, " components"],
) -> CosineSums:
    samples, _, border = rows.shape
    number = np.arange(1, len(used) + 1)[:, None]

    def cosines(phase: np.ndarray) -> np.ndarray:
        return used[:, None] * np.sqrt(2.0) * np.cos(np.pi * number * phase[None, :])

    stretches = np.array_split(np.arange(samples), min(_STRETCHES, samples))
    grams = np.empty((len(stretches), border, border))
    for gram, stretch in zip(grams, stretches, strict=True):
        flat = rows[stretch[0] : stretch[-1] + 1].reshape(-1, border)
        gram[:] = flat.T @ flat
    middle = cosines(np.array([stretch.mean() + 0.5 for stretch in stretches]) / samples)
    return CosineSums(
        jnp.asarray(cosines((np.arange(samples) + 0.5) / samples) @ scores),
        jnp.asarray(np.tensordot(middle, grams, axes=1)),
        jnp.asarray(np.tensordot(np.sum(middle**2, axis=0), grams, axes=1)),
    )

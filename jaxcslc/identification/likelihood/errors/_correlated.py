"""Standard errors where residuals are correlated in time or across joints."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...solver import CosineSums, components_for, correlated_covariance, effective_counts
from .._linear import Linear
from ._rows import RowSums
from ._whiteness import Whiteness


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

    **Arguments**

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

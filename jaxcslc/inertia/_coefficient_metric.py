from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from .._rank import numerical_rank


# Noise-free coefficients have a covariance of rounding. Standard errors are taken as no less than
# this part of the coefficient that an average body would cause: finer is beyond the solver.
_FINEST = 1e-6


@runtime_checkable
class Fitted(Protocol):
    """Coefficients and their uncertainty: what an `Identification` and its file share."""

    @property
    def k(self) -> Float[Array | np.ndarray, " coefficients"]: ...
    @property
    def covariance(self) -> Float[Array | np.ndarray, "coefficients coefficients"]: ...
    @property
    def undetermined(self) -> Float[Array | np.ndarray, "rows coefficients"]: ...


def whitening(
    fit: Fitted, sizes: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "rank coefficients"]:
    """The matrix that turns a change of the coefficients into standard errors.

    The standard errors are those of independent residuals: the norm of the result is then also the
    torque that the change causes over the patterns, in units of the residual.

    A change along a combination that the data do not determine costs nothing: the covariance is
    inverted on its range only, along the undetermined combinations. The result's squared norm is
    what the change adds to the sum of squared residuals, in units of their variance.

    **Arguments**

    - `fit`: its coefficients, covariance and undetermined combinations.
    - `sizes`: of typical coefficients, in their units.

    **Returns**

    - A matrix with one row for each determined combination.

    **Raises**

    - `ValueError`: if the coefficients or their covariance are not finite.
    """
    # A covariance that allows for correlation is of low rank; torques are measured by the other.
    covariance = np.asarray(getattr(fit, "independent_covariance", fit.covariance), float)
    free = np.asarray(fit.undetermined, float)
    if not np.all(np.isfinite(covariance)) or not np.all(np.isfinite(np.asarray(fit.k))):
        raise ValueError("the fit's coefficients or covariance are not finite")
    units = np.sqrt(np.maximum(np.diag(covariance), 0.0)) + _FINEST * sizes
    free = free[np.linalg.norm(free, axis=1) > 0] / units
    if free.size:
        free = free / np.linalg.norm(free, axis=1, keepdims=True)
        free = np.linalg.svd(free, full_matrices=False)[2][: numerical_rank(free.T)]
    scaled = covariance / np.outer(units, units)
    scaled = (scaled + scaled.T) / 2 + np.diag((_FINEST * sizes / units) ** 2)
    # Numbers that changes along undetermined combinations leave as they are. The covariance's range
    # would do as well, but beside a variance of infinity it cannot be told from rounding.
    numbers = np.eye(len(units))
    if free.size:
        numbers = np.linalg.svd(free)[2][len(free) :]
    values, vectors = np.linalg.eigh(numbers @ scaled @ numbers.T)
    # Of a motion that is all rounding, variances are too, and may be below zero.
    values = np.maximum(values, np.finfo(float).eps * len(values) * values[-1:])
    return (vectors.T / np.sqrt(values)[:, None]) @ numbers / units

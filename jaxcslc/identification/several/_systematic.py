from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from ..solver import Identification
from ..systematic import SystematicError


def combined_systematic(
    fits: Mapping[str, Identification], errors: Mapping[str, SystematicError]
) -> SystematicError:
    """The systematic error of a fit of several recordings, from those of fits of each by itself.

    The common fit is about the mean of the others, weighted by their precision. Causes are taken to
    act alike in all recordings, so that their errors add, and do not average out.

    **Arguments**

    - `fits`: of each recording by itself.
    - `errors`: of these fits.

    **Returns** the error; 0 of coefficients that no recording determines.
    """
    weights = {name: _precision(fits[name]) for name in errors}
    total = np.sum(list(weights.values()), axis=0)
    total = np.where(total > 0.0, total, 1.0)
    causes = dict.fromkeys(cause for error in errors.values() for cause in error.parts)
    parts = {
        cause: np.sum(
            [
                weights[name] / total * error.parts[cause]
                for name, error in errors.items()
                if cause in error.parts
            ],
            axis=0,
        )
        for cause in causes
    }
    return SystematicError(MappingProxyType(parts))


def _precision(fit: Identification) -> np.ndarray:
    """One over the variance of each coefficient; 0 of those that are not determined."""
    error = np.asarray(fit.standard_error)
    usable = np.asarray(fit.determined) & np.isfinite(error) & (error > 0.0)
    return np.where(usable, 1.0 / np.where(usable, error, 1.0) ** 2, 0.0)

"""Gauss and Newton's method: fits of equations that are linear about the last coefficients."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ._identification import Identification


_PART = 1e-3  # of a standard error: a step that moves no coefficient further is the last
_ROUNDING = 1e-10  # of the largest coefficient: the same, of a fit without noise


def gauss_newton(
    fitted: Callable[[Float[np.ndarray, " coefficients"]], Identification],
    start: Float[np.ndarray, " coefficients"],
    steps: int = 30,
) -> Identification:
    """Return the last of the fits that start from each other's coefficients.

    - `fitted`: the fit of the equations that are linear about some coefficients.
    - `steps`: at most.
    """
    fit = fitted(start)
    for _ in range(steps - 1):
        if settled(fit, start, _PART):
            break
        start = np.asarray(fit.k)
        fit = fitted(start)
    return fit


def settled(fit: Identification, before: Float[np.ndarray, " coefficients"], part: float) -> bool:
    """Return whether no coefficient has moved by this part of its standard error."""
    k = np.asarray(fit.k)
    error = np.where(np.asarray(fit.determined), np.asarray(fit.standard_error), np.inf)
    return bool(np.all(np.abs(k - before) <= part * error + _ROUNDING * np.max(np.abs(k))))

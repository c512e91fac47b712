"""Drift: differences of coefficients from recording to recording of one arm, beyond their errors.

Friction changes with temperature, and offsets with the sensors: each recording has coefficients of
its own. An interval that shall hold for a further recording allows for that.
"""

import dataclasses
from typing import Any

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .._text_table import first_of
from ..network import AbstractLinearNetwork
from ._tolerances import LEVEL, QUANTILE


# What a group of friction coefficients differs by between recordings, of their size, before
# anything is seen: scale of a half-Cauchy distribution (Gelman 2006). Some kelvin change Coulomb
# and viscous friction of gears by a few per cent (Bittencourt and Gunnarsson 2012).
_USUAL_DRIFT = 0.05
# The same of other coefficients, in standard errors of one recording's fit. Bodies do not drift,
# but what a model lacks has another effect on them in every motion.
_USUAL_MISFIT = 0.5
# Standard deviation of the logarithm of a coefficient's drift about that of its group: within a
# factor of four, at 95 %.
_SPREAD = 0.7
# Drifts that are tried, in parts of the sizes above: from nothing to all there is.
_TRIED = np.geomspace(1e-4, 1e2, 91)
# Drift is said to be there if recordings that have the same coefficients differ by as much once in
# so many coefficients.
_CHANCE = 0.01
# Coefficients that a sentence names.
_NAMED = 6


@dataclasses.dataclass(frozen=True)
class Drift:
    """Differences between recordings that errors of their fits do not explain.

    **Attributes**

    - `names`: of the p coefficients.
    - `value`: (p,) of the common fit.
    - `deviation`: (p,) standard deviation of a coefficient from recording to recording, in its
      unit: the median of what its differences, and those of its group, speak for.
    - `allowance`: (p,) what widens the interval of the common fit so that it holds for another
      recording: root of the squares with the other errors, as a standard deviation.
    - `drifting`: (p,) whether the recordings differ beyond chance.

    >>> import numpy as np
    >>> from jaxcslc.uncertainty import Drift
    >>> zero = np.zeros(2)
    >>> print(Drift(("kv1", "kd1"), np.array([2.0, 1.0]), np.array([0.2, 0.001]), zero,
    ...     np.array([True, False])))
    coefficients that drift between recordings: kv1 by 10 %
    """

    names: tuple[str, ...]
    value: Float[np.ndarray, " coefficients"]
    deviation: Float[np.ndarray, " coefficients"]
    allowance: Float[np.ndarray, " coefficients"]
    drifting: Bool[np.ndarray, " coefficients"]

    def __str__(self) -> str:
        return drift_text(self.document())

    def document(self) -> dict[str, Any]:
        """Return plain data."""
        size = np.where(self.value != 0.0, np.abs(self.value), np.inf)
        share = self.deviation / size
        order = np.argsort(-share, kind="stable")
        return {
            "deviation": self.deviation.tolist(),
            "drifting": {self.names[i]: float(share[i]) for i in order if self.drifting[i]},
        }


def drift_text(document: dict[str, Any]) -> str:
    """Return which coefficients drift between recordings, in a sentence, from `Drift.document`."""
    drifting = document["drifting"]
    if not drifting:
        return "no coefficient drifts between recordings beyond chance"
    shown = [f"{name} by {100 * share:.2g} %" for name, share in drifting.items()]
    return f"coefficients that drift between recordings: {first_of(shown, _NAMED)}"


def drift_of(
    network: AbstractLinearNetwork,
    value: Float[np.ndarray, " coefficients"],
    error: Float[np.ndarray, " coefficients"],
    alone: Float[np.ndarray, "recordings coefficients"],
    errors: Float[np.ndarray, "recordings coefficients"],
    degrees: float = np.inf,
) -> Drift:
    """Returns how much coefficients differ between recordings, from fits of each by itself.

    A recording's coefficient is that of the arm and a deviation of its own, of standard deviation
    τ (a random effect). The τ of a group (viscous friction, dry friction, bodies) are alike, in
    parts of the coefficients' size or, for all but friction, of their errors. So few recordings of
    many joints say what no coefficient could alone, and coefficients without differences of their
    own follow their group. All that is unknown is integrated over.

    **Arguments**

    - `network`: p coefficients.
    - `value`, `error`: of the common fit, the error with its systematic part.
    - `alone`, `errors`: of each recording's own fit; an error is infinite where the recording does
      not determine the coefficient.
    - `degrees`: of freedom of these errors.

    **Returns** a `Drift`.
    """
    precision = np.where(np.isfinite(errors) & (errors > 0.0), errors, np.inf) ** -2
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    counted = np.count_nonzero(precision, axis=0)
    # Of a coefficient that a single recording determines, or none, the common fit says how well.
    some = np.where(counted > 0, counted, 1)
    usual = np.where(counted > 0, np.sum(precision, axis=0) / some, error**-2.0) ** -0.5
    size = np.where(friction, _USUAL_DRIFT * np.hypot(value, usual), _USUAL_MISFIT * usual)
    usable = np.isfinite(size) & (size > 0.0) & np.isfinite(error)
    deviation, allowance = np.zeros(network.size), np.zeros(network.size)
    for slice_ in network.layout.slices:
        group = np.arange(network.size)[slice_]
        group = group[usable[group]]
        if group.size:
            found = _of_group(alone[:, group], precision[:, group], size[group], error[group])
            deviation[group], allowance[group] = found
    chance = _CHANCE / max(int(np.count_nonzero(usable)), 1)
    drifting = usable & (_probability(alone, precision, degrees) < chance)
    return Drift(network.names, value, deviation, allowance, drifting)


def _of_group(
    alone: Float[np.ndarray, "recordings group"],
    precision: Float[np.ndarray, "recordings group"],
    size: Float[np.ndarray, " group"],
    error: Float[np.ndarray, " group"],
) -> tuple[Float[np.ndarray, " group"], Float[np.ndarray, " group"]]:
    """Return deviations and allowances of coefficients whose drifts are alike.

    - `precision`: reciprocal variances of `alone`.
    - `size`: what drift is usual of each; `error`: of the common fit.
    """
    tau = size[:, None] * _TRIED
    with np.errstate(divide="ignore"):
        variance = 1.0 / precision[:, :, None] + tau**2
    # Restricted likelihood of each drift: the common value is integrated over.
    seen = precision[:, :, None] > 0.0
    weight = np.where(seen, 1.0 / variance, 0.0)
    total = np.sum(weight, axis=0)
    total = np.where(total > 0.0, total, 1.0)
    mean = np.sum(weight * alone[:, :, None], axis=0) / total
    squares = np.sum(weight * np.where(seen, alone[:, :, None] - mean, 0.0) ** 2, axis=0)
    logarithms = np.sum(np.where(seen, np.log(np.where(seen, variance, 1.0)), 0.0), axis=0)
    several = np.count_nonzero(seen, axis=0) > 1
    likelihood = np.where(several, -0.5 * (logarithms + np.log(total) + squares), 0.0)
    likelihood = np.exp(likelihood - np.max(likelihood, axis=1, keepdims=True))
    # Rows: drift of the group. Columns: drift of a coefficient.
    about = np.exp(-0.5 * (np.log(_TRIED[:, None] / _TRIED) / _SPREAD) ** 2)
    about /= np.sum(about, axis=1, keepdims=True)
    marginal = about @ likelihood.T
    of_group = np.log(_TRIED / (1.0 + _TRIED**2)) + np.sum(np.log(marginal), axis=1)
    of_group = np.exp(of_group - np.max(of_group))
    of_group /= np.sum(of_group)
    posterior = ((of_group[:, None] / marginal).T @ about) * likelihood
    posterior /= np.sum(posterior, axis=1, keepdims=True)
    half = np.argmax(np.cumsum(posterior, axis=1) >= 0.5, axis=1)
    share = precision / np.where(np.any(seen, axis=(0, 2)), np.sum(precision, axis=0), 1.0)
    # Another recording deviates by as much again as the mean of those that were fitted.
    spread = 1.0 + np.where(np.sum(share, axis=0) > 0.0, np.sum(share**2, axis=0), 1.0)
    return tau[np.arange(len(size)), half], _allowance(posterior, tau**2 * spread[:, None], error)


def _allowance(
    probability: Float[np.ndarray, "group tried"],
    variance: Float[np.ndarray, "group tried"],
    error: Float[np.ndarray, " group"],
) -> Float[np.ndarray, " group"]:
    """Return the deviation whose square, added to that of the error, gives the 95 % interval of a
    mixture of normal distributions."""
    deviation = np.sqrt(error[:, None] ** 2 + variance)
    low, high = np.zeros(len(error)), QUANTILE * np.max(deviation, axis=1)
    for _ in range(60):
        middle = 0.5 * (low + high)
        outside = 2.0 * scipy.special.ndtr(-middle[:, None] / deviation)
        wide = np.sum(probability * outside, axis=1) < 1.0 - LEVEL
        low, high = np.where(wide, low, middle), np.where(wide, middle, high)
    return np.sqrt(np.maximum((high / QUANTILE) ** 2 - error**2, 0.0))


def _probability(
    alone: Float[np.ndarray, "recordings coefficients"],
    precision: Float[np.ndarray, "recordings coefficients"],
    degrees: float,
) -> Float[np.ndarray, " coefficients"]:
    """Return how probable differences as large are between recordings of the same coefficients."""
    total = np.sum(precision, axis=0)
    mean = np.sum(precision * alone, axis=0) / np.where(total > 0.0, total, 1.0)
    squares = np.sum(precision * (alone - mean) ** 2, axis=0)
    freedom = np.maximum(np.count_nonzero(precision, axis=0) - 1, 0)
    some = np.where(freedom > 0, freedom, 1)
    if np.isfinite(degrees):
        chance = scipy.special.fdtrc(some, max(degrees, 1.0), squares / some)
    else:
        chance = scipy.special.chdtrc(some, squares)
    return np.where(freedom > 0, chance, 1.0)

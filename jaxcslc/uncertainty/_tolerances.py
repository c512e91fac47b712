"""Faults that stay possible: a common factor of the torques, the clock, zeros of joints.

They are the same in every sample, and residuals barely show them. Each has a tolerance, which
drives, recorders and homing usually keep, and a small part of recordings does not. What a recording
and its robot's file show of a fault makes it larger or smaller. A fault of the size that then stays
possible is a part of the systematic error.
"""

import dataclasses
from collections.abc import Mapping
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..least_squares import columns_of, rows_of, torque_by
from ..network import CSLC
from ..recordings import Patterns


TORQUE_SCALE, CLOCK, ZEROS = "torque scale", "clock", "zero positions"
TOLERATED = (TORQUE_SCALE, CLOCK, ZEROS)
"""Causes of systematic errors that are faults within tolerances, shared by recordings of an arm."""
SHOWN_SCALE = "torque scale shown"
"""Entry of `PossibleFaults.within`: the torque scale that neither data nor the file exclude."""


class Tolerance(NamedTuple):
    """Limit within which a fault usually is, any size as likely.

    - `limit`: half the width; a factor less 1, or an offset [rad or m].
    - `reason`: why it is not smaller.
    """

    limit: float
    reason: str


# Assumptions: a user who knows better has calibrated. Files and data make them smaller.
TOLERANCES: Mapping[str, Tolerance] = {
    TORQUE_SCALE: Tolerance(0.05, "torque constants and the sensors that calibrate them"),
    CLOCK: Tolerance(0.005, "controllers whose cycle is not quite the one that is stated"),
    ZEROS: Tolerance(0.005, "marks and stops that joints are homed to"),
}
"""Sizes of faults that no recording rules out, by name [a factor less 1, or rad or m]."""
# One recording in twenty has a fault beyond its tolerance, of twenty times its size. (Heuristic:
# data decide unless they say little; a smaller number would take a clear fault for chance.)
_GROSS, _GROSS_SIZE = 0.05, 20.0
# A factor of the torques, less 1, that must be excluded by 95 % for the scale to be confirmed: a
# standard uncertainty of 5 %, the most that a well determined coefficient may have of such errors.
_CONFIRMED_SCALE = 0.1
LEVEL = 0.95
"""Probability of intervals."""
QUANTILE = NormalDist().inv_cdf(0.5 + 0.5 * LEVEL)
"""Half the width of a normal distribution's interval, in standard deviations."""
# As many rows of a recording show its faults, in as many stretches, whose differences are noise.
_ROWS, _STRETCHES = 2000, 20
_STEP = 1e-4  # of finite differences [rad or m, or as a part]
# Part of a fault's torque that coefficients must leave for data to say something of it: below,
# differences of finite steps are no data.
_LEAST_LEFT = 1e-5
_ROUNDING = 1e-12  # of eigenvalues of scaled normal equations
_TINY = 1e-300


class Estimate(NamedTuple):
    """Estimate of a fault's size, and its standard error; infinite where nothing is known."""

    value: float = 0.0
    error: float = np.inf

    def with_other(self, other: "Estimate") -> "Estimate":
        """Return the mean of two independent estimates, weighted by their precision.

        >>> Estimate(0.1, 0.2).with_other(Estimate(0.3, 0.2))
        Estimate(value=0.2, error=0.1414213562373095)
        """
        if not np.isfinite(other.error):
            return self
        if not np.isfinite(self.error):
            return other
        a, b = self.error**-2, other.error**-2
        return Estimate(float((a * self.value + b * other.value) / (a + b)), float((a + b) ** -0.5))


def possible_size(limit: float, estimate: Estimate) -> float:
    """Return the size within which a fault is by 95 %, given what is known of it.

    Before, it is usually within its limit, and rarely far beyond. The estimate makes it a mixture
    of two normal distributions. The size is half the width of the interval about zero.

    **Arguments**

    - `limit`: of the tolerance.
    - `estimate`: of data; it may have an infinite error.

    >>> from jaxcslc.uncertainty import Estimate, possible_size
    >>> round(possible_size(0.05, Estimate()), 3)  # nothing is known
    0.08
    >>> [round(possible_size(0.05, Estimate(value, 0.01)), 3) for value in (0.0, 0.3)]
    [0.019, 0.316]
    """
    usual = limit / np.sqrt(3.0)
    shares = np.array([1.0 - _GROSS, _GROSS])
    variances = np.array([usual, _GROSS_SIZE * usual]) ** 2
    means = np.zeros(2)
    if np.isfinite(estimate.error):
        total = variances + max(estimate.error, _TINY) ** 2
        exponents = -0.5 * estimate.value**2 / total
        shares = shares * np.exp(exponents - np.max(exponents)) / np.sqrt(total)
        means = estimate.value * variances / total
        variances = variances * estimate.error**2 / total
    shares, deviations = shares / shares.sum(), np.sqrt(np.maximum(variances, _TINY))

    def beyond(size: float) -> float:
        upper = scipy.special.ndtr((size - means) / deviations)
        lower = scipy.special.ndtr((-size - means) / deviations)
        return float(shares @ (upper - lower)) - LEVEL

    largest = float(np.max(np.abs(means) + 10.0 * deviations))
    return float(scipy.optimize.brentq(beyond, 0.0, largest, xtol=1e-6 * largest))


@dataclasses.dataclass(frozen=True)
class PossibleFaults:
    """Changes of coefficients that faults within their tolerances may cause.

    - `parts`: by cause, the standard uncertainty of each coefficient, (p,).
    - `within`: by cause, the size of the fault by 95 %, as text. `SHOWN_SCALE` is there if only
      the tolerance excludes a torque scale of 1.1: what else shows of it by 95 %, or `"nothing"`.
    """

    parts: Mapping[str, Float[np.ndarray, " coefficients"]]
    within: Mapping[str, str]


def possible_faults(
    network: CSLC,
    patterns: Patterns,
    k: Float[np.ndarray, " coefficients"],
    free: Bool[np.ndarray, " coefficients"],
    *,
    scale: Estimate | None = None,
    follow: Float[np.ndarray, "coefficients coefficients"] | None = None,
) -> PossibleFaults:
    """Return what a factor of the torques, a clock and zeros of joints may change a fit by.

    A fault adds torque of first order to that of the motion as it was recorded. Coefficients follow
    a part of it, and the residuals have the rest: this estimates the fault. Its error is by the
    differences of stretches of the recording and of joints, the larger of both, so that what the
    model lacks counts as noise.

    **Arguments**

    - `network`: n joints, p coefficients; `patterns`: that were fitted.
    - `k`: of the fit; `free`: the fitted ones, the others are known.
    - `scale`: what the robot's file says of the factor of the torques, less 1; None if nothing.
    - `follow`: changes of coefficients by those of a fit without prior knowledge; equal if None.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.uncertainty import possible_faults
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> k = np.array([0.5, 0.3, -0.1, 0.2, 0.05])
    >>> patterns = jc.examples.swing(network, k, torque_noise=0.01)
    >>> possible_faults(network, patterns, k, np.ones(5, bool)).within["torque scale"]
    '± 8 %'
    """
    step = max(1, int(np.ceil(patterns.samples / _ROWS)))
    thinned = rows_of(patterns, slice(None, None, step))
    mask = np.asarray(thinned.mask)
    columns = columns_of(network, thinned)
    base = torque_by(network.support, columns, k)
    residual = np.where(mask, np.asarray(thinned.torque) - base, 0.0)
    faults = np.where(mask[..., None], _fault_columns(network, thinned, k, base), 0.0)
    regressor = np.zeros((*mask.shape, network.size))
    for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
        regressor[:, joint, list(support)] = rows.T * mask[:, joint, None]
    regressor = regressor[..., free]
    counts = np.maximum(mask.sum(axis=0), 1)
    squares, sizes = (np.sum(x**2, axis=0) / counts for x in (residual, np.where(mask, base, 0.0)))
    root = 1.0 / np.sqrt(np.maximum(np.maximum(squares, 1e-6 * sizes), _TINY))[:, None]
    root = np.where(sizes[:, None] > 0.0, root, 0.0)
    changes, estimates = _estimates(root * regressor, root * faults, root[..., 0] * residual)
    shifts = np.zeros((network.size, changes.shape[1]))
    shifts[free] = changes
    shifts = shifts if follow is None else follow @ shifts
    estimates[0] = estimates[0].with_other(scale or Estimate())
    names = (TORQUE_SCALE, CLOCK, *(ZEROS for _ in range(network.joint_count)))
    possible = [
        possible_size(TOLERANCES[name].limit, estimate)
        for name, estimate in zip(names, estimates, strict=True)
    ]
    squares = (shifts * np.array(possible) / QUANTILE) ** 2
    parts = {
        name: np.sqrt(np.sum(squares[:, [other == name for other in names]], axis=1))
        for name in TOLERATED
    }
    # The zero of a vertical first axis changes nothing.
    matter = np.sum(faults[..., 2:] ** 2, axis=(0, 1)) > _LEAST_LEFT**2 * np.sum(base**2)
    zeros = np.where(matter, possible[2:], 0.0)
    revolute = all(kind == "R" for kind in network.joint_kinds)
    within = {
        TORQUE_SCALE: f"± {100 * possible[0]:.2g} %",
        CLOCK: f"± {100 * possible[1]:.2g} %",
        ZEROS: f"at most ± {1e3 * np.max(zeros):.2g} {'mrad' if revolute else 'mrad or mm'}",
    }
    shown = abs(estimates[0].value) + QUANTILE * estimates[0].error
    if not np.isfinite(shown):
        within[SHOWN_SCALE] = "nothing"
    elif shown > _CONFIRMED_SCALE:
        rounded = float(f"{100 * shown:.2g}")
        within[SHOWN_SCALE] = f"± {rounded:g} %"
    return PossibleFaults(parts, within)


def _fault_columns(
    network: CSLC,
    patterns: Patterns,
    k: Float[np.ndarray, " coefficients"],
    base: Float[np.ndarray, "samples joints"],
) -> Float[np.ndarray, "samples joints faults"]:
    """Return the torque of each fault, per unit: of the scale, of the clock, of each zero.

    - `base`: the torque of the motion as it was recorded.
    """
    q, qd, qdd = (np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))

    def added(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        moved = dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd)
        torque = torque_by(network.support, columns_of(network, moved), k)
        return (torque - base) / _STEP

    # Times that are too long by a part make speeds too small.
    faster = 1.0 + _STEP
    offsets = _STEP * np.eye(q.shape[1])
    # Positions that are too large by an offset: those of the arm are smaller.
    zeros = [added(q - offset, qd, qdd) for offset in offsets]
    return np.stack([base, added(q, faster * qd, faster**2 * qdd), *zeros], axis=-1)


def _estimates(
    regressor: Float[np.ndarray, "samples joints free"],
    faults: Float[np.ndarray, "samples joints faults"],
    residual: Float[np.ndarray, "samples joints"],
) -> tuple[Float[np.ndarray, "free faults"], list[Estimate]]:
    """Return what coefficients change by with each fault, and the estimate of each, alone.

    All are weighted.
    """
    size = regressor.shape[-1]
    rows = regressor.reshape(-1, size)
    others = np.concatenate([faults, residual[..., None]], axis=-1)
    normal, right = rows.T @ rows, rows.T @ others.reshape(len(rows), -1)
    scales = np.sqrt(np.maximum(np.diag(normal), _TINY))
    values, vectors = np.linalg.eigh(normal / np.outer(scales, scales))
    counted = values > _ROUNDING * max(float(values[-1]), _TINY) if size else np.zeros(0, bool)
    part = vectors[:, counted]
    solved = part @ ((part.T @ (right / scales[:, None])) / values[counted, None])
    solved = solved / scales[:, None]
    changes = solved[:, :-1]
    residual = residual - regressor @ solved[:, -1]
    left = faults - regressor @ changes
    edges = np.linspace(0, len(residual), min(_STRETCHES, len(residual)) + 1).round().astype(int)
    estimates: list[Estimate] = []
    for fault in range(faults.shape[-1]):
        own, whole = left[..., fault], faults[..., fault]
        information = float(np.sum(own**2))
        if information <= _LEAST_LEFT**2 * float(np.sum(whole**2)):
            estimates.append(Estimate())
            continue
        value = float(np.sum(own * residual)) / information
        scores = own * (residual - value * own)
        of_stretches = np.add.reduceat(np.sum(scores, axis=1), edges[:-1])
        # What the model lacks repeats with the motion, but is of another size at every joint: a
        # jackknife over joints.
        rest = information - np.sum(own**2, axis=0)
        others = rest > _LEAST_LEFT * information
        moved = -np.sum(scores, axis=0)[others] / rest[others]
        between = (1.0 - 1.0 / scores.shape[1]) * float(np.sum(moved**2))
        error = float(np.sqrt(max(float(np.sum(of_stretches**2)) / information**2, between)))
        estimates.append(Estimate(value, error))
    return changes, estimates

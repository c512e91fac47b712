"""Lag of a recording's torques behind its positions, from torque and motion alone."""

import dataclasses
from operator import itemgetter

import jax
import numpy as np
import scipy
from jaxtyping import Float

from ..least_squares import (
    Equations,
    HostColumns,
    LeastSquares,
    columns_of,
    equations_of,
    torque_by,
)
from ..network import CSLC
from ..recordings import Butterworth, Patterns, Preparation, Recording, zero_phase
from ._evidence import CUTOFF_OF_RATE, SLOW, Evidence, from_its_start


# The search looks this far to either side, in steps that no motion below the cut-off outruns [s].
# A step is a seventh of a period at the highest cut-off. (Heuristic: drives and buses are late by
# less than the farthest.)
_FARTHEST, _STEP = 0.25, 0.0125
_ENDS = 0.1  # of the recording at most, which lags shift out of it at either end
# It ends here if a lag within explains the torque to e^-3 of it, 5 %, as with right recordings.
_NEAR, _GOOD = 0.1, -3.0
LEAST_LAG = 2e-3
"""Less is no matter [s]: motion at the lowest cut-off turns by 2° within it."""
# Rounds at most, and the step, in standard errors of the lag, that is the last one.
_ROUNDS, _SMALL_STEP = 20, 0.02
_PIECE = 4096  # rows that share one compiled function
# Standard deviation of what looks like a lag at all joints alike (friction at low speed that no
# term describes), in sample intervals: the order of errors on simulated arms with little noise.
_COMMON = 0.025
_LEVEL = 0.95  # of the interval
_MANY = 30.0  # degrees of freedom of one joint's error, which nearly is a normal one
# How much wider than the equations' filter the smoothing of the positions is, and how much narrower
# that of the torque's slope. (Heuristic.)
_APART = 3.0


@dataclasses.dataclass(frozen=True)
class TorqueLag:
    """Lag of a recording's torques behind its positions.

    **Attributes**

    - `lag`: the estimate [s]; negative where torques are early. `Preparation.torque_lag` takes it.
    - `low`, `high`: 95 % interval [s].
    - `gain`: how much smaller the mean logarithm of the joints' torque errors is with it.

    >>> from jaxcslc.checks import TorqueLag
    >>> TorqueLag(0.02, 0.019, 0.021, 1.2).beyond(0.002)
    True
    """

    lag: float
    low: float
    high: float
    gain: float

    def beyond(self, lag: float) -> bool:
        """Return whether the whole interval lies further from zero than a lag [s]."""
        return self.low > lag or self.high < -lag


def estimate_torque_lag(network: CSLC, recording: Recording) -> TorqueLag:
    """Estimate how late the torques of a recording are, from torque and motion alone.

    Positions and torques pass the same low pass, which delays neither. A search takes the shift of
    the torque under which the network predicts held-out torque best. There the lag is one more
    coefficient of the torque equation,

    $Y k = \\tau(t + \\delta_0) + \\dot\\tau(t + \\delta_0)\\,(\\delta - \\delta_0)$,

    fitted together with the others (Gauss-Newton), so that its interval allows for correlation in
    time as theirs do.

    A drive that holds its demand from sample to sample applies it half an interval later, in the
    mean: its torque is *early* by half an interval, which `torque_alignment="mean"` mends.

    **Arguments**

    - `network`: n joints.
    - `recording`: of n joints.

    **Returns** a `TorqueLag`.

    **Raises** `ValueError` for a recording that is too short, or of another number of joints.

    >>> import dataclasses, jaxcslc as jc
    >>> from jaxcslc.checks import estimate_torque_lag
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> swing = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05], samples=2000)
    >>> late = dataclasses.replace(swing.rows(slice(2, None)), torque=swing.torque[:-2])
    >>> round(estimate_torque_lag(network, late).lag, 4)
    0.02
    """
    evidence = Evidence.of(network, from_its_start(recording))
    return _refined(evidence, *_search(evidence))


def torque_lag_of(evidence: Evidence, least: float = 0.0) -> TorqueLag | None:
    """Return the lag of evidence; None if a first look shows less than `least` [s]."""
    coarse, gain = _search(evidence)
    return _refined(evidence, coarse, gain) if abs(coarse) >= least else None


def small_torque_lag(network: CSLC, recording: Recording) -> TorqueLag:
    """Return the lag of torques that are late or early by some samples, without a search.

    **Raises** `ValueError` for a recording that is too short.
    """
    return _refined(Evidence.of(network, from_its_start(recording)), 0.0, 0.0)


def _search(evidence: Evidence) -> tuple[float, float]:
    """Return the best lag of a grid [s], and how much better than no lag it is."""
    from scipy.interpolate import CubicSpline  # 0.09 s of processor time

    patterns = evidence.patterns
    columns = evidence.columns(patterns)
    spline = CubicSpline(evidence.time, evidence.torque)
    time = np.asarray(patterns.time)
    farthest = min(_FARTHEST, _ENDS * float(evidence.time[-1] - evidence.time[0]))
    inside = (time > evidence.time[0] + farthest) & (time < evidence.time[-1] - farthest)
    valid = np.asarray(patterns.backlash_mask) & inside[:, None]

    def score(lag: float) -> float:
        torque = spline(time + lag)
        shifted = dataclasses.replace(patterns, torque=torque, backlash_mask=valid)
        return evidence.score(shifted, columns)

    scores = {0: score(0.0)}

    def best_of(*steps: int) -> int:
        scores.update({at: score(_STEP * at) for at in steps if at not in scores})
        return min(scores, key=scores.__getitem__)

    best = 0
    for reach in (min(_NEAR, farthest), farthest):
        most = int(reach / _STEP) // 2 * 2
        best = best_of(*range(-most, most + 1, 2))
        if abs(best) < most and scores[best] < _GOOD:
            break
    best = best_of(best - 1, best + 1)
    gain = scores[0] - scores[best]
    best_of(best - 1, best + 1)
    before, after = scores[best - 1], scores[best + 1]
    bend = before - 2.0 * scores[best] + after
    between = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return _STEP * (best + float(np.clip(between, -0.5, 0.5))), gain


def _refined(evidence: Evidence, lag: float, gain: float) -> TorqueLag:
    """Fit the lag as one more coefficient of equations whose two sides pass the same filter."""
    network, recording = evidence.network, evidence.recording
    interval = evidence.interval
    preparation = Preparation(
        Butterworth(min(_APART * evidence.cutoff, CUTOFF_OF_RATE / interval)),
        threshold_fraction=SLOW,
    )
    patterns = preparation.patterns(recording)
    trim = preparation.trimmed(recording)
    inside = slice(trim, recording.samples - trim)
    patterns = dataclasses.replace(
        patterns, friction_mask=np.asarray(patterns.friction_mask) & evidence.valid[inside]
    )
    motion = _columns(network, patterns)
    solver = LeastSquares()

    def on_time(equations: Equations) -> Equations:
        shifted = dataclasses.replace(preparation, torque_lag=lag)
        torque = shifted.aligned(recording.time, recording.torque)[inside]
        return equations.with_torque(torque, patterns, evidence.cutoff)

    # The columns of motion are the same in all rounds, and filtered once.
    equations = on_time(equations_of(network, patterns, evidence.cutoff, motion))
    k = solver.coefficients(equations)
    estimate = _Combined(lag, np.inf, 1.0)
    for _ in range(_ROUNDS):
        # The torque as predicted has no noise that would damp the steps, and is smoothed further:
        # noise in the third derivative of the positions is correlated with that in the first,
        # which viscous friction multiplies, and would pass for a lag.
        slope = zero_phase(
            np.gradient(torque_by(network.support, motion, k), interval, axis=0),
            interval,
            cutoff=evidence.cutoff / _APART,
        )
        late = [-_STEP * column[:, None] for column in slope.T]
        late = equations.inputs(late, patterns, evidence.cutoff)
        fit = solver.fit_equations(
            on_time(equations).with_columns(late), patterns.samples, throw=False
        )
        k = np.asarray(fit.k)
        estimate = _Combined.of(
            _STEP * k[network.size :], _STEP * np.asarray(fit.standard_error)[network.size :]
        )
        lag += float(np.clip(estimate.mean, -_STEP, _STEP))
        if abs(estimate.mean) <= _SMALL_STEP * estimate.error:
            break
    error = np.hypot(estimate.error, _COMMON * interval)
    half = float(scipy.special.stdtrit(estimate.degrees_of_freedom, 0.5 + 0.5 * _LEVEL) * error)
    return TorqueLag(lag, lag - half, lag + half, gain)


@dataclasses.dataclass(frozen=True)
class _Combined:
    """A mean of joints' estimates whose errors may be larger than they say.

    What friction and gears do that no term describes looks like a lag, another one at each joint:
    the variance between joints counts as well (DerSimonian and Laird, Controlled Clinical Trials
    7, 1986, doi:10.1016/0197-2456(86)90046-2), and the interval is Student's (Hartung and Knapp,
    Statistics in Medicine 20, 2001, doi:10.1002/sim.1009).
    """

    mean: float
    error: float
    degrees_of_freedom: float

    @classmethod
    def of(
        cls, values: Float[np.ndarray, " joints"], errors: Float[np.ndarray, " joints"]
    ) -> "_Combined":
        usable = np.isfinite(errors) & (errors > 0) & np.isfinite(values)
        values, errors = values[usable], errors[usable]
        if values.size == 0:
            return cls(0.0, np.inf, 1.0)
        if values.size == 1:
            return cls(float(values[0]), float(errors[0]), _MANY)
        weights = errors**-2
        mean = float(np.average(values, weights=weights))
        excess = float(weights @ (values - mean) ** 2) - (values.size - 1)
        freedom = float(weights.sum() - (weights @ weights) / weights.sum())
        # None where one joint outweighs all others by more than rounding shows.
        between = max(0.0, excess / freedom) if freedom > 0.0 else 0.0
        weights = 1.0 / (errors**2 + between)
        mean = float(np.average(values, weights=weights))
        # As many as the joints that have a say, also where none differs from the others beyond its
        # error: that few joints agree does not show that nothing but noise is in them.
        degrees_of_freedom = max(float(weights.sum() ** 2 / (weights @ weights)) - 1.0, 1.0)
        return cls(mean, float(weights.sum() ** -0.5), degrees_of_freedom)


def _columns(network: CSLC, patterns: Patterns) -> HostColumns:
    """Return the regressor's columns, of pieces that share one compiled function."""
    starts = range(0, patterns.samples, _PIECE)
    parts = (jax.tree.map(itemgetter(slice(start, start + _PIECE)), patterns) for start in starts)
    pieces = [columns_of(network, part) for part in parts]
    return tuple(np.concatenate(of_joint, axis=1) for of_joint in zip(*pieces, strict=True))

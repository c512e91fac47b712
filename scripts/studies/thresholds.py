"""Thresholds of static friction from the residuals of a fit, refined until they converge (7.5).

Residuals are binned by speed, and a ramp and a plateau are fitted to the bins.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxcslc import CSLC, Identification, Settings
from jaxcslc._rank import pseudo_inverse
from jaxcslc.least_squares import regressor_of
from jaxcslc.recordings import Patterns, Recording, friction_thresholds


# Each bin of speeds ends at so many times the speed it starts from: narrow enough for a ramp to
# show, wide enough for a joint to be in it for some samples whenever it speeds up or slows down.
_RATIO = 1.35
# A bin that a joint passes through less often has no scatter to speak of.
_FEWEST = 4
# γ is sought from this part of the smallest threshold, below which a ramp has no samples, to this
# part of the greatest speed, above which it has no plateau.
_LEAST, _MOST = 0.5, 0.125
# Of a grid of γ, twice: the second between neighbours of the first, a hundredth apart or less.
_STEPS = 40


class FrictionThresholds(eqx.Module):
    """Static friction that residual torques show, joint by joint.

    **Attributes**

    - `thresholds`: speeds above which it is insignificant, shape `(joints,)` [rad/s or m/s].
    - `significant`: False where no ramp is seen and the threshold stays at its minimum, shape
        `(joints,)`.
    - `excess`: $k^s - k^d$ of Eqn 2.5-4, the height of the ramp at rest, shape `(joints,)`
        [N m or N]; 0 where there is none.
    - `slope_velocity`: its γ, shape `(joints,)` [rad/s or m/s]; 0 where there is none.
    - `significance`: the excess in units of its standard error, shape `(joints,)`.

    >>> import numpy as np
    >>> from scripts.studies.thresholds import thresholds_from_residuals
    >>> qd = np.sin(np.arange(2000) * 0.02)[:, None]
    >>> thresholds_from_residuals(qd, 0.0 * qd).significant.tolist()
    [False]
    """

    thresholds: Float[np.ndarray, " joints"]
    significant: Bool[np.ndarray, " joints"]
    excess: Float[np.ndarray, " joints"]
    slope_velocity: Float[np.ndarray, " joints"]
    significance: Float[np.ndarray, " joints"]


def thresholds_from_residuals(
    qd: Float[np.ndarray, "samples joints"],
    error: Float[np.ndarray, "samples joints"],
    *,
    minimum: Float[np.ndarray, " joints"] | None = None,
    considered: Bool[np.ndarray, "samples joints"] | None = None,
    insignificant: float = 0.01,
    significance: float = 4.0,
) -> FrictionThresholds:
    r"""Find the speed above which static friction is negligible (thesis, Section 7.5).

    A model of viscous and dry friction leaves static friction in its residuals: steep ramps on
    either side of every velocity reversal (Fig. 7.6-4). Taken in the direction of motion, the
    residual of a joint is, by Eqn 2.5-4,
    $(k^s - k^d)\, e^{-|\dot q|/\gamma} + a + b\,|\dot q|$,
    where a and b are what is wrong with the dry and viscous coefficients: ramp and plateau.

    The criterion, instead of a person looking at the ramps:

    - Speeds are divided into bins, each 1.35 times as far up as the one before. Each passage of
      the joint through a bin gives one mean residual. The bin has their median, and a standard
      error from their median deviation: samples next to each other are not independent, and a
      reversal that was smoothed badly is one among many.
    - Ramp and plateau are fitted to the bins by weighted least squares, linear in all but γ,
      which is searched for. The excess must be positive: a reversal whose jump of acceleration
      was smoothed away leaves ramps the other way down.
    - There is static friction to be seen if the excess is `significance` standard errors or more.
    - The threshold is where the fitted ramp has come down to `insignificant` times its height at
      rest (4.6 γ for one hundredth), or to the standard error of the plateau, below which the
      data do not distinguish it from none, whichever comes first.

    Where the acceleration carries a joint through the ramp in less time than the smoothing
    resolves, the ramp looks wider and lower than it is, or is not seen at all.

    **Arguments**

    - `qd`: velocities, shape `(samples, joints)` [rad/s or m/s], in order of time.
    - `error`: measured less predicted torque, of all samples, those below the thresholds of the
        fit included, shape `(samples, joints)` [N m or N].
    - `minimum`: the smallest thresholds allowed, shape `(joints,)` [rad/s or m/s]; slower pairs
        are not looked at. One hundredth of each joint's greatest speed by default.
    - `considered`: the pairs to look at, such as those without backlash, shape
        `(samples, joints)`. All by default.
    - `insignificant`: part of the excess at rest that does not matter.
    - `significance`: how many standard errors the excess must have.

    **Returns**

    The thresholds and what they are taken from.

    **Raises**

    - `ValueError`: a minimum that is not of the joints' number or is negative, or an
        `insignificant` that is not between 0 and 1.

    >>> import numpy as np
    >>> from scripts.studies.thresholds import thresholds_from_residuals
    >>> rng = np.random.default_rng(0)
    >>> qd = np.sin(np.arange(4000) * 0.01)[:, None]
    >>> ramp = 0.5 * np.exp(-np.abs(qd) / 0.05) - 0.1 + 0.05 * np.abs(qd)
    >>> error = np.sign(qd) * ramp + rng.normal(0.0, 0.02, qd.shape)
    >>> static = thresholds_from_residuals(qd, error)
    >>> bool(abs(static.slope_velocity[0] - 0.05) < 0.005)
    True
    >>> bool(0.15 < static.thresholds[0] < 0.25)
    True
    """
    if not 0.0 < insignificant < 1.0:
        raise ValueError(f"insignificant is {insignificant}; expected more than 0 and less than 1")
    joints = qd.shape[1]
    lowest = friction_thresholds(qd, 0.01) if minimum is None else minimum
    if lowest.shape != (joints,) or not np.all(lowest >= 0.0):
        raise ValueError(
            f"minimum thresholds are {lowest.tolist()}; expected one for each of the {joints} "
            "joints, none below 0"
        )
    looked_at = np.ones(qd.shape, dtype=bool) if considered is None else considered
    along_motion = error * np.sign(qd)
    ramps = [
        _ramp(np.abs(qd[:, j]), along_motion[:, j], looked_at[:, j], float(lowest[j]))
        for j in range(joints)
    ]
    excess = np.array([ramp.excess for ramp in ramps])
    gamma = np.array([ramp.gamma for ramp in ramps])
    units = np.array([ramp.significance for ramp in ramps])
    plateau_error = np.array([ramp.plateau_error for ramp in ramps])
    significant = (units >= significance) & (excess > 0.0)
    height = np.where(significant, excess, 1.0)
    negligible = np.clip(np.maximum(plateau_error, insignificant * height) / height, None, 1.0)
    negligible_above = np.where(significant, -gamma * np.log(negligible), 0.0)
    return FrictionThresholds(
        thresholds=np.maximum(negligible_above, lowest),
        significant=significant,
        excess=np.where(significant, excess, 0.0),
        slope_velocity=np.where(significant, gamma, 0.0),
        significance=units,
    )


class _Ramp(eqx.Module):
    """A fitted ramp: its height and width, and the standard errors of it and its plateau."""

    excess: float = 0.0
    gamma: float = 0.0
    significance: float = 0.0
    plateau_error: float = 0.0


class _Bins(eqx.Module):
    """Residuals of one joint by speed, in order of speed."""

    speed: Float[np.ndarray, " bins"]
    residual: Float[np.ndarray, " bins"]
    deviation: Float[np.ndarray, " bins"]


def _ramp(
    speed: Float[np.ndarray, " samples"],
    residual: Float[np.ndarray, " samples"],
    considered: Bool[np.ndarray, " samples"],
    lowest: float,
) -> _Ramp:
    greatest = float(np.max(speed, where=considered, initial=0.0))
    # Without a minimum there is still a lowest speed that bins can start from.
    lowest = max(lowest, 1e-3 * greatest)
    if not lowest < greatest:
        return _Ramp()
    bins = _binned(speed, residual, considered, lowest, greatest)
    # Five bins are the fewest for a ramp of three unknowns and a γ.
    least, most = _LEAST * lowest, _MOST * greatest
    if bins.speed.size < 5 or not least < most or not np.any(bins.deviation > 0.0):
        return _Ramp()

    def misfit(log_gamma: float) -> float:
        coefficients, _, left = _fitted(bins, float(np.exp(log_gamma)))
        # A ramp that goes down is no ramp: as good as none, and worse the further down it goes.
        return left if coefficients[2] > 0.0 else np.inf

    # The misfit may have several minima, and be infinite beside one: a grid, then a finer one
    # between its neighbours.
    grid = np.linspace(np.log(least), np.log(most), _STEPS)
    best = int(np.argmin([misfit(at) for at in grid]))
    finer = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, _STEPS - 1)], _STEPS + 1)
    misfits = np.array([misfit(at) for at in finer])
    if not np.isfinite(misfits.min()):
        return _Ramp()
    gamma = float(np.exp(finer[np.argmin(misfits)]))
    coefficients, covariance, _ = _fitted(bins, gamma)
    excess, deviation = float(coefficients[2]), float(np.sqrt(covariance[2, 2]))
    return _Ramp(excess, gamma, excess / deviation, float(np.sqrt(covariance[0, 0])))


def _fitted(
    bins: _Bins, gamma: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], float]:
    """Plateau, slope and excess, their covariance, and the weighted sum of squares left."""
    basis = np.stack([np.ones_like(bins.speed), bins.speed, np.exp(-bins.speed / gamma)], axis=1)
    weighted = basis / bins.deviation[:, None]
    target = bins.residual / bins.deviation
    inverse = pseudo_inverse(weighted)
    coefficients = inverse @ target
    left = float(np.sum((target - weighted @ coefficients) ** 2))
    # Bins that scatter more than they should make everything less certain, γ's choice included.
    scatter = max(1.0, left / max(bins.speed.size - 4, 1))
    return coefficients, scatter * inverse @ inverse.T, left


def _binned(
    speed: Float[np.ndarray, " samples"],
    residual: Float[np.ndarray, " samples"],
    considered: Bool[np.ndarray, " samples"],
    lowest: float,
    greatest: float,
) -> _Bins:
    count = int(np.ceil(np.log(greatest / lowest) / np.log(_RATIO)))
    edges = np.geomspace(lowest, greatest, count + 1)
    # Bin 0 is below the lowest speed and the last one above the greatest; both are left out.
    number = np.where(considered, np.digitize(speed, edges), 0)
    starts = np.flatnonzero(np.append(True, np.diff(number) != 0))
    mean_speed, mean_residual = _means(speed, starts), _means(residual, starts)
    passed = number[starts]

    speeds: list[float] = []
    medians: list[float] = []
    deviations: list[float] = []
    for bin_number in range(1, count + 1):
        inside = passed == bin_number
        passages = int(np.sum(inside))
        if passages < _FEWEST:
            continue
        median = float(np.median(mean_residual[inside]))
        spread = float(np.median(np.abs(mean_residual[inside] - median)))
        speeds.append(float(np.median(mean_speed[inside])))
        medians.append(median)
        # The standard error of a median, of normal variables whose deviation is 1.48 spreads.
        deviations.append(1.2533 * 1.4826 * spread / np.sqrt(passages))
    deviation = np.array(deviations)
    # A few passages that agree by chance must not outweigh all other bins.
    floor = 0.5 * np.median(deviation) if deviation.size else 0.0
    return _Bins(np.array(speeds), np.array(medians), np.hypot(deviation, floor))


def _means(
    values: Float[np.ndarray, " samples"], starts: Int[np.ndarray, " runs"]
) -> Float[np.ndarray, " runs"]:
    lengths = np.diff(np.append(starts, values.size))
    return np.add.reduceat(values, starts) / lengths


# Thresholds that change by less than this part of themselves have converged: they are known to a
# tenth at best.
_TOLERANCE = 0.05


@dataclasses.dataclass(frozen=True)
class Refinement:
    """Thresholds from a fit's residuals, and the fit that was made with them.

    **Attributes**

    - `settings`: those of the call, with these thresholds; `settings.patterns` prepares other
      recordings alike.
    - `patterns`: the recording under these settings.
    - `fit`: to these patterns.
    - `static_friction`: the ramps in the residuals of the fit before.
    - `rounds`: the thresholds that each fit was made with, from the first to `fit`'s, each (n,)
      [rad/s or m/s].
    - `converged`: whether the last change was small; if not, the rounds ran out.
    """

    settings: Settings
    patterns: Patterns
    fit: Identification
    static_friction: FrictionThresholds
    rounds: tuple[Float[np.ndarray, " joints"], ...]
    converged: bool


def refine_thresholds(
    network: CSLC,
    recording: Recording,
    settings: Settings | None = None,
    *,
    fraction: float = 0.01,
    rounds: int = 4,
) -> Refinement:
    """Fit, take the thresholds of static friction from the residuals, and fit again (7.5).

    The thesis starts with one hundredth of each joint's greatest speed. Once the network fits well
    enough for static friction to show, it updates the thresholds to the speeds above which
    static friction is negligible (Fig. 7.6-4, Fig. B.6-1). With better thresholds the plateau
    beside the ramps is better known, so this goes round until thresholds converge. What the ramps
    are and how they are told from noise: see `thresholds_from_residuals`.

    (On simulated PUMA 560 machines, 10 seeds each: from thresholds of one hundredth to the refined,
    the error of the dry coefficients fell from 1.5 % to 0.7 %, that of the viscous from 3.2 % to
    1.1 %; with twice the γ from 4.0 % to 0.4 % and from 6.9 % to 1.2 %. ε on another trajectory,
    slow pairs included, fell by 13 and 16 %. Joints that turn round quickly did not always show
    their ramps; without static friction, two joints, those of the widest spacings, seemed to have
    some half of the time, which did the fit no harm.)

    A threshold of static friction can be too high for a recording most of which is slower.
    `choose_settings`, which tries fractions of the greatest speed by cross-validation, weighs one
    against the other; this says where static friction ends.

    **Arguments**

    - `network`: n joints.
    - `recording`: of n joints, in order of time.
    - `settings`: all other options, such as those of `choose_settings`; their thresholds are not
      used. Too narrow a spacing buries the ramps in noise, too wide a one smears them: of
      splines, those of `choose_spacing` or a little narrower.
    - `fraction`: of the greatest speeds, to start from; no threshold will be below it.
    - `rounds`: how many times the thresholds are updated at most.

    **Returns** the thresholds, as part of the settings, and patterns and fit under them.

    **Raises**

    - `ValueError`: fewer than one round, or as `Settings.patterns` and `Settings.fit`.
    """
    if rounds < 1:
        raise ValueError(f"{rounds} rounds; expected 1 or more")
    if settings is None:
        settings = Settings()
    current = settings.with_options(threshold_fraction=fraction, thresholds=None)
    patterns = current.patterns(recording)
    minimum = friction_thresholds(np.asarray(patterns.qd), fraction)
    fit = current.fit(network, patterns)
    tried = [minimum]
    converged = False
    while True:
        static = _static_friction(network, patterns, fit, minimum)
        tried.append(static.thresholds)
        current = current.with_options(thresholds=tuple(static.thresholds.tolist()))
        patterns = current.patterns(recording)
        fit = current.fit(network, patterns)
        before, after = tried[-2:]
        converged = bool(np.all(np.abs(after - before) <= _TOLERANCE * after))
        if converged or len(tried) > rounds:
            return Refinement(current, patterns, fit, static, tuple(tried), converged)


def _static_friction(
    network: CSLC,
    patterns: Patterns,
    fit: Identification,
    minimum: Float[np.ndarray, " joints"],
) -> FrictionThresholds:
    predicted = np.asarray(regressor_of(network, patterns) @ fit.k)
    return thresholds_from_residuals(
        np.asarray(patterns.qd),
        np.asarray(patterns.torque) - predicted,
        minimum=minimum,
        considered=np.asarray(patterns.backlash_mask),
    )

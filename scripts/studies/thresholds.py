"""Thresholds of static friction from the residuals of a fit, refined until they converge (7.5)."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxcslc import CSLC, Identification, Settings
from jaxcslc.least_squares import regressor_of
from jaxcslc.recordings import (
    FrictionThresholds,
    Patterns,
    Recording,
    friction_thresholds,
    thresholds_from_residuals,
)


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
    are and how they are told from noise: see `jaxcslc.recordings.thresholds_from_residuals`.

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

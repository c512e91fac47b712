"""The training of Section 7.5 to the letter: masks, rules, rates and end as in the thesis.

Backpropagation, then bouts with PERAL, then the same with better thresholds. `side_by_side` has the
settings that bring training to where the direct solve ends.
"""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
from jaxcslc.recordings import friction_thresholds
from jaxcslc.report import predicted_torque
from jaxcslc.training import (
    PERAL,
    AdaptedRates,
    Backpropagation,
    Plan,
    Schedule,
    Training,
    examples,
    half_rms,
    inverse_dynamics,
    subnetwork_masks,
    train,
)
from scripts.studies.thresholds import FrictionThresholds, thresholds_from_residuals


# Thresholds to begin with, as part of each joint's greatest speed (7.5).
_FIRST_FRACTION = 0.01
# Rates to begin with: small, so that weights that matter little stay near zero (7.5).
_RATES = (AdaptedRates(1e-3), AdaptedRates(0.1))


@dataclasses.dataclass(frozen=True)
class Stage:
    """A training with one set of thresholds.

    **Attributes**

    - `patterns`: of the whole recording.
    - `thresholds`: below which pairs are left out [rad/s].
    - `hand_over`: cost at which PERAL joins: that of the coefficients by direct measurement [N m].
    - `training`: as it ended.
    """

    patterns: jc.Patterns
    thresholds: Float[np.ndarray, " joints"]
    hand_over: float
    training: Training

    @property
    def epochs(self) -> tuple[int, int]:
        """Return the epochs of backpropagation and of PERAL."""
        rule = np.asarray(self.training.history.rule)
        return int(np.sum(rule == 0)), int(np.sum(rule == 1))


@dataclasses.dataclass(frozen=True)
class ThesisRoute:
    """Both trainings of 7.5, and the thresholds in between.

    **Attributes**

    - `first`: with thresholds of one hundredth of each joint's greatest speed.
    - `second`: from its weights on, with thresholds from its residuals.
    - `static_friction`: what these residuals show.
    """

    first: Stage
    second: Stage
    static_friction: FrictionThresholds

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """The coefficients at the end."""
        return self.second.training.weights


def plan_of(
    hand_over: float, least_reduction: float, *, bout: int = 100, frozen: tuple[str, ...] = ()
) -> Plan:
    """Backpropagation alone down to `hand_over`, then bouts of both rules by turns (7.5).

    The training ends when no rule lowers ε by `least_reduction` in an epoch any more [N m].
    """
    schedule = Schedule(
        (Backpropagation(), PERAL()),
        hand_over=hand_over,
        bout=bout,
        least_reduction=least_reduction,
    )
    return Plan(schedule, _RATES, frozen=frozen)


def thesis_route(
    network: jc.CSLC,
    recording: jc.Recording,
    preparation: jc.Preparation,
    measured: Float[Array | np.ndarray, " coefficients"],
    *,
    least_reduction: float = 1e-3,
    epochs: int = 5000,
    progress: bool = False,
    checkpoints: Path | None = None,
) -> ThesisRoute:
    """Identifies coefficients as the thesis does: by training, from zero weights.

    Static friction's thresholds are one hundredth of each joint's greatest speed until the first
    training ends. Its residuals then show where static friction ends (Fig. 7.6-4), and training
    goes on with these thresholds. Slow pairs are left out of the friction subnetworks alone
    (7.2.2), and pairs in possible backlash out of all.

    **Arguments**

    - `network`: without static friction.
    - `recording`: the training recording.
    - `preparation`: smoothing, torque alignment and the mask of backlash; its thresholds are not
        used.
    - `measured`: coefficients by direct measurement, whose cost is that of the hand-over.
    - `least_reduction`: an epoch's, at which training ends [N m]; 0.001 in the thesis.
    - `epochs`: of a training at most.
    - `checkpoints`: a folder to save both trainings in, from which an interrupted run goes on.
    """
    arm = inverse_dynamics(network)
    first_preparation = dataclasses.replace(
        preparation, threshold_fraction=_FIRST_FRACTION, thresholds=None
    )

    def stage(name: str, patterns: jc.Patterns, thresholds: np.ndarray, start: Array) -> Stage:
        training_set = examples(arm, patterns, patterns.torque, subnetwork_masks(arm, patterns))
        hand_over = float(training_set.costs(arm, jnp.asarray(measured), half_rms)[0])
        training = train(
            arm,
            training_set,
            start,
            plan_of(hand_over, least_reduction),
            epochs=epochs,
            keep_weights=False,
            checkpoint=None if checkpoints is None else checkpoints / f"{name}.npz",
            progress=progress,
            throw=False,
        )
        return Stage(patterns, thresholds, hand_over, training)

    patterns = first_preparation.patterns(recording)
    thresholds = friction_thresholds(np.asarray(patterns.qd), _FIRST_FRACTION)
    first = stage("first", patterns, thresholds, jnp.zeros(network.size))
    predicted = np.asarray(predicted_torque(network, patterns, first.training.weights))
    static_friction = thresholds_from_residuals(
        np.asarray(patterns.qd),
        np.asarray(patterns.torque) - predicted,
        minimum=thresholds,
        considered=np.asarray(patterns.backlash_mask),
    )
    later = dataclasses.replace(
        preparation, threshold_fraction=None, thresholds=tuple(static_friction.thresholds.tolist())
    )
    second = stage(
        "second", later.patterns(recording), static_friction.thresholds, first.training.weights
    )
    return ThesisRoute(first, second, static_friction)

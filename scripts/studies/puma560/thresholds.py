"""Thresholds of static friction: what residuals show of them, and what they gain (7.5, B.6)."""

from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.recordings import DEFAULT_THRESHOLD_FRACTION, friction_thresholds
from scripts.studies.puma560.machines import IdentifiedMachine
from scripts.studies.sensitivity import output_sensitivity
from scripts.studies.thresholds import FrictionThresholds, Refinement, thresholds_from_residuals


Rows = list[dict[str, Any]]


def threshold_rows(puma: IdentifiedMachine, refined: Refinement) -> Rows:
    """Thresholds from the residuals beside Fig. B.6, and whether static friction can be seen.

    - `refined`: by `refine_thresholds` under the settings of the fit.

    Residuals are of the fit; of the true friction of the rotors at their true speeds, where
    neither smoothing nor a wrong model is in the way; and of the same with friction that is equal
    in both directions and depends on the rotor's speed alone. The last column is how long a joint
    takes from a reversal to the threshold: what smoothing has to resolve.
    """
    velocity = puma.training.truth.rotor_velocity
    thesis = sim.thesis_coefficients(puma.letter).insignificant_from
    true, ideal = true_ramps(puma.machine, puma.training.truth)
    rows: Rows = []
    for joint in range(velocity.shape[1]):
        rows.append(
            {
                "joint": joint + 1,
                "thesis, and five γ of the plant [rad/s]": float(thesis[joint]),
                "from residuals [rad/s]": float(refined.rounds[-1][joint]),
                "seen in residuals": _yes_or_no(refined.static_friction, joint),
                "seen in true friction": _yes_or_no(true, joint),
                "seen without asymmetry and compliance": _yes_or_no(ideal, joint),
                "from rest to the thesis's speed [samples]": passage(
                    velocity[:, joint], float(thesis[joint])
                ),
            }
        )
    return rows


def _yes_or_no(friction: FrictionThresholds, joint: int) -> str:
    return "yes" if friction.significant[joint] else "no"


def true_ramps(
    machine: sim.Machine, truth: sim.Truth
) -> tuple[FrictionThresholds, FrictionThresholds]:
    """What the same criterion sees in the rotors' true friction, and in friction by Eqn. 2.5-4."""
    velocity = truth.rotor_velocity
    without_static = np.array(machine.viscous) * velocity + np.array(machine.dry) * np.sign(
        velocity
    )
    excess = np.array(machine.static) - np.array(machine.dry)
    law = np.sign(velocity) * excess * np.exp(-np.abs(velocity) / machine.static_velocity)
    minimum = friction_thresholds(velocity, 0.01)
    return (
        thresholds_from_residuals(velocity, truth.friction - without_static, minimum=minimum),
        thresholds_from_residuals(velocity, law, minimum=minimum),
    )


def passage(velocity: Float[np.ndarray, " samples"], threshold: float) -> float:
    """Median number of samples that a joint stays below a speed, on one side of a reversal."""
    slow = np.abs(velocity) < threshold
    sign = np.sign(velocity)
    starts = np.flatnonzero(np.append(True, (np.diff(sign) != 0) | (np.diff(slow) != 0)))
    lengths = np.diff(np.append(starts, velocity.size))
    below = slow[starts] & (sign[starts] != 0)
    return float(np.median(lengths[below])) if below.any() else 0.0


def threshold_fit_rows(network: jc.CSLC, puma: IdentifiedMachine, refined: Refinement) -> Rows:
    """The demo's fit under other thresholds: what better ones would gain.

    Errors of coefficients are weighted by their sensitivity: their mean effect on the torque.
    """
    friction = network.layout.friction
    true = np.asarray(puma.vectors["true"])
    printed = sim.thesis_coefficients(puma.letter).insignificant_from
    settings_of = {
        "as chosen": puma.settings,
        "a hundredth of top speed": puma.settings.with_options(
            threshold_fraction=0.01, thresholds=None
        ),
        "from the residuals, a hundredth where none is seen": refined.settings,
        "from the residuals, as chosen where none is seen": puma.settings.with_options(
            threshold_fraction=None, thresholds=tuple(seen_or_chosen(puma, refined).tolist())
        ),
        "Fig. B.6": puma.settings.with_options(
            threshold_fraction=None, thresholds=tuple(printed.tolist())
        ),
    }
    sensitivity = np.asarray(output_sensitivity(network, puma.patterns))
    rows: Rows = []
    for name, settings in settings_of.items():
        patterns = settings.patterns(puma.training.recording)
        k = settings.fit(network, patterns).k
        effect = (np.asarray(k) - true) * sensitivity
        epsilon = jc.compare(network, puma.comparison_patterns, {"fit": k}).epsilon
        rows.append(
            {
                "thresholds": name,
                "pairs that count [%]": 100 * float(np.mean(patterns.mask)),
                "friction coefficients, RMS error × sensitivity [N m]": rms(effect[friction]),
                "other coefficients, the same [N m]": rms(np.delete(effect, friction)),
                "comparison ε [N m]": float(epsilon[0]),
            }
        )
    return rows


def seen_or_chosen(puma: IdentifiedMachine, refined: Refinement) -> Float[np.ndarray, " joints"]:
    """Thresholds from the residuals where they show static friction, else those of the fit."""
    fraction = puma.settings.preparation.threshold_fraction
    default = friction_thresholds(
        np.asarray(puma.patterns.qd), DEFAULT_THRESHOLD_FRACTION if fraction is None else fraction
    )
    return np.where(refined.static_friction.significant, refined.rounds[-1], default)


def rms(values: Float[np.ndarray, " values"]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))

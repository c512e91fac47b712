"""What the simulator knows: true coefficients and true motion."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc.uncertainty import SystematicError, uncertainty_interval


# Slower than this a joint may stick, where no model of sliding friction predicts its torque.
MOVING = 1e-3  # rad/s
# What intervals allow for, beside the causes of systematic errors.
STANDARD_ERROR, ALL_CAUSES = "standard error", "all causes"


def true_coefficients(network: jc.CSLC, machine: sim.Machine, **friction: Any) -> jax.Array:
    """The coefficients of a machine's links, viscous and dry friction, and other friction."""
    return network.coefficients_from(
        machine.links, viscous=machine.viscous, dry=machine.dry, **friction
    )


def published_coefficients(network: jc.CSLC) -> jax.Array:
    """The PUMA 560's by direct measurement (Ar+LS).

    Links of Armstrong et al., friction of Leahy and Saridis (thesis, Section 7.1).
    """
    robot = jc.puma560()
    assert robot.links is not None
    return network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)


def truth_within_intervals(
    fit: jc.Identification,
    error: SystematicError,
    truth: Float[np.ndarray, " coefficients"],
    level: float = 0.95,
) -> dict[str, Bool[np.ndarray, " coefficients"]]:
    """Whether each coefficient's interval contains the true value, by what intervals allow for.

    **Returns** one vector for the standard error alone, one for each cause of systematic errors
    beside it, and one for all of them.
    """
    allowed: dict[str, SystematicError | None] = {STANDARD_ERROR: None}
    allowed |= {cause: SystematicError({cause: part}) for cause, part in error.parts.items()}
    allowed[ALL_CAUSES] = error
    within: dict[str, np.ndarray] = {}
    for name, some in allowed.items():
        low, high = uncertainty_interval(fit, some, level).T
        within[name] = (low <= truth) & (truth <= high)
    return within


def epsilon(network: jc.CSLC, k: np.ndarray, patterns: jc.Patterns) -> float:
    """The mean error cost [N m] (7.5)."""
    return float(np.asarray(jc.compare(network, patterns, {"": k}).epsilon)[0])


def moving_patterns(
    performed: sim.SimulatedRecording,
    torque: Float[np.ndarray, "samples joints"] | None = None,
) -> jc.Patterns:
    """The links' true motion where they move.

    **Arguments**

    - `torque`: of each sample, by default the torque that made the motion.
    """
    recording, truth = performed
    torque = truth.torque if torque is None else torque
    motion = truth.position, truth.velocity, truth.acceleration
    moving = jc.Preparation(thresholds=MOVING, trim=0)
    return moving.patterns(jc.Recording(recording.time, truth.position, torque), motion)

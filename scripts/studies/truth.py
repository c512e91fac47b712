"""What the simulator knows: true coefficients and true motion."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.motion import as_recorded


# Slower than this a joint may stick, where no model of sliding friction predicts its torque.
MOVING = 1e-3  # rad/s


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
    motion = jc.Recording(
        recording.time, truth.position, torque, truth.velocity, truth.acceleration
    )
    return as_recorded(motion, thresholds=MOVING)

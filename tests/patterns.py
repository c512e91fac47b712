"""Patterns whose torque is a network's own, and the plain least squares that fits them."""

import jax
import numpy as np

import jaxcslc as jc


Motion = tuple[np.ndarray, np.ndarray, np.ndarray]

ORDINARY = jc.LeastSquares(joint_weights="equal", errors="independent")


def patterns_of(
    network: jc.CSLC, k: jax.Array, motion: Motion, noise: np.ndarray | float = 0.0
) -> jc.Patterns:
    """Patterns whose torque is the network's own, plus `noise`; every pair counts."""
    q, qd, qdd = motion
    torque = np.asarray(network.torque(k, q, qd, qdd)) + noise
    everything = np.ones(q.shape, bool)
    return jc.Patterns(0.01 * np.arange(len(q)), q, qd, qdd, torque, everything, everything)

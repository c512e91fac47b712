import jax
import numpy as np
import pytest

import jaxcslc as jc


Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture(scope="session")
def exciting_motion() -> Motion:
    """3,000 random states of six joints: every coefficient shows in them."""
    rng = np.random.default_rng(7)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 3000, 6))
    return q, qd, qdd


ORDINARY = jc.LeastSquares(joint_weights="equal", errors="independent")


def patterns_of(
    network: jc.CSLC, k: jax.Array, motion: Motion, noise: np.ndarray | float = 0.0
) -> jc.Patterns:
    """Patterns whose torque is the network's own, plus `noise`; every pair counts."""
    q, qd, qdd = motion
    torque = np.asarray(network.torque(k, q, qd, qdd)) + noise
    everything = np.ones(q.shape, bool)
    return jc.Patterns(0.01 * np.arange(len(q)), q, qd, qdd, torque, everything, everything)

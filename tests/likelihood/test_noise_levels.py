"""Levels of noise where one kind hides the other."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from tests import arms


K = np.array([0.5, 0.3, -0.1, 0.2])


@pytest.mark.parametrize("torque_noise", [0.5, 2.0])
def test_torque_noise_hides_that_of_positions(torque_noise: float) -> None:
    """Noise of accelerations is there, and would make the inertia too small were it left out."""
    network = arms.pendulum("viscous")
    t = 0.01 * np.arange(600)[:, None]
    q = np.sin(2 * t) + 0.3 * np.sin(5 * t)
    qd, qdd = 2 * np.cos(2 * t) + 1.5 * np.cos(5 * t), -4 * np.sin(2 * t) - 7.5 * np.sin(5 * t)
    torque = np.asarray(network.torque(K, q, qd, qdd))
    deviations = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        recording = jc.Recording(
            t[:, 0],
            q + 1e-4 * rng.normal(size=q.shape),
            torque + torque_noise * rng.normal(size=q.shape),
        )
        result = jc.MaximumLikelihood(torque_sampling="sampled", resolution=(0.0,)).fit(
            network, recording
        )
        assert_allclose(result.position_noise, 1e-4, rtol=0.15)
        assert_allclose(result.torque_noise, torque_noise, rtol=0.2)
        deviations.append((np.asarray(result.k) - K) / np.asarray(result.fit.standard_error))
    assert np.sqrt(np.mean(np.square(deviations))) < 2.2

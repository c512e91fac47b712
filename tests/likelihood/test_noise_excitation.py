"""Motion that hardly excites, which noise of accelerations must not stand in for."""

import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc
from tests import arms


STEP, SAMPLES, COUNT, NOISE = 0.01, 1000, 5e-5, 0.05  # s, -, rad, N m
K = np.array([0.3, 0.4, -0.1, 0.2])

Motion = tuple[Float[np.ndarray, "samples 1"], ...]


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum("viscous")


def sines(*rates: float) -> Motion:
    """Positions, velocities and accelerations of sines of 0.8 rad in all."""
    rate, size = np.array(rates), 0.8 / len(rates)
    angle = rate * STEP * np.arange(SAMPLES)[:, None] + 0.3
    derivatives = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    q, qd, qdd = (size * np.sum(values, axis=1, keepdims=True) for values in derivatives)
    return q, qd, qdd


def recording_of(network: jc.CSLC, motion: Motion) -> jc.Recording:
    rng = np.random.default_rng(3)
    torque = np.asarray(network.torque(K, *motion)) + NOISE * rng.normal(size=(SAMPLES, 1))
    return jc.Recording(STEP * np.arange(SAMPLES), COUNT * np.round(motion[0] / COUNT), torque)


def test_a_single_sine_needs_positions_further_apart(pendulum: jc.CSLC) -> None:
    """A sine's acceleration is its position: only the sine of large angles tells an inertia from
    gravity. Standard errors are to be those of the exact motion, by NumPy."""
    motion = sines(1.3)
    recording = recording_of(pendulum, motion)
    columns = np.asarray(pendulum.regressor(*motion)).reshape(SAMPLES, -1)
    exact = NOISE * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    estimator = jc.MaximumLikelihood(torque_sampling="sampled", errors="independent")
    result = estimator.fit(pendulum, recording)
    error = np.asarray(result.fit.standard_error)
    assert result.every > 1
    assert np.all(np.abs(np.asarray(result.k) - K) < 4 * error)
    assert np.all((error / exact > 0.5) & (error / exact < 2.0))
    assert result.noise_excitation is not None and not result.noise_excitation.excessive
    assert result.spacing is not None
    (first, *_), document = result.spacing.noisy, result.spacing.document()
    assert first.excessive and first.every == 1 and first.line in result.spacing.lines
    assert document["excited_by_noise"][0] == first.document()

    plain = jc.MaximumLikelihood(torque_sampling="sampled", errors="independent", every=1)
    fit = plain.fit(pendulum, recording)
    assert fit.noise_excitation is not None and fit.noise_excitation.excessive
    inertia = pendulum.names.index(fit.noise_excitation.name)
    assert float(fit.fit.standard_error[inertia]) < 0.5 * exact[inertia]


def test_rich_motion_excites_itself(pendulum: jc.CSLC) -> None:
    recording = recording_of(pendulum, sines(1.3, 3.7))
    result = jc.MaximumLikelihood(torque_sampling="sampled").fit(pendulum, recording)
    assert result.every == 1 and result.noise_excitation is not None
    assert result.noise_excitation.ratio == pytest.approx(1.0, abs=0.05)


def test_short_recordings_have_no_wider_spacing() -> None:
    noise = jc.likelihood.NoiseExcitation(2, 3.0, "kB1")
    assert noise.wider_spacing(1000) == 3
    assert noise.wider_spacing(149) is None
    assert jc.likelihood.NoiseExcitation(12, 3.0, "kB1").wider_spacing(10**6) is None

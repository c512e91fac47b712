"""The spacing of positions of an arm that vibrates."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from tests import arms


STEP, SAMPLES, COUNT = 2e-3, 1200, 2e-5
INERTIA, VISCOUS, DAMPING = 0.2, 0.3, 0.03  # of rotor and of link


def compliant_joint(seed: int, frequency: float) -> jc.Recording:
    """A rotor and a link with a spring between them, in closed form; counts of the rotor."""
    rng = np.random.default_rng(seed)
    stiffness = (2 * np.pi * frequency) ** 2 * INERTIA / 2
    damping = 2 * DAMPING * np.sqrt(stiffness * INERTIA / 2)
    matrix = np.zeros((5, 5))
    matrix[:2, 2:4] = np.eye(2)
    spring = np.array([[-1.0, 1.0], [1.0, -1.0]]) / INERTIA
    matrix[2:4, :2], matrix[2:4, 2:4] = stiffness * spring, damping * spring
    matrix[2, 2] -= VISCOUS / INERTIA
    matrix[2, 4] = 1.0 / INERTIA
    advance = scipy.linalg.expm(STEP * matrix)
    time = STEP * np.arange(SAMPLES)
    torque = 2.0 * np.sin(3.1 * time) + 0.5 * rng.normal(size=SAMPLES)
    state, positions = np.zeros(5), np.zeros(SAMPLES)
    for sample, value in enumerate(torque):
        positions[sample] = state[0]
        state[4] = value
        state = advance @ state
    position = COUNT * np.round(positions / COUNT + rng.uniform(-0.5, 0.5))
    return jc.Recording(time, position[:, None], torque[:, None])


@pytest.fixture(scope="module")
def disc() -> jc.CSLC:
    return arms.turntable("viscous")


def test_vibration_needs_positions_further_apart(disc: jc.CSLC) -> None:
    """At every sample, vibration of 60 Hz passes for torque noise, and rotor and link for something
    lighter."""
    recording = compliant_joint(10, 60.0)
    right = jc.MaximumLikelihood(every=3).fit(disc, recording)
    assert_allclose(right.k, [2 * INERTIA, VISCOUS], rtol=2e-3)
    plain = jc.MaximumLikelihood(every=1).fit(disc, recording)
    assert float(plain.k[0]) < 1.3 * INERTIA


def test_noise_of_positions_beyond_that_of_readings_widens_the_spacing(disc: jc.CSLC) -> None:
    recording = compliant_joint(10, 80.0)
    result = jc.MaximumLikelihood().fit(disc, recording)
    assert result.every == 3
    assert_allclose(result.k, [2 * INERTIA, VISCOUS], rtol=2e-3)
    spacing = result.spacing
    assert spacing is not None and spacing.every == result.every
    assert spacing.excess[0] > 1.3 and not spacing.noisy
    assert spacing.lines[-1] == f"every {result.every}, used: vibration averages out"
    assert spacing.document()["every"] == result.every
    near = jc.MaximumLikelihood().fit(disc, recording, start=result)
    assert near.every == result.every and near.spacing is spacing
    assert near.steps < 5

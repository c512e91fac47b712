"""Quantisation: whole counts, and never further off than the phase allows."""

import numpy as np
import pytest

import sim


# Section 7.1 [rad].
RESOLUTION = 1e-3 * np.array([0.10035, 0.073156, 0.117, 0.082663, 0.087376, 0.081885])


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 1.0])
def test_readings_are_whole_counts_near_the_position(phase: float, rng: np.random.Generator):
    encoders = sim.Encoders(RESOLUTION, np.full(6, phase))
    q = rng.normal(size=(500, 6))
    counts = encoders.read(q) / RESOLUTION
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    off = (encoders.read(q) - q) / RESOLUTION
    # floor(x + p) lies in (x + p - 1, x + p].
    assert off.min() > phase - 1 - 1e-9
    assert off.max() <= phase + 1e-9
    assert off.max() - off.min() > 0.9


def test_half_a_count_of_phase_is_rounding(rng: np.random.Generator):
    q = rng.normal(size=(200, 6))
    encoders = sim.Encoders(RESOLUTION, np.full(6, 0.5))
    np.testing.assert_allclose(encoders.read(q), RESOLUTION * np.round(q / RESOLUTION), rtol=1e-15)


def test_reading_a_reading_changes_nothing(rng: np.random.Generator):
    encoders = sim.Encoders(RESOLUTION, np.full(6, 0.4))
    once = encoders.read(rng.normal(size=(200, 6)))
    np.testing.assert_array_equal(encoders.read(once), once)


def test_no_resolution_reads_the_position(rng: np.random.Generator):
    q = rng.normal(size=(10, 2))
    encoders = sim.Encoders(np.array([0.0, 0.5]), np.array([0.3, 0.3]))
    np.testing.assert_array_equal(encoders.read(q)[:, 0], q[:, 0])


def test_the_puma_has_the_thesis_s_resolutions():
    np.testing.assert_allclose(sim.puma560().encoder_resolution, RESOLUTION, rtol=1e-15)


def test_resolutions_are_whole_counts_of_a_motor_turn():
    """Section 7.1's resolutions are 2π / (gear ratio * counts a turn), to four digits."""
    gear = np.array([62.61, 107.36, 53.69, 76.01, 71.91, 76.73])
    counts = np.array([1000, 800, 1000, 1000, 1000, 1000])
    np.testing.assert_allclose(2 * np.pi / (gear * counts), RESOLUTION, rtol=3e-4)

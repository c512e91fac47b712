"""Thresholds from residuals: simulated thresholds are recovered, and none is invented."""

import numpy as np
import pytest

from scripts.studies.thresholds import thresholds_from_residuals


GAMMAS = np.array([0.03, 0.06, 0.1])
EXCESS = np.array([1.3, 0.2, 0.05])


def speeds(samples: int = 6000) -> np.ndarray:
    """Three joints that turn round some thirty times each."""
    time = np.arange(samples) * 0.002
    return 2.0 * np.sin(np.outer(time, [7.1, 8.3, 9.7]) + np.array([0.1, 0.2, 0.3]))


def static_torque(qd: np.ndarray, excess: np.ndarray = EXCESS) -> np.ndarray:
    return excess * np.sign(qd) * np.exp(-np.abs(qd) / GAMMAS)


@pytest.mark.parametrize("plateau", [0.0, -0.3])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_without_noise_the_law_itself_is_found(plateau: float, slope: float) -> None:
    """Whatever wrong dry and viscous coefficients leave beside it."""
    qd = speeds(60000)
    error = static_torque(qd) + plateau * np.sign(qd) + slope * qd
    static = thresholds_from_residuals(qd, error)
    assert np.all(static.significant)
    # A bin's residual belongs to its mean speed but for the ramp's bend within it.
    np.testing.assert_allclose(static.slope_velocity, GAMMAS, rtol=0.1)
    np.testing.assert_allclose(static.excess, EXCESS, rtol=0.1)
    np.testing.assert_allclose(static.thresholds, np.log(100.0) * static.slope_velocity, rtol=0.3)


def test_thresholds_end_where_the_ramp_is_insignificant() -> None:
    qd = speeds(60000)
    rough, fine = (
        thresholds_from_residuals(qd, static_torque(qd), insignificant=part) for part in (0.5, 0.1)
    )
    np.testing.assert_allclose(rough.thresholds, np.log(2.0) * rough.slope_velocity)
    np.testing.assert_allclose(fine.thresholds, np.log(10.0) * fine.slope_velocity)


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_no_static_friction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    qd = speeds()
    # Noise that lasts for some ten samples, as what smoothing leaves does.
    noise = rng.normal(0.0, 0.1, (qd.shape[0] + 9, 3))
    error = np.stack([np.convolve(column, np.ones(10), "valid") for column in noise.T], axis=1)
    static = thresholds_from_residuals(qd, error)
    assert not np.any(static.significant)
    np.testing.assert_allclose(static.thresholds, 0.01 * np.max(np.abs(qd), axis=0))
    assert np.all(static.excess == 0.0) and np.all(static.slope_velocity == 0.0)


def test_jumps_smoothed_away_are_no_static_friction() -> None:
    """They leave ramps the other way down: friction that grows only gradually from a reversal."""
    qd = speeds()
    static = thresholds_from_residuals(qd, -static_torque(qd))
    assert not np.any(static.significant)


def test_single_reversals_do_not_decide(rng: np.random.Generator) -> None:
    """Three of some thirty are smoothed badly."""
    qd = speeds()
    error = static_torque(qd) + rng.normal(0.0, 0.005, qd.shape)
    clean = thresholds_from_residuals(qd, error)
    spoilt = error.copy()
    for joint in range(3):
        turns = np.flatnonzero(np.diff(np.sign(qd[:, joint])))
        for turn in turns[5:20:6]:
            spoilt[turn - 15 : turn + 15, joint] += rng.normal(0.0, 2.0, 30)
    robust = thresholds_from_residuals(qd, spoilt)
    assert np.all(robust.significant)
    np.testing.assert_allclose(robust.thresholds, clean.thresholds, rtol=0.25)


def test_directions_and_units_do_not_matter(rng: np.random.Generator) -> None:
    qd = speeds()
    error = static_torque(qd) + rng.normal(0.0, 0.01, qd.shape)
    static = thresholds_from_residuals(qd, error)
    mirrored = thresholds_from_residuals(-qd, -error)
    np.testing.assert_allclose(mirrored.thresholds, static.thresholds)
    scaled = thresholds_from_residuals(1e3 * qd, 1e-2 * error)
    np.testing.assert_allclose(scaled.thresholds, 1e3 * static.thresholds, rtol=1e-3)
    np.testing.assert_allclose(scaled.excess, 1e-2 * static.excess, rtol=1e-3)


def test_only_considered_pairs_are_looked_at(rng: np.random.Generator) -> None:
    qd = speeds()
    error = static_torque(qd) + rng.normal(0.0, 0.01, qd.shape)
    considered = rng.uniform(size=qd.shape) < 0.7
    spoilt = np.where(considered, error, 1e3)
    static = thresholds_from_residuals(qd, spoilt, considered=considered)
    clean = thresholds_from_residuals(qd, error, considered=considered)
    np.testing.assert_allclose(static.thresholds, clean.thresholds)
    assert np.all(static.significant)


def test_slower_than_the_minimum_is_not_looked_at() -> None:
    qd = speeds()
    minimum = np.array([0.05, 0.1, 0.15])
    error = np.where(np.abs(qd) > minimum, static_torque(qd), -5.0 * np.sign(qd))
    static = thresholds_from_residuals(qd, error, minimum=minimum)
    # Means of runs in a bin know nothing of the slow side: the runs end there.
    assert np.all(static.significant)
    assert np.all(static.thresholds >= minimum)


def test_joints_that_rest_or_move_at_one_speed_have_nothing_to_show() -> None:
    qd = speeds()
    qd[:, 1] = 0.0
    qd[:, 2] = 1.0
    static = thresholds_from_residuals(qd, static_torque(qd))
    assert static.significant.tolist() == [True, False, False]
    assert static.thresholds[1] == 0.0
    assert static.thresholds[2] == pytest.approx(0.01)


def test_wrong_settings() -> None:
    qd = speeds(100)
    with pytest.raises(ValueError, match=r"insignificant is 0\.0; expected more than 0"):
        thresholds_from_residuals(qd, qd, insignificant=0.0)
    with pytest.raises(ValueError, match="expected one for each of the 3 joints"):
        thresholds_from_residuals(qd, qd, minimum=np.array([0.1, -0.1, 0.1]))

"""Joints at rest: which samples these are, and what patterns have there."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import jaxcslc as jc
from jaxcslc.motion import at_rest, rests, runs


INTERVAL, COUNT = 0.002, 1e-5
MOVING, RESTING = 600, 400
DRY, INERTIA = 2.0, 0.5


@pytest.fixture(scope="module")
def recording() -> jc.Recording:
    """A joint that moves, rests while its encoder flickers and its torque drifts, and moves."""
    rng = np.random.default_rng(0)
    time = np.arange(2 * MOVING + RESTING) * INTERVAL
    rate = 2 * np.pi / (MOVING * INTERVAL)
    t = np.concatenate([np.arange(MOVING), np.full(RESTING, MOVING), np.arange(MOVING)]) * INTERVAL
    q, qdd = 1 - np.cos(rate * t), rate**2 * np.cos(rate * t)
    qd = rate * np.sin(rate * t)
    middle = slice(MOVING, MOVING + RESTING)
    q[middle] += COUNT * rng.choice([0.0, 1.0], RESTING)
    torque = INERTIA * qdd + DRY * np.sign(qd)
    torque[middle] = np.linspace(-DRY, DRY, RESTING)
    return jc.Recording(time, COUNT * np.round(q / COUNT)[:, None], torque[:, None])


def test_runs_are_stretches_of_true_rows() -> None:
    mask = np.random.default_rng(1).uniform(size=200) < 0.7
    rebuilt = np.zeros_like(mask)
    for start, end in runs(mask):
        assert mask[start:end].all()
        rebuilt[start:end] = True
    assert_array_equal(rebuilt, mask)


def test_a_reversal_is_no_rest() -> None:
    time = np.arange(2000)[:, None] * INTERVAL
    assert not at_rest(np.cos(5.0 * time)).any()


def test_joints_that_never_move_rest() -> None:
    assert not at_rest(np.zeros((50, 1))).any()  # nothing to be taken for a direction


def test_a_rest_of_readings_needs_the_same_count() -> None:
    position, speed = np.zeros((40, 1)), np.zeros((40, 1))
    position[20:] = COUNT
    of_counts = rests(position, speed, np.array([COUNT]), np.array([1.0]))[:, 0]
    assert_array_equal(np.flatnonzero(~of_counts), [0, 1, 17, 18, 19, 20, 21, 37, 38])


def test_velocity_at_rest_is_zero_and_masks_stay(recording: jc.Recording) -> None:
    preparation = jc.Preparation(jc.AveragedSplines(9))
    patterns = preparation.patterns(recording)
    trim = preparation.trimmed(recording)
    _, qd, qdd = (x[trim:-trim] for x in preparation.derivatives(recording))
    still = at_rest(qd)
    assert still.sum() > 0.9 * RESTING and np.any(qd[still] != 0.0)
    assert np.all(patterns.qd[still] == 0.0)
    assert_array_equal(patterns.qd[~still], qd[~still])
    # Slow joints may speed up: others feel it.
    assert_array_equal(patterns.qdd, qdd)
    assert not patterns.mask[still].any()
    assert_array_equal(patterns.friction_mask, np.abs(qd) > preparation.speed_thresholds(qd))
    # Samples that a user wants to be fitted keep their velocities.
    every = jc.Preparation(jc.AveragedSplines(9), thresholds=0.0).patterns(recording)
    assert_array_equal(every.qd, qd)


def test_friction_that_sticks_is_predicted_in_the_middle(recording: jc.Recording) -> None:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    network = jc.derive(robot.with_friction("dry"), lengths="numeric")
    preparation = jc.Preparation(jc.AveragedSplines(9))
    patterns = preparation.patterns(recording)
    k = np.array([INERTIA, DRY])
    fit = jc.LeastSquares().fit(network, patterns)
    assert np.abs(np.asarray(fit.k) - k).max() < 0.02
    torque = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    still = at_rest(np.asarray(patterns.qd))[:, 0]
    error = (patterns.torque - torque)[still, 0]
    # Torque is uniform between both directions of friction.
    assert np.sqrt(np.mean(error**2)) < 1.05 * DRY / np.sqrt(3)

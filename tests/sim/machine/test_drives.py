"""The motor's response (7.2.3): linear, bent, saturated; delayed by a fixed time."""

import dataclasses
from collections.abc import Callable

import jax
import numpy as np
import pytest

import sim


@pytest.fixture
def drives() -> sim.Drives:
    return sim.Drives(linear=np.array([10.0, np.inf]), most=np.array([20.0, 15.0]))


def test_response_is_its_formula(drives: sim.Drives, rng: np.random.Generator):
    demand = rng.uniform(-40, 40, size=(200, 2))
    response = drives.torque(demand)
    for u, (bent, cut) in zip(demand, response, strict=True):
        size = abs(u[0])
        expected = size if size <= 10 else 10 + 10 * (1 - np.exp(-(size - 10) / 10))
        assert bent == pytest.approx(np.sign(u[0]) * expected, rel=1e-14)
        assert cut == np.clip(u[1], -15, 15)


def test_response_leaves_the_line_smoothly_and_never_exceeds_the_most(drives: sim.Drives):
    near = np.array([10 - 1e-4, 10 + 1e-4])
    slopes = np.diff(drives.torque(np.stack([near, near], axis=1))[:, 0]) / np.diff(near)
    np.testing.assert_allclose(slopes, 1.0, atol=1e-4)
    ramp = np.linspace(0, 1e4, 5000)
    response = drives.torque(np.stack([ramp, ramp], axis=1))
    assert np.all(np.diff(response, axis=0) >= 0) and np.all(response <= [20.0, 15.0])
    np.testing.assert_array_equal(drives.torque(np.zeros(2)), 0.0)


def test_response_under_jax(drives: sim.Drives, rng: np.random.Generator):
    demand = rng.uniform(-40, 40, size=(50, 2))
    expected = drives.torque(demand)
    np.testing.assert_allclose(jax.jit(jax.vmap(drives.torque))(demand), expected, rtol=1e-14)


def test_a_bent_drive_shows_in_the_truth_only():
    machine = dataclasses.replace(sim.puma560(), linear_torque=(15.0,) * 6)
    recording, truth = sim.simulate(machine, sim.training(samples=50))
    bent = np.abs(recording.torque) > 15.0
    assert bent.any() and not bent.all()
    np.testing.assert_array_equal(truth.torque[~bent], recording.torque[~bent])
    assert np.all(np.abs(truth.torque[bent]) < np.abs(recording.torque[bent]))
    expected = sim.Drives.of(machine).torque(recording.torque)
    np.testing.assert_array_equal(truth.torque, expected)


def test_a_delayed_torque_acts_late(one_joint: Callable[..., sim.Machine]):
    """Half of each interval has the demand before, on whatever steps: its impulse is exact."""
    for delay, step in ((1e-3, 5e-4), (7e-4, 5e-4), (3e-4, 2e-3)):
        machine = one_joint(inertia=0.5, torque_delay=delay, time_step=step)
        controller = sim.SinusoidalTorque(np.array([3.0]), np.array([0.1]), np.array([0.3]))
        recording, truth = sim.simulate(
            machine, sim.Trajectory("wave", np.zeros(1), controller, 50)
        )
        before = np.concatenate([np.zeros((1, 1)), recording.torque[:-1]])
        impulse = delay * before + (0.002 - delay) * recording.torque
        np.testing.assert_allclose(np.diff(truth.velocity, axis=0), impulse[:-1] / 0.5, atol=1e-12)
        if delay >= step:
            np.testing.assert_array_equal(truth.torque, before)


def test_a_delay_of_an_interval_is_refused(one_joint: Callable[..., sim.Machine]):
    machine = one_joint(inertia=1.0, torque_delay=0.002)
    controller = sim.SinusoidalTorque(np.ones(1), np.ones(1), np.ones(1))
    with pytest.raises(sim.MachineError, match=r"torque_delay is 0\.002 s; expected less than"):
        sim.simulate(machine, sim.Trajectory("wave", np.zeros(1), controller, 5))

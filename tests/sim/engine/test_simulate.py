"""Recordings of the PUMA 560's two trajectories, against the thesis's figures and algebra."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import numpy as np
import pytest

import sim


TRAJECTORIES = ["training", "comparison"]


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_truth_obeys_the_rigid_links_equation(
    name: str,
    performed: dict[str, sim.SimulatedRecording],
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]],
):
    truth = performed[name].truth
    rigid = inverse_dynamics(sim.puma560().robot)(
        truth.position, truth.velocity, truth.acceleration
    )
    # The constraint solver's own accuracy; the torques are some 50 N m.
    np.testing.assert_allclose(rigid + truth.friction, truth.torque, atol=1e-11)


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_recordings_are_the_truth_in_counts(
    name: str, performed: dict[str, sim.SimulatedRecording]
):
    recording, truth = performed[name]
    resolution = np.array(sim.puma560().encoder_resolution)
    counts = recording.position / resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs((recording.position - truth.position) / resolution).max() <= 1.0
    np.testing.assert_array_equal(recording.torque, truth.torque)  # no drive at its limit
    np.testing.assert_array_equal(recording.time, truth.time)
    np.testing.assert_allclose(np.diff(recording.time), 0.002, rtol=1e-9)
    assert recording.velocity is None and recording.acceleration is None


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_truth_is_one_motion(name: str, performed: dict[str, sim.SimulatedRecording]):
    """Velocity is the derivative of position, and acceleration begins each interval's velocity."""
    truth = performed[name].truth
    moved = np.diff(truth.position, axis=0) / 0.002
    mean = (truth.velocity[1:] + truth.velocity[:-1]) / 2
    # The mean of two velocities is the mean velocity, up to a change of acceleration in between.
    np.testing.assert_allclose(moved, mean, atol=0.01)
    np.testing.assert_allclose(np.median(np.abs(moved - mean), axis=0), 0.0, atol=2e-4)
    changed = np.diff(truth.velocity, axis=0) / 0.002
    off = np.abs(changed - truth.acceleration[:-1])
    np.testing.assert_allclose(np.median(off, axis=0), 0.0, atol=0.3)


def test_row_n_is_demanded_at_sample_n_and_acts_until_the_next(
    one_joint: Callable[..., sim.Machine],
):
    machine = one_joint(inertia=0.5)
    controller = sim.SinusoidalTorque(np.array([3.0]), np.array([0.1]), np.array([0.3]))
    recording, truth = sim.simulate(machine, sim.Trajectory("wave", np.zeros(1), controller, 50))
    np.testing.assert_allclose(
        recording.torque[:, 0], 3 * np.sin(20 * np.pi * recording.time + 0.3), rtol=1e-12
    )
    np.testing.assert_allclose(truth.acceleration, recording.torque / 0.5, rtol=1e-9)
    np.testing.assert_allclose(
        np.diff(truth.velocity, axis=0), 0.002 * recording.torque[:-1] / 0.5, atol=1e-12
    )


def test_peak_torques_of_the_comparison_trajectory():
    """What quantised rates add to a peak is noise; without it the peaks are a property."""
    machine = dataclasses.replace(sim.puma560(), encoder_resolution=(0.0,) * 6, start_spread=0.0)
    recording, _ = sim.simulate(machine, sim.comparison())
    peaks = np.abs(recording.torque).max(axis=0)
    np.testing.assert_allclose(peaks, [13.7, 39.0, 8.2, 1.6, 1.5, 1.7], atol=0.051)
    reported = np.array([13.6, 42.8, 8.59, 1.44, 1.77, 1.76])
    np.testing.assert_allclose(peaks, reported, rtol=0.25)


def test_quantised_peak_torques_are_near_the_reported_ones(
    performed: dict[str, sim.SimulatedRecording],
):
    peaks = np.abs(performed["comparison"].recording.torque).max(axis=0)
    np.testing.assert_allclose(peaks, [13.6, 42.8, 8.59, 1.44, 1.77, 1.76], rtol=0.3)


def test_the_comparison_trajectory_ends_where_it_should(
    performed: dict[str, sim.SimulatedRecording],
):
    truth = performed["comparison"].truth
    right = np.pi / 2
    start, end = [0, -right, right, 0, 0, 0], [-right, 0, 0, right, right, right]
    np.testing.assert_allclose(truth.position[0], start, atol=sim.puma560().start_spread)
    np.testing.assert_allclose(truth.position[-1], end, atol=0.005)
    np.testing.assert_allclose(truth.velocity[[0, -1]], 0.0, atol=0.02)
    assert truth.time[-1] == 2.5


def test_the_training_trajectory_sweeps_and_stays_off_the_ends(
    performed: dict[str, sim.SimulatedRecording],
):
    truth = performed["training"].truth
    assert truth.position.shape == (3300, 6)
    swept = np.degrees(np.ptp(truth.position, axis=0))
    assert np.all(swept > [180, 60, 90, 90, 60, 40]), swept
    low, high = np.array(sim.puma560().position_range).T
    clearance = np.degrees(np.minimum(truth.position - low, high - truth.position).min(axis=0))
    assert np.all(clearance > 15), clearance
    np.testing.assert_array_equal(truth.velocity[0], 0.0)


def test_a_seed_is_a_recording():
    machine, trajectory = sim.puma560(), sim.training(samples=200)
    one, again, other = (sim.simulate(machine, trajectory, seed=seed) for seed in (1, 1, 2))
    assert eqx.tree_equal(one, again)
    assert not np.any(np.all(one.recording.position == other.recording.position, axis=0))
    # The start differs, and the phase by more than that.
    assert np.all(np.abs(one.truth.position[0] - trajectory.start) <= machine.start_spread)


def test_seeds_differ_in_phase_alone_without_a_start_spread():
    machine = dataclasses.replace(sim.puma560(), start_spread=0.0)
    one, other = (sim.simulate(machine, sim.training(samples=50), seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(one.truth.position[0], other.truth.position[0])
    assert not eqx.tree_equal(one.recording.position, other.recording.position)


def test_a_drive_at_its_limit_shows_in_the_truth_only():
    machine = dataclasses.replace(
        sim.puma560(), maximum_torque=(97.6, 186.4, 89.4, 24.2, 20.1, 7.0)
    )
    recording, truth = sim.simulate(machine, sim.training(samples=20))
    assert recording.torque[0, 5] == pytest.approx(-14.0)
    np.testing.assert_array_equal(truth.torque[:, 5], -7.0)


def test_leaving_the_range_is_refused():
    smooth = dataclasses.replace(
        sim.puma560(), viscous=(0.0,) * 6, dry=(0.0,) * 6, static=(0.0,) * 6
    )
    with pytest.raises(sim.SimulationError, match=r"training trajectory, .* joint 4 is at -1\.9"):
        sim.simulate(smooth, sim.training())


def test_a_trajectory_for_another_machine_is_refused(one_joint: Callable[..., sim.Machine]):
    with pytest.raises(sim.MachineError, match="starts with 6 joints; the machine has 1"):
        sim.simulate(one_joint(inertia=1.0), sim.training())
    with pytest.raises(sim.MachineError, match="has 0 samples"):
        sim.training(samples=0)
    with pytest.raises(sim.MachineError, match="sample interval of 0"):
        dataclasses.replace(sim.training(), sample_interval=0.0)

"""Faults: readings of the controller, torques of the drives, and the recording."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import sim
from jaxcslc.control import AbstractController


class Witness(AbstractController):
    """Demands the sine of time; its state is the time [s] and the latest reading."""

    @property
    def array_generic(self) -> bool:
        return True

    def begin(self, q: Any) -> Any:
        return 0.0, q

    def step(
        self, state: Any, reference: Any, q: Any, interval: Any, qd: Any = None
    ) -> tuple[Any, Any]:
        time, _ = state
        return np.full_like(np.asarray(q), np.sin(20 * time)), (time + interval, q)


def _watched(
    one_joint: Callable[..., sim.Machine], *faults: sim.Fault, samples: int = 40
) -> tuple[sim.ClosedLoop, np.ndarray]:
    trajectory = sim.Trajectory("watched", np.zeros(1), Witness(), samples, faults=faults)
    machine = one_joint(inertia=0.1)
    (result,) = sim.close_loop(
        [machine], trajectory, [0], observe=lambda state: {"reading": state[1]}
    )
    assert not isinstance(result, sim.SimulationError)
    return result, result.observed["reading"]


def test_without_faults_the_controller_gets_the_recorded_readings(
    one_joint: Callable[..., sim.Machine],
):
    result, reading = _watched(one_joint)
    np.testing.assert_array_equal(reading, result.recording.position)
    np.testing.assert_array_equal(reading, result.truth.position)
    assert not result.truth.lost.any()


def test_lost_samples_are_not_numbers_and_the_recording_repeats_the_last(
    one_joint: Callable[..., sim.Machine],
):
    result, reading = _watched(one_joint, sim.Fault("lost samples", 1, 0.02, 0.03))
    lost = np.zeros((40, 1), bool)
    lost[10:15] = True
    np.testing.assert_array_equal(np.isnan(reading), lost)
    np.testing.assert_array_equal(result.truth.lost, lost)
    recorded, true = result.recording.position, result.truth.position
    np.testing.assert_array_equal(recorded[~lost], true[~lost])
    np.testing.assert_array_equal(recorded[10:15], np.broadcast_to(true[9], (5, 1)))


def test_a_stuck_encoder_keeps_its_reading(one_joint: Callable[..., sim.Machine]):
    result, reading = _watched(one_joint, sim.Fault("stuck encoder", None, 0.02, 0.03))
    true = result.truth.position
    np.testing.assert_array_equal(reading[10:15], np.broadcast_to(true[10], (5, 1)))
    np.testing.assert_array_equal(reading[15:], true[15:])
    assert np.all(np.diff(true[5:20, 0]) > 0)
    np.testing.assert_array_equal(reading, result.recording.position)


def test_a_reversed_drive_gives_minus_what_is_demanded(one_joint: Callable[..., sim.Machine]):
    result, _ = _watched(one_joint, sim.Fault("reversed torque", 1, 0.02))
    sense = np.where(result.recording.time < 0.02 - 1e-9, 1.0, -1.0)[:, None]
    np.testing.assert_array_equal(result.truth.torque, sense * result.recording.torque)
    np.testing.assert_allclose(result.truth.acceleration, result.truth.torque / 0.1, rtol=1e-9)


def test_a_fault_is_of_its_joint_alone():
    trajectory = dataclasses.replace(
        sim.comparison(), samples=30, faults=(sim.Fault("stuck encoder", 3, 0.0),)
    )
    recording, truth = sim.simulate(sim.puma560(), trajectory)
    assert np.all(recording.position[:, 2] == recording.position[0, 2])
    others = np.array([0, 1, 3, 4, 5])
    off = np.abs(recording.position - truth.position)[:, others]
    assert np.all(off <= np.array(sim.puma560().encoder_resolution)[others])


def test_a_controller_that_demands_no_number_is_an_error_that_names_it():
    trajectory = dataclasses.replace(
        sim.comparison(), samples=30, faults=(sim.Fault("lost samples", 2, 0.01),)
    )
    with pytest.raises(sim.SimulationError, match=r"0\.01 s: joint 2: its controller demands nan"):
        sim.simulate(sim.puma560(), trajectory)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (("broken wire", 1, 0.0), "fault is 'broken wire'; expected one of 'lost samples'"),
        (("stuck encoder", 0, 0.0), "fault of joint 0; expected joints counted from 1"),
        (("stuck encoder", 1, -1.0), "fault starts at -1.0 s"),
    ],
)
def test_faults_that_cannot_be_are_refused(fault: tuple[Any, ...], message: str):
    with pytest.raises(sim.MachineError, match=message):
        sim.Fault(*fault)


def test_a_fault_of_a_joint_that_there_is_not_is_refused(one_joint: Callable[..., sim.Machine]):
    with pytest.raises(sim.MachineError, match="fault of joint 2; the machine has 1"):
        _watched(one_joint, sim.Fault("stuck encoder", 2, 0.0))

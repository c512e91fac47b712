"""Motion that is simulated beside a recording: MuJoCo's, and what is wrong with it."""

import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.control import PID, Reference
from jaxcslc.instruments import AbstractSimulatedMotion, ControlledMotion, CorrectedMotion
from jaxcslc.instruments._simulation import simulated_derivatives
from jaxcslc.recordings import Recording
from tests import arms


SAMPLES = 500
# Half a millisecond of MuJoCo's first-order steps against second-order ones of 2 ms.
OF_POSITION, OF_VELOCITY = 4e-4, 2e-3


@pytest.fixture(scope="module")
def simulated_puma() -> tuple[jc.CSLC, np.ndarray, sim.SimulatedRecording, ControlledMotion]:
    """The beginning of the comparison trajectory, without disturbances."""
    machine = sim.undisturbed(sim.puma560())
    trajectory = sim.comparison(duration=2.5)
    recording, truth = sim.simulate(machine, trajectory)
    assert trajectory.path is not None
    origin = np.broadcast_to(recording.position[0], recording.position.shape)
    reference = trajectory.path.reference(recording.time[:, None], origin)
    network = jc.derive(machine.robot)
    k = network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
    motion = ControlledMotion(trajectory.controller, reference)
    return network, np.asarray(k), sim.SimulatedRecording(recording, truth), motion


def test_mujoco_moves_alike_under_the_same_controller(
    simulated_puma: tuple[jc.CSLC, np.ndarray, sim.SimulatedRecording, ControlledMotion],
) -> None:
    network, k, (recording, truth), motion = simulated_puma
    q, qd, _ = motion.simulate(network, k, recording, jc.Settings())
    assert np.max(np.abs(q - truth.position)) < OF_POSITION
    assert np.max(np.abs(qd - truth.velocity)) < 10 * OF_VELOCITY
    assert np.sqrt(np.mean((qd - truth.velocity) ** 2)) < OF_VELOCITY


def test_recorded_torques_make_the_recorded_motion(
    simulated_puma: tuple[jc.CSLC, np.ndarray, sim.SimulatedRecording, ControlledMotion],
) -> None:
    network, k, (recording, truth), _ = simulated_puma
    held = jc.Settings(jc.Preparation(torque_alignment="mean"))
    q, qd, _ = CorrectedMotion().simulate(network, k, recording, held)
    assert np.max(np.abs(q - truth.position)) < OF_POSITION
    assert np.sqrt(np.mean((qd - truth.velocity) ** 2)) < OF_VELOCITY


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum("viscous")


K = np.array([0.5, 0.3, -0.1, 0.2])


def swing(network: jc.CSLC, k: np.ndarray = K) -> Recording:
    t = 0.01 * np.arange(SAMPLES)[:, None]
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    return Recording(t[:, 0], q, np.asarray(network.torque(k, q, qd, qdd)))


def test_a_model_that_is_wrong_is_corrected_by_the_bandwidth(pendulum: jc.CSLC) -> None:
    """A constant error a of acceleration leaves about a / rate² of position."""
    level = K * [1, 0, 0, 0]  # gravity would act as a spring, friction as a damper
    recording = swing(pendulum, level)
    pushed = Recording(recording.time, recording.position, recording.torque + 0.5 * 0.1)
    for bandwidth in (1.0, 2.0):
        q, _, _ = CorrectedMotion(bandwidth).simulate(pendulum, level, pushed, jc.Settings())
        off = np.mean((q - recording.position)[SAMPLES // 2 :])
        kept = np.exp(-2 * np.pi * bandwidth * 0.01)
        np.testing.assert_allclose(off, 0.1 * (0.01 * kept / (1 - kept)) ** 2, rtol=0.01)


def test_accelerations_are_those_of_the_torques(pendulum: jc.CSLC) -> None:
    recording = swing(pendulum)
    held = jc.Settings(jc.Preparation(torque_alignment="mean"))
    q, qd, qdd = CorrectedMotion().simulate(pendulum, K, recording, held)
    torque = np.asarray(pendulum.torque(K, q, qd, qdd))
    mean = 0.5 * (recording.torque[1:-1] + recording.torque[:-2])
    np.testing.assert_allclose(torque[1:-1], mean, atol=5e-3)


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, np.inf, np.nan])
def test_bandwidths_that_are_none(bandwidth: float) -> None:
    with pytest.raises(ValueError, match="expected a positive number"):
        CorrectedMotion(bandwidth)


def test_a_reference_of_another_length(pendulum: jc.CSLC) -> None:
    rows = np.zeros((7, 1))
    motion = ControlledMotion(PID(1, position_gain=1.0, velocity_gain=1.0), Reference(*[rows] * 3))
    with pytest.raises(ValueError, match=r"shape \(7, 1\); expected a first axis of 500 samples"):
        motion.simulate(pendulum, K, swing(pendulum), jc.Settings())


def test_motion_that_is_lost_is_named(pendulum: jc.CSLC) -> None:
    recording = swing(pendulum)
    far = np.full((SAMPLES, 1), 9.0)
    pid = PID(1, position_gain=50.0, velocity_gain=10.0)
    lost: AbstractSimulatedMotion = ControlledMotion(pid, Reference(far, 0 * far, 0 * far))
    with pytest.raises(RuntimeError, match="does not follow the recording: joint 1 is"):
        simulated_derivatives(lost, pendulum, K, recording, jc.Settings())

"""Controllers: their formulas, their limits, and that batches are rows."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import sim
from jaxcslc.manipulator import Manipulator, puma560


def test_minimum_jerk_is_a_rest_to_rest_quintic():
    s = np.linspace(0, 1, 11)
    path = np.polynomial.Polynomial.fit(s, [sim.minimum_jerk(float(x)) for x in s], 5)
    path = path.convert()
    assert path.degree() == 5
    for derivative in (path.deriv(1), path.deriv(2)):
        np.testing.assert_allclose([derivative(0.0), derivative(1.0)], 0.0, atol=1e-9)
    assert [sim.minimum_jerk(x) for x in (-0.5, 0.0, 1.0, 3.0)] == [0.0, 0.0, 1.0, 1.0]


def test_gravity_compensation_is_gravity_without_the_wrist(
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]], rng: np.random.Generator
):
    robot = puma560()
    assert robot.links is not None
    hand = dataclasses.replace(robot.links[5], centre_of_gravity=np.zeros(3))  # k2G = 0
    q, still = rng.normal(size=(50, 6)), np.zeros((50, 6))
    gravity = inverse_dynamics(robot, (*robot.links[:5], hand))(q, still, still)
    np.testing.assert_allclose(
        sim.AbbreviatedGravity.of(robot).torque(q), gravity, atol=1e-12 * np.abs(gravity).max()
    )
    # What is left out is small: the hand's 0.09 kg at 0.032 m.
    whole = inverse_dynamics(robot)(q, still, still)
    assert np.abs(whole - gravity).max() < 0.09 * 0.032 * 9.81 * 1.5


def test_gravity_compensation_is_for_a_puma():
    robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0)], name="stick")
    with pytest.raises(sim.MachineError, match="robot 'stick': this gravity compensation is the P"):
        sim.AbbreviatedGravity.of(robot)
    with pytest.raises(sim.MachineError, match="expected it along the z axis"):
        sim.AbbreviatedGravity.of(puma560().with_gravity((1.0, 0.0, -9.81)))


def test_repulsion_pushes_inwards_and_only_near_an_end():
    repulsion = sim.Repulsion(np.array([[-2.0, 1.0]]), np.array([40.0]))
    q = np.array([-5.0, -2.0, -1.5, -0.5, 0.5, 1.0, 5.0])[:, None]
    torque = repulsion.torque(q)[:, 0]
    np.testing.assert_allclose(torque[[1, 5]], [40.0, -40.0], rtol=1e-9)
    np.testing.assert_allclose(torque[[0, 6]], [40 * np.e, -40 * np.e])
    np.testing.assert_allclose(torque[2:5], 0.0, atol=40 * np.exp(-9.9))


def test_repulsion_turns_a_driven_joint_back(one_joint: Callable[..., sim.Machine]):
    machine = one_joint(inertia=0.5, viscous=(5.0,), position_range=((-1.0, 1.0),))
    controller = sim.SinusoidalTorque(
        np.array([5.0]),
        np.array([1e9]),
        np.array([np.pi / 2]),  # in effect 5 N m for ever
        repulsion=sim.Repulsion(np.array(machine.position_range), np.array([50.0])),
    )
    _, truth = sim.simulate(machine, sim.Trajectory("push", np.zeros(1), controller, 3000))
    assert truth.position.max() < 1.0  # or simulate would have refused
    # It comes to rest where repulsion equals the push: 50 exp(-x / 0.05) = 5.
    np.testing.assert_allclose(truth.position[-1], 1 - 0.05 * np.log(10), atol=1e-3)
    free = dataclasses.replace(controller, repulsion=None)
    with pytest.raises(
        sim.SimulationError, match=r"push trajectory, .* s: joint 1 is at 1.*, outside"
    ):
        sim.simulate(machine, sim.Trajectory("push", np.zeros(1), free, 3000))


def test_sinusoids_have_the_given_amplitude_period_and_phase():
    controller = sim.SinusoidalTorque(np.array([2.0]), np.array([0.8]), np.array([1.5 * np.pi]))
    at = np.zeros(1)
    torque = [float(controller.demand(None, t, at)[0][0]) for t in (0.0, 0.2, 0.4, 0.8)]
    np.testing.assert_allclose(torque, [-2.0, 0.0, 2.0, -2.0], atol=1e-14)


def test_pid_is_its_formula_on_a_moving_arm():
    """On an arm that stands still while the path moves on; no filter, so rates are differences."""
    pid = sim.PID(
        end=np.array([1.0]),
        duration=1.0,
        position_gain=np.array([100.0]),
        integral_gain=np.array([7.0]),
        velocity_gain=np.array([3.0]),
        cut_off=1e9,
    )
    state = pid.begin(np.zeros(1))
    torque, state = pid.demand(state, 0.0, np.zeros(1))
    assert torque[0] == 0.0
    errors = [sim.minimum_jerk(0.25), sim.minimum_jerk(0.5)]
    pid_torque = []
    for time in (0.25, 0.5):
        torque, state = pid.demand(state, time, np.zeros(1))
        pid_torque.append(float(torque[0]))
    expected = [
        100 * errors[0] + 7 * 0.25 * errors[0] + 3 * errors[0] / 0.25,
        100 * errors[1] + 7 * 0.25 * sum(errors) + 3 * (errors[1] - errors[0]) / 0.25,
    ]
    np.testing.assert_allclose(pid_torque, expected, rtol=1e-12)


def test_pid_filter_has_its_cut_off():
    """A ramp of the error is followed with the low pass's time constant, 1 / (2π cut-off)."""
    pid = sim.PID(np.zeros(1), 1.0, np.zeros(1), np.zeros(1), np.ones(1), cut_off=10.0)
    state = pid.begin(np.zeros(1))
    interval, torque = 1e-4, np.zeros(1)
    for sample in range(round(1 / (2 * np.pi * 10.0) / interval) + 1):
        torque, state = pid.demand(state, sample * interval, np.array([-sample * interval]))
    np.testing.assert_allclose(torque, 1 - np.exp(-1), rtol=1e-2)


@pytest.mark.parametrize("make", [sim.training, sim.comparison])
def test_a_batch_is_its_rows(make: Callable[[], sim.Trajectory], rng: np.random.Generator):
    trajectory = make()
    controller = trajectory.controller
    positions = trajectory.start + 0.1 * rng.normal(size=(3, 4, 6))  # samples, batch, joints
    together = controller.begin(positions[0])
    apart = [controller.begin(position) for position in positions[0]]
    for sample, position in enumerate(positions):
        torque, together = controller.demand(together, 0.002 * sample, position)
        for i in range(4):
            row, apart[i] = controller.demand(apart[i], 0.002 * sample, position[i])
            np.testing.assert_array_equal(torque[i], row)

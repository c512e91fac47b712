"""Controllers: their formulas, their limits, and that batches are rows."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import Manipulator, puma560
from sim.trajectory._paths import MinimumJerk, Oscillation


# Sines and exponentials of two libraries, added up over a loop that amplifies a little.
_ROUNDING = 1e-11


def _swing() -> sim.Trajectory:
    """The comparison trajectory's arm, made to oscillate."""
    trajectory = sim.comparison()
    assert isinstance(trajectory.controller, sim.PID)
    path = Oscillation(trajectory.start + 0.1, np.full(6, 0.1), 0.3)
    controller = dataclasses.replace(trajectory.controller, path=path)
    return dataclasses.replace(trajectory, controller=controller)


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


def test_sinusoids_have_the_given_amplitude_period_and_phase():
    controller = sim.SinusoidalTorque(np.array([2.0]), np.array([0.8]), np.array([1.5 * np.pi]))
    at = np.zeros(1)
    torque = [float(controller.demand(None, t, at)[0][0]) for t in (0.0, 0.2, 0.4, 0.8)]
    np.testing.assert_allclose(torque, [-2.0, 0.0, 2.0, -2.0], atol=1e-14)


def test_pid_is_its_formula_on_a_moving_arm():
    """On an arm that stands still while the path moves on; no filter, so rates are differences."""
    pid = sim.PID(
        MinimumJerk(np.array([1.0]), 1.0),
        position_gain=np.array([100.0]),
        integral_gain=np.array([7.0]),
        velocity_gain=np.array([3.0]),
        cut_off=1e9,
    )
    state = pid.begin(np.zeros(1))
    torque, state = pid.demand(state, 0.0, np.zeros(1))
    assert torque[0] == 0.0
    errors = sim.minimum_jerk(np.array([0.25, 0.5]))
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
    pid = sim.PID(MinimumJerk(np.zeros(1), 1.0), np.zeros(1), np.zeros(1), np.ones(1), cut_off=10.0)
    state = pid.begin(np.zeros(1))
    interval, torque = 1e-4, np.zeros(1)
    for sample in range(round(1 / (2 * np.pi * 10.0) / interval) + 1):
        torque, state = pid.demand(state, sample * interval, np.array([-sample * interval]))
    np.testing.assert_allclose(torque, 1 - np.exp(-1), rtol=1e-2)


@pytest.mark.parametrize("make", [sim.training, sim.comparison, _swing])
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


@pytest.mark.parametrize("make", [sim.training, sim.comparison, _swing])
@pytest.mark.parametrize("batch", [(), (3,), (2, 1)])
def test_a_compiled_scan_gives_what_numpy_gives(
    make: Callable[[], sim.Trajectory], batch: tuple[int, ...], rng: np.random.Generator
):
    """A closed loop about unit masses, with rank promotion forbidden to JAX (tests/conftest.py)."""
    trajectory = make()
    controller, interval = trajectory.controller, trajectory.sample_interval
    start = trajectory.start + 0.1 * rng.normal(size=(*batch, 6))
    times = interval * np.arange(60)

    def go_on(carry: tuple[Any, Any, Any], time: Any) -> tuple[tuple[Any, Any, Any], Any]:
        position, velocity, state = carry
        torque, state = controller.demand(state, time, position)
        velocity = velocity + interval * torque
        return (position + interval * velocity, velocity, state), torque

    carry, expected = (start, np.zeros_like(start), controller.begin(start)), []
    for time in times:
        carry, torque = go_on(carry, float(time))
        expected.append(torque)

    @jax.jit
    def run(position: jax.Array, times: jax.Array) -> Any:
        state = controller.begin(position)
        return jax.lax.scan(go_on, (position, jnp.zeros_like(position), state), times)

    end, torques = run(start, times)
    scale = _ROUNDING * np.abs(expected).max()
    np.testing.assert_allclose(torques, expected, rtol=0, atol=scale)
    np.testing.assert_allclose(end[0], carry[0], rtol=0, atol=_ROUNDING)
    assert jax.tree.structure(end[2]) == jax.tree.structure(carry[2])


def test_rows_may_have_clocks_of_their_own(rng: np.random.Generator):
    controller = sim.training().controller
    position, times = rng.normal(size=(2, 6)), np.array([[0.3], [0.7]])
    together, _ = controller.demand((), times, position)
    apart = [controller.demand((), float(t[0]), q)[0] for t, q in zip(times, position, strict=True)]
    np.testing.assert_array_equal(together, apart)


def test_single_precision_stays_single():
    for trajectory in (sim.training(), sim.comparison(), _swing()):
        position = jnp.asarray(trajectory.start, dtype=jnp.float32)
        state = trajectory.controller.begin(position)
        torque, state = trajectory.controller.demand(state, 0.002, position)
        assert {leaf.dtype for leaf in [torque, *jax.tree.leaves(state)]} == {np.dtype("float32")}

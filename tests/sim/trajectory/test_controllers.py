"""Controllers: their formulas, their limits, and that batches are rows."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sim
from jaxcslc import RobotError
from jaxcslc.control import PID, Reference
from jaxcslc.manipulator import Manipulator, puma560


# Sines and exponentials of two libraries, added up over a loop that amplifies a little.
_ROUNDING = 1e-11


def _swing() -> sim.Trajectory:
    """The comparison trajectory's arm, made to oscillate."""
    trajectory = sim.comparison()
    path = sim.Oscillation(trajectory.start + 0.1, np.full(6, 0.1), 0.3)
    return dataclasses.replace(trajectory, path=path)


def _reference(trajectory: sim.Trajectory, time: Any, origin: Any) -> Reference:
    if trajectory.path is None:
        return Reference.at_rest(origin)
    xp = origin.__array_namespace__()
    now = xp.broadcast_to(xp.asarray(time, dtype=origin.dtype), (*origin.shape[:-1], 1))
    return trajectory.path.reference(now, origin)


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
    with pytest.raises(RobotError, match="robot 'stick': this gravity compensation is the P"):
        sim.AbbreviatedGravity.of(robot)
    with pytest.raises(RobotError, match="expected it along the z axis"):
        sim.AbbreviatedGravity.of(puma560().with_gravity((1.0, 0.0, -9.81)))


def test_sinusoids_have_their_amplitude_period_and_phase():
    controller = sim.SinusoidalTorque(np.array([2.0]), np.array([0.8]), np.array([1.5 * np.pi]))
    q, torque = np.zeros(1), []
    state = controller.begin(q)
    for _ in range(5):
        value, state = controller.step(state, Reference.at_rest(q), q, 0.2)
        torque.append(float(value[0]))
    np.testing.assert_allclose(torque, [-2.0, 0.0, 2.0, 0.0, -2.0], atol=1e-14)


def test_pid_is_its_formula_on_a_moving_arm():
    """On an arm that stands still while the path moves on; no filter, so rates are differences."""
    pid = PID(
        1,
        position_gain=100.0,
        integral_gain=7.0,
        velocity_gain=3.0,
        cutoff=1e9,
        integration="backward",
    )
    q, interval = np.zeros(1), 0.25
    state = pid.begin(q)
    errors, torques = np.asarray(sim.minimum_jerk(np.array([0.0, 0.25, 0.5]))), []
    for error in errors:
        torque, state = pid.step(state, Reference.at_rest(np.array([error])), q, interval)
        torques.append(float(torque[0]))
    expected = [
        0.0,
        100 * errors[1] + 7 * 0.25 * errors[1] + 3 * errors[1] / 0.25,
        100 * errors[2] + 7 * 0.25 * sum(errors) + 3 * (errors[2] - errors[1]) / 0.25,
    ]
    np.testing.assert_allclose(torques, expected, rtol=1e-12)


def test_pid_filter_has_its_cut_off():
    """A ramp of the error is followed with the low pass's time constant, 1 / (2π cut-off)."""
    pid = PID(1, position_gain=0.0, velocity_gain=1.0, cutoff=10.0)
    state = pid.begin(np.zeros(1))
    interval, torque = 1e-4, np.zeros(1)
    for sample in range(round(1 / (2 * np.pi * 10.0) / interval) + 1):
        q = np.array([-sample * interval])
        torque, state = pid.step(state, Reference.at_rest(np.zeros(1)), q, interval)
    np.testing.assert_allclose(torque, 1 - np.exp(-1), rtol=1e-2)


@pytest.mark.parametrize("make", [sim.training, sim.comparison, _swing])
def test_a_batch_is_its_rows(make: Callable[[], sim.Trajectory], rng: np.random.Generator):
    trajectory = make()
    controller = trajectory.controller
    positions = trajectory.start + 0.1 * rng.normal(size=(3, 4, 6))  # samples, batch, joints
    together = controller.begin(positions[0])
    apart = [controller.begin(position) for position in positions[0]]
    for sample, position in enumerate(positions):
        reference = _reference(trajectory, 0.002 * sample, positions[0])
        torque, together = controller.step(together, reference, position, 0.002)
        for i in range(4):
            reference = _reference(trajectory, 0.002 * sample, positions[0, i])
            row, apart[i] = controller.step(apart[i], reference, position[i], 0.002)
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
        origin = position.__array_namespace__().asarray(start)
        reference = _reference(trajectory, time, origin)
        torque, state = controller.step(state, reference, position, interval)
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
    q, samples = rng.normal(size=(2, 6)), np.array([[150], [350]])
    together, _ = controller.step(samples, Reference.at_rest(q), q, 0.002)
    apart = [
        controller.step(count, Reference.at_rest(row), row, 0.002)[0]
        for count, row in zip(samples, q, strict=True)
    ]
    np.testing.assert_array_equal(together, apart)


def test_single_precision_stays_single():
    for trajectory in (sim.training(), sim.comparison(), _swing()):
        position = jnp.asarray(trajectory.start, dtype=jnp.float32)
        state = trajectory.controller.begin(position)
        reference = _reference(trajectory, 0.002, position)
        torque, state = trajectory.controller.step(state, reference, position, 0.002)
        leaves = [torque, *jax.tree.leaves(state)]
        types = {leaf.dtype for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.inexact)}
        assert types == {np.dtype("float32")}


def test_bad_options_are_refused():
    with pytest.raises(ValueError, match=r"cutoff is 0\.0; expected more than 0 Hz"):
        PID(1, position_gain=1.0, velocity_gain=1.0, cutoff=0.0)
    with pytest.raises(ValueError, match="integration is 'trapezoidal'; expected 'forward' or"):
        PID(1, position_gain=1.0, velocity_gain=1.0, integration="trapezoidal")

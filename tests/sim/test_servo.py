"""Servos: a loop of jaxcslc.control does in the simulator what it does by itself."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sim
from jaxcslc.control import PID, Loop, LowPassChain, Reference


class Proportional(eqx.Module):
    """The least loop: a gain, and how often it was asked."""

    gain: jax.Array

    def begin(self, q: jax.Array) -> jax.Array:
        return jnp.zeros(q.shape[:-1], int)

    def step(
        self, state: jax.Array, reference: Reference, q: jax.Array, interval: float
    ) -> tuple[jax.Array, jax.Array]:
        return jnp.broadcast_to(self.gain, q.shape) * (reference.q - q), state + 1


PATH = sim.MinimumJerk(np.array([0.3, -0.2]), 0.5)


def _path(count: int) -> sim.MinimumJerk:
    return sim.MinimumJerk(np.full(count, 0.2), 0.5)


def _steps(servo: sim.Servo, q: Any, samples: int = 5) -> tuple[list[np.ndarray], Any]:
    state, torques = servo.begin(q), []
    for sample in range(samples):
        torque, state = servo.demand(state, sample * servo.interval, q + 0.01 * sample)
        torques.append(np.asarray(torque))
    return torques, state


def test_a_servo_is_its_loop(rng: np.random.Generator):
    """By hand, without anything compiled: reference, reading and interval."""
    loop = Loop(PID(2, position_gain=100.0, velocity_gain=5.0), LowPassChain(50.0, lags=2))
    servo, q = sim.Servo(loop, PATH), rng.normal(size=(3, 2))
    torques, state = _steps(servo, q)
    own = loop.begin(jnp.asarray(q))
    for sample, torque in enumerate(torques):
        wanted = PATH.reference(np.full((3, 1), 0.002 * sample), q)
        expected, own = loop.step(own, wanted, jnp.asarray(q + 0.01 * sample), 0.002)
        assert isinstance(torque, np.ndarray)
        np.testing.assert_allclose(torque, expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(state.origin, q)
    assert jax.tree_util.tree_structure(state.loop) == jax.tree_util.tree_structure(own)


def test_one_loop_a_machine_is_each_alone(rng: np.random.Generator):
    gains, q = rng.uniform(1, 2, size=(3, 2)), rng.normal(size=(3, 2))
    together, state = _steps(sim.Servo(Proportional(jnp.array(gains)), PATH, per_machine=True), q)
    assert state.loop.tolist() == [5, 5, 5]
    for i in range(3):
        alone, _ = _steps(sim.Servo(Proportional(jnp.array(gains[i])), PATH), q[i : i + 1])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[i], other[0], rtol=1e-14)


@pytest.mark.parametrize("per_machine", [False, True])
def test_servos_that_differ_in_numbers_share_a_program(per_machine: bool):
    traced: list[int] = []

    class Counting(Proportional):
        def step(self, state: Any, reference: Reference, q: jax.Array, interval: float) -> Any:
            traced.append(1)
            return super().step(state, reference, q, interval)

    shape = (2, 2) if per_machine else (2,)
    for gain in (1.0, 2.0, 3.0):
        loop = Counting(jnp.full(shape, gain))
        _steps(sim.Servo(loop, _path(2), per_machine=per_machine), np.zeros((2, 2)))
    assert len(traced) == 1


def test_transforms_go_through_a_servo():
    """A scan over JAX arrays does what the loop over NumPy's does; so does vmap's batch."""
    servo = sim.Servo(Proportional(jnp.array([2.0, 3.0])), PATH)

    @jax.jit
    def scanned(q: jax.Array) -> jax.Array:
        def step(state: Any, sample: jax.Array) -> tuple[Any, Any]:
            torque, state = servo.demand(state, sample * 0.002, q + 0.01 * sample)
            return state, torque

        return jax.lax.scan(step, servo.begin(q), jnp.arange(5))[1]

    q = np.array([[0.1, 0.2], [0.3, 0.4]])
    torques, _ = _steps(servo, q)
    np.testing.assert_allclose(scanned(jnp.asarray(q)), np.stack(torques), rtol=1e-13)


def test_an_arm_follows_a_path_under_a_servo():
    """The comparison's PID from jaxcslc.control ends where the simulator's own does."""
    trajectory = sim.comparison()
    own = trajectory.controller
    assert isinstance(own, sim.PID) and isinstance(own.path, sim.MinimumJerk)
    pid = PID(6, position_gain=own.position_gain, velocity_gain=own.velocity_gain)
    servo = sim.Servo(Loop(pid, LowPassChain(50.0, lags=2)), own.path)
    _, truth = sim.simulate(
        sim.puma560(), dataclasses.replace(trajectory, controller=servo), seed=1
    )
    np.testing.assert_allclose(truth.position[-1], own.path.end, atol=0.01)


def test_what_a_controller_remembers_can_be_seen():
    servo = sim.Servo(Proportional(jnp.full((2, 6), 100.0)), _path(6), per_machine=True)
    trajectory = sim.Trajectory("seen", np.zeros(6), servo, samples=8)
    machines = [sim.puma560(), sim.specimen(sim.puma560(), 1)]
    results = sim.close_loop(
        machines, trajectory, [1, 2], observe=lambda state: {"asked": state.loop}
    )
    for machine, seed, result in zip(machines, [1, 2], results, strict=True):
        assert not isinstance(result, sim.SimulationError)
        assert result.observed["asked"].tolist() == list(range(1, 9))
        alone = sim.Servo(Proportional(jnp.full(6, 100.0)), _path(6))
        recording, _ = sim.simulate(
            machine, dataclasses.replace(trajectory, controller=alone), seed=seed
        )
        np.testing.assert_array_equal(recording.position, result.recording.position)


def test_one_machine_that_leaves_its_range_is_told_among_the_others():
    narrow = dataclasses.replace(sim.puma560(), position_range=((-0.01, 0.01),) * 6)
    trajectory = dataclasses.replace(sim.comparison(), samples=5)
    one, other = sim.close_loop([sim.puma560(), narrow], trajectory, [1, 1])
    assert isinstance(one, sim.ClosedLoop) and one.observed == {}
    assert isinstance(other, sim.SimulationError)


def test_what_does_not_fit_is_refused():
    servo = sim.Servo(Proportional(jnp.ones(2)), PATH, per_machine=True)
    with pytest.raises(sim.MachineError, match="expected a first axis of machines in both"):
        servo.begin(np.zeros((3, 2)))
    with pytest.raises(
        sim.MachineError, match=r"interval of 0\.002 s, and its servo one of 0\.001"
    ):
        sim.Trajectory("wrong", np.zeros(2), sim.Servo(servo.loop, PATH, interval=0.001), 5)
    with pytest.raises(sim.MachineError, match=r"interval of 0\.0 s; expected above zero"):
        sim.Servo(servo.loop, PATH, interval=0.0)
    trajectory = dataclasses.replace(sim.comparison(), samples=2)
    with pytest.raises(ValueError, match=r"observe: 'x' has shape \(3,\); expected a first axis"):
        sim.close_loop([sim.puma560()], trajectory, [0], observe=lambda _: {"x": np.zeros(3)})

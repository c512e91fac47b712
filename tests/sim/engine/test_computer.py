"""The control computer: a controller does in the simulator what it does by itself."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.control import (
    PID,
    AbstractController,
    ComputedTorque,
    LowPassChain,
    OutputFeedback,
    Reference,
)
from sim.engine._computer import Computer
from sim.machine._events import Faults


class Proportional(AbstractController):
    """The simplest controller: a gain, and how many samples there were."""

    gain: jax.Array

    def begin(self, q: Any) -> jax.Array:
        return jnp.zeros(q.shape[:-1], int)

    def step(
        self,
        state: jax.Array,
        reference: Reference,
        q: Any,
        interval: float | jax.Array,
        qd: Any = None,
    ) -> tuple[jax.Array, jax.Array]:
        return jnp.broadcast_to(self.gain, q.shape) * (reference.q - q), state + 1


PATH = sim.MinimumJerk(np.array([0.3, -0.2]), 0.5)


def _path(count: int) -> sim.MinimumJerk:
    return sim.MinimumJerk(np.full(count, 0.2), 0.5)


def _computer(
    controller: AbstractController, path: sim.MinimumJerk, per_machine: bool = False
) -> Computer:
    return Computer(controller, path, 0.002, per_machine)


def _healthy(joints: int) -> Faults:
    return Faults.of((), joints, np.zeros(1)).at(0)


def _steps(computer: Computer, q: Any, samples: int = 5) -> tuple[list[np.ndarray], Any]:
    state, torques = computer.begin(q), []
    healthy = _healthy(q.shape[-1])
    for sample in range(samples):
        time = sample * computer.interval
        torque, state = computer.command(state, time, q + 0.01 * sample, healthy)
        torques.append(np.asarray(torque))
    return torques, state


def test_the_computer_does_what_the_controller_does(rng: np.random.Generator):
    """By hand, without anything compiled: reference, reading and interval."""
    loop = OutputFeedback(
        PID(2, position_gain=100.0, velocity_gain=5.0), LowPassChain(50.0, lags=2)
    )
    q = rng.normal(size=(3, 2))
    torques, state = _steps(_computer(loop, PATH), q)
    alone = loop.begin(jnp.asarray(q))
    for sample, torque in enumerate(torques):
        wanted = PATH.reference(np.full((3, 1), 0.002 * sample), q)
        expected, alone = loop.step(alone, wanted, jnp.asarray(q + 0.01 * sample), 0.002)
        assert isinstance(torque, np.ndarray)
        np.testing.assert_allclose(torque, expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(state.origin, q)
    assert jax.tree_util.tree_structure(state.controller) == jax.tree_util.tree_structure(alone)


def test_one_controller_for_each_machine_is_each_alone(rng: np.random.Generator):
    gains, q = rng.uniform(1, 2, size=(3, 2)), rng.normal(size=(3, 2))
    together, state = _steps(_computer(Proportional(jnp.array(gains)), PATH, True), q)
    assert state.controller.tolist() == [5, 5, 5]
    for i in range(3):
        alone, _ = _steps(_computer(Proportional(jnp.array(gains[i])), PATH), q[i : i + 1])
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[i], other[0], rtol=1e-14)


@pytest.mark.parametrize("per_machine", [False, True])
def test_controllers_that_differ_in_numbers_share_a_program(per_machine: bool):
    traced: list[int] = []

    class Counting(Proportional):
        def step(
            self, state: Any, reference: Any, q: Any, interval: Any, qd: Any = None
        ) -> tuple[Any, Any]:
            traced.append(1)
            return super().step(state, reference, q, interval, qd)

    shape = (2, 2) if per_machine else (2,)
    for gain in (1.0, 2.0, 3.0):
        loop = Counting(jnp.full(shape, gain))
        _steps(_computer(loop, _path(2), per_machine), np.zeros((2, 2)))
    assert len(traced) == 1


def test_transforms_go_through_the_computer():
    """A scan over JAX arrays does what the loop over NumPy's does; so does vmap's batch."""
    computer = _computer(Proportional(jnp.array([2.0, 3.0])), PATH)
    healthy = _healthy(2)

    @jax.jit
    def scanned(q: jax.Array) -> jax.Array:
        def step(state: Any, sample: jax.Array) -> tuple[Any, Any]:
            torque, state = computer.command(state, sample * 0.002, q + 0.01 * sample, healthy)
            return state, torque

        return jax.lax.scan(step, computer.begin(q), jnp.arange(5))[1]

    q = np.array([[0.1, 0.2], [0.3, 0.4]])
    torques, _ = _steps(computer, q)
    np.testing.assert_allclose(scanned(jnp.asarray(q)), np.stack(torques), rtol=1e-13)


def test_an_arm_follows_a_path_with_estimated_velocities():
    """The comparison's gains behind a velocity estimate end where they do without one."""
    trajectory = sim.comparison()
    original = trajectory.controller
    assert isinstance(original, PID) and isinstance(trajectory.path, sim.MinimumJerk)
    pid = PID(6, position_gain=original.position_gain, velocity_gain=original.velocity_gain)
    feedback = OutputFeedback(pid, LowPassChain(50.0, lags=2))
    _, truth = sim.simulate(
        sim.puma560(), dataclasses.replace(trajectory, controller=feedback), seed=1
    )
    np.testing.assert_allclose(truth.position[-1], trajectory.path.end, atol=0.01)


def test_what_a_controller_remembers_can_be_seen():
    controllers = Proportional(jnp.full((2, 6), 100.0))
    trajectory = sim.Trajectory(
        "seen", np.zeros(6), controllers, samples=8, path=_path(6), per_machine=True
    )
    machines = [sim.puma560(), sim.specimen(sim.puma560(), 1)]
    results = sim.close_loop(machines, trajectory, [1, 2], observe=lambda state: {"asked": state})
    for machine, seed, result in zip(machines, [1, 2], results, strict=True):
        assert not isinstance(result, sim.SimulationError)
        assert result.observed["asked"].tolist() == list(range(1, 9))
        alone = Proportional(jnp.full(6, 100.0))
        recording, _ = sim.simulate(
            machine, dataclasses.replace(trajectory, controller=alone, per_machine=False), seed=seed
        )
        np.testing.assert_array_equal(recording.position, result.recording.position)


def test_one_machine_that_leaves_its_range_is_named_among_the_others():
    narrow = dataclasses.replace(sim.puma560(), position_range=((-0.01, 0.01),) * 6)
    trajectory = dataclasses.replace(sim.comparison(), samples=5)
    one, other = sim.close_loop([sim.puma560(), narrow], trajectory, [1, 1])
    assert isinstance(one, sim.ClosedLoop) and one.observed == {}
    assert isinstance(other, sim.SimulationError)


def test_what_does_not_fit_is_refused():
    computer = _computer(Proportional(jnp.ones(2)), PATH, True)
    with pytest.raises(sim.MachineError, match="expected a first axis of machines in both"):
        computer.begin(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="ComputedTorque: no velocities; pass qd, or wrap"):
        network = jc.derive(sim.puma560().robot)
        law = ComputedTorque(network, np.ones(network.size), 20.0)
        law.step(law.begin(np.zeros(6)), Reference.at_rest(np.zeros(6)), np.zeros(6), 0.002)
    trajectory = dataclasses.replace(sim.comparison(), samples=2)
    with pytest.raises(ValueError, match=r"observe: 'x' has shape \(3,\); expected a first axis"):
        sim.close_loop([sim.puma560()], trajectory, [0], observe=lambda _: {"x": np.zeros(3)})

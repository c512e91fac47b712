"""Faults are detected, named, and the arm is brought to rest; a healthy arm is left alone."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
import sim
from jaxcslc.control import (
    FAULTS,
    ComputedTorque,
    FaultMonitor,
    OutputFeedback,
    Reference,
)
from tests import arms
from tests.control.conftest import SmallArm


MACHINE = sim.disturbed(sim.puma560(), "quantisation", "static friction")
LIMIT = np.array(MACHINE.maximum_torque)
START = np.array([0.0, -1.2, 0.6, 0.3, 0.5, 0.2])
PATH = sim.MinimumJerk(START + np.array([0.8, 0.5, -0.5, 0.9, -0.8, 1.0]), 1.0)
BEGINS = 0.3  # of each fault [s]


@pytest.fixture(scope="module")
def guard(puma: jc.CSLC) -> FaultMonitor:
    assert puma.robot.links is not None
    k = puma.coefficients_from(puma.robot.links, viscous=MACHINE.viscous, dry=MACHINE.dry)
    # A model that is some percent off, as identified ones are.
    k = k * jnp.asarray(1 + 0.05 * np.random.default_rng(0).uniform(-1, 1, k.shape))
    controller = ComputedTorque(
        puma, k, 20.0, friction_at="reference", friction_width=0.02, torque_limit=LIMIT
    )
    return FaultMonitor(OutputFeedback(controller), puma, k, torque_limit=LIMIT)


@pytest.fixture(scope="module")
def small_guard(small_arm: SmallArm) -> FaultMonitor:
    controller = ComputedTorque(*small_arm, 20.0, torque_limit=LIMIT[:2])
    return FaultMonitor(OutputFeedback(controller), *small_arm, torque_limit=LIMIT[:2])


@pytest.fixture(scope="module")
def step(small_guard: FaultMonitor) -> Any:
    """`small_guard.step`, compiled."""
    return eqx.filter_jit(small_guard.step)


def _performed(guard: FaultMonitor, *faults: sim.Fault) -> tuple[sim.ClosedLoop, tuple[str, ...]]:
    def seen(state: Any) -> dict[str, Array]:
        return {"fault": state.fault, "detected": state.detected, "torque": state.torque}

    # One monitor for one machine.
    loops = jax.tree_util.tree_map(lambda x: x[None] if eqx.is_array(x) else x, guard)
    trajectory = sim.Trajectory(
        "guarded", START, loops, 600, faults=faults, path=PATH, per_machine=True
    )
    (result,) = sim.close_loop([MACHINE], trajectory, [1], observe=seen)
    assert isinstance(result, sim.ClosedLoop)
    detected = [
        f"joint {j + 1}: {FAULTS[code]}"
        for j, code in enumerate(result.observed["fault"][-1])
        if code
    ]
    return result, tuple(detected)


def test_a_healthy_arm_is_left_alone(guard: FaultMonitor) -> None:
    result, detected = _performed(guard)
    assert detected == ()
    end = np.asarray(PATH.reference(np.array([1.0]), START).q)
    assert np.max(np.abs(result.truth.position[-1] - end)) < 0.02


@pytest.mark.parametrize("kind", FAULTS[1:])
@pytest.mark.parametrize("joint", [1, 2, 5])
def test_faults_are_named_and_the_arm_comes_to_rest(
    guard: FaultMonitor, kind: str, joint: int
) -> None:
    result, detected = _performed(guard, sim.Fault(kind, joint, start=BEGINS))
    assert detected == (f"joint {joint}: {kind}",)
    when = result.observed["detected"][-1][joint - 1]
    assert 0 < when - BEGINS < 0.06
    assert np.all(np.abs(result.observed["torque"]) <= LIMIT)
    late = (
        result.truth.time > when + guard.stop_time + 0.5
    )  # friction stops what model error leaves
    assert np.max(np.abs(result.truth.velocity[late])) < 0.02
    assert np.max(np.abs(result.truth.position - START)) < 1.2


def test_a_few_lost_samples_are_bridged(guard: FaultMonitor) -> None:
    result, detected = _performed(
        guard, sim.Fault("lost samples", None, start=BEGINS, stop=BEGINS + 0.01)
    )
    assert detected == ()
    assert np.count_nonzero(result.truth.lost[:, 0]) == guard.allowed


def test_all_samples_lost(guard: FaultMonitor) -> None:
    """Without any reading the arm follows its model to rest."""
    result, detected = _performed(guard, sim.Fault("lost samples", None, start=BEGINS))
    assert detected == tuple(f"joint {j}: lost samples" for j in range(1, 7))
    late = result.truth.time > BEGINS + guard.stop_time + 0.2
    assert np.max(np.abs(result.truth.velocity[late])) < 0.02


def test_a_cable_that_tears_slowly(guard: FaultMonitor) -> None:
    """One joint's samples are lost, then another's, then all."""
    result, detected = _performed(
        guard,
        sim.Fault("lost samples", 2, start=BEGINS),
        sim.Fault("lost samples", 3, start=BEGINS + 0.03),
        sim.Fault("lost samples", None, start=BEGINS + 0.1),
    )
    assert detected == tuple(f"joint {j}: lost samples" for j in range(1, 7))
    late = result.truth.time > BEGINS + guard.stop_time + 0.5
    assert np.max(np.abs(result.truth.velocity[late])) < 0.02


def test_an_arm_with_a_spring_at_rest() -> None:
    """What holds it still is gravity's torque and the spring's."""
    network = arms.pendulum("dry", "spring")
    rod = jc.LinkParameters(1.0, np.array([0.3, 0.0, 0.0]), 0.01 * np.eye(3), 0.1)
    k = network.coefficients_from([rod], dry=[0.5], spring=[60.0])
    guard = FaultMonitor(
        OutputFeedback(ComputedTorque(network, k, 10.0)), network, k, torque_limit=50.0
    )
    q = jnp.array([0.5])
    state, step = guard.begin(q), eqx.filter_jit(guard.step)
    for _ in range(40):
        torque, state = step(state, Reference.at_rest(q), q, 0.002)
        np.testing.assert_allclose(torque, network.torque(k, q, 0 * q, 0 * q), atol=1e-9)
    assert guard.report(state) == ()


def test_the_report_names_joint_fault_and_time(small_guard: FaultMonitor, step: Any) -> None:
    q = jnp.asarray(START[:2])
    state = small_guard.begin(q)
    gone = q.at[1].set(jnp.nan)
    for n in range(20):
        torque, state = step(state, Reference.at_rest(q), gone if n >= 5 else q, 0.002)
        assert np.all(np.isfinite(torque))
    assert small_guard.report(state) == ("joint 2: lost samples, detected at 0.020 s",)
    assert small_guard.report(small_guard.begin(q)) == ()


def test_side_by_side_as_alone(
    small_guard: FaultMonitor, step: Any, rng: np.random.Generator
) -> None:
    q = START[:2] + 0.01 * rng.normal(size=(3, 2))
    reference = Reference(q, 0 * q, 0 * q)
    states = jax.jit(jax.vmap(small_guard.begin))(q)
    together = eqx.filter_jit(eqx.filter_vmap(small_guard.step, in_axes=(0, 0, 0, None)))
    torque, states = together(states, reference, q, 0.002)
    one = jnp.asarray(q[1])
    alone, _ = step(small_guard.begin(one), Reference.at_rest(one), one, 0.002)
    np.testing.assert_allclose(torque[1], alone, atol=1e-9)
    assert states.fault.shape == (3, 2)


def test_refusals(puma: jc.CSLC, puma_k: Array, guard: FaultMonitor) -> None:
    with pytest.raises(ValueError, match="k: expected shape"):
        FaultMonitor(guard.controller, puma, puma_k[:3], torque_limit=1.0)
    with pytest.raises(ValueError, match="torque_limit: expected one number or 6"):
        FaultMonitor(guard.controller, puma, puma_k, torque_limit=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"breakaway of joint 1 is -1\.0"):
        FaultMonitor(guard.controller, puma, puma_k, torque_limit=1.0, breakaway=-1.0)
    with pytest.raises(ValueError, match="breakaway of joint 1 is inf; expected a finite torque"):
        FaultMonitor(guard.controller, puma, puma_k, torque_limit=np.inf)
    with pytest.raises(ValueError, match=r"stop_time is 0\.0 s; expected more than 0"):
        FaultMonitor(guard.controller, puma, puma_k, torque_limit=1.0, stop_time=0.0)

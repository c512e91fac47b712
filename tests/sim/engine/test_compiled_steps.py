"""Steps compiled from C are those of MuJoCo's mj_step: states at random, and whole recordings."""

import dataclasses
import shutil
from typing import Any

import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator
from sim.engine import _plant


pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler (cc)")

# Velocities of some 20 rad/s in float64, and what MuJoCo's solver leaves of 1e-14.
ROUNDING = 1e-12
MACHINES = 300


def moved(machine: sim.Machine, rng: np.random.Generator, monkeypatch: Any, compiled: bool) -> Any:
    """Positions and velocities after one interval from states and with demands at random, many of
    them at rest, in reverse or in backlash."""
    n = machine.joint_count
    position = rng.uniform(-2.0, 2.0, (MACHINES, n))
    with monkeypatch.context() as patch:
        if not compiled:
            patch.setattr(_plant, "compiled_steps", lambda *_: None)
        plant = sim.Plant([machine] * MACHINES, position, interval=machine.time_step, threads=2)
    assert (plant._steps is not None) == compiled
    dofs = plant._qd.shape[1]
    plant._q[:, n:] += 1e-3 * rng.normal(size=(MACHINES, dofs - n))
    size = 10.0 ** rng.uniform(-6.0, 1.0, (MACHINES, dofs)) * (rng.random((MACHINES, dofs)) > 0.2)
    plant._qd[:] = size * rng.normal(size=(MACHINES, dofs))
    for _ in range(2):  # the first remains in force during `torque_delay`
        plant.drive(rng.normal(size=(MACHINES, n)) * 10.0 ** rng.uniform(-2.0, 1.5, (MACHINES, n)))
    plant.advance()
    return plant._q.copy(), plant._qd.copy()


def sliding_and_turning() -> sim.Machine:
    """A prismatic and two revolute joints, one of them flexible, one without friction."""
    link = LinkParameters(2.0, np.array([0.1, 0.2, 0.3]), np.diag([0.1, 0.2, 0.25]), 0.5)
    rows = [(0.0, 0.0, 0.0, 0.0), (0.3, 0.5, 0.0, 0.1), (-1.2, 0.2, 0.3, 0.0)]
    robot = Manipulator.from_modified_dh(rows, kinds="PRR", gravity=(1.0, -3.0, -9.0))
    return sim.Machine(
        robot=dataclasses.replace(robot, links=(link,) * 3),
        viscous=(1.0, 0.0, 0.5),
        dry=(2.0, 0.0, 1.0),
        static=(3.0, 0.0, 1.0),
        static_velocity=(0.1,) * 3,
        encoder_resolution=(0.0,) * 3,
        maximum_torque=(np.inf,) * 3,
        position_range=((-np.inf, np.inf),) * 3,
        stiffness=(np.inf, np.inf, 300.0),
        backlash=(0.0, 0.0, 1e-3),
        transmission_damping=(0.0, 0.0, 0.1),
        link_share=(0.0, 0.0, 0.4),
        asymmetry=(0.1, 0.0, -0.1),
    )


CASES = {
    "usual": sim.puma560(),
    "undisturbed": sim.undisturbed(sim.puma560()),
    "every disturbance": sim.disturbed(sim.puma560()),
    "sliding and turning": sliding_and_turning(),
}


@pytest.mark.parametrize("name", CASES)
def test_a_step_is_mujocos(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, expected = (
        moved(CASES[name], np.random.default_rng(1), monkeypatch, use) for use in (True, False)
    )
    np.testing.assert_allclose(compiled[0], expected[0], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(compiled[1], expected[1], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("name", ["usual", "every disturbance"])
def test_a_recording_is_the_same_without_a_compiler(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In open loop, with a load and a reversed drive on the way."""
    ball = LinkParameters(1.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    trajectory = dataclasses.replace(
        sim.training(samples=150),
        loads=(sim.Load(0.1, ball, 0.2),),
        faults=(sim.Fault("reversed torque", 6, 0.15, 0.2),),
    )
    compiled = sim.simulate(CASES[name], trajectory, seed=3)
    monkeypatch.setattr(_plant, "compiled_steps", lambda *_: None)
    expected = sim.simulate(CASES[name], trajectory, seed=3)
    for field in dataclasses.fields(expected.truth):
        values, reference = (
            np.asarray(getattr(result.truth, field.name), float) for result in (compiled, expected)
        )
        scale = max(1.0, float(np.abs(reference).max()))
        # Stiff gears and friction turn a position's rounding into torque.
        np.testing.assert_allclose(values, reference, rtol=0, atol=1e-8 * scale, err_msg=field.name)
    np.testing.assert_array_equal(compiled.recording.position, expected.recording.position)


def test_a_state_that_is_not_finite_stays_visible() -> None:
    plant = sim.Plant(sim.puma560(), np.zeros(6), interval=0.002)
    plant._q[:] = np.nan
    plant.advance()
    assert np.isnan(plant.velocity).all()

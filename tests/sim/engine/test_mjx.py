"""The plant under MJX does what C MuJoCo's does; short, since compiling for a CPU takes long."""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.control import (
    PID,
    AbstractPositionTorque,
    ComputedTorque,
    FaultMonitor,
    OutputFeedback,
)
from jaxcslc.manipulator import LinkParameters


def test_mjx_records_what_mujoco_records():
    """Machines that differ, gears and every disturbance, quantised feedback included; the PUMA
    560's arm without its wrist, whose twelve degrees of freedom take a minute to compile."""
    whole = (sim.puma560(), sim.specimen(sim.puma560(), 1))
    machines = [first_joints(sim.disturbed(machine), 3) for machine in whole]
    comparison = sim.comparison()
    controller, path = comparison.controller, comparison.path
    assert isinstance(controller, PID) and isinstance(path, sim.MinimumJerk)
    assert controller.gravity is not None
    gains = controller.position_gain, controller.integral_gain, controller.velocity_gain
    trajectory = dataclasses.replace(
        comparison,
        start=comparison.start[:3],
        controller=eqx.tree_at(
            lambda c: (c.position_gain, c.integral_gain, c.velocity_gain, c.gravity),
            controller,
            (*(gain[:3] for gain in gains), FirstJoints(controller.gravity, 3)),
        ),
        path=dataclasses.replace(path, end=path.end[:3]),
        samples=100,  # by then, the gears of every joint have met
    )
    jobs = [sim.Job(machine, trajectory, seed) for seed, machine in enumerate(machines)]
    _agree(jobs)


@dataclasses.dataclass(frozen=True)
class FirstJoints(AbstractPositionTorque):
    """The torque of an arm on its first joints, with the others at zero."""

    whole: AbstractPositionTorque
    count: int
    array_generic: ClassVar[bool] = True

    def torque(self, q: Any) -> Any:
        xp = q.__array_namespace__()
        others = xp.zeros((*q.shape[:-1], 6 - self.count), q.dtype)
        return self.whole.torque(xp.concatenate([q, others], axis=-1))[..., : self.count]


def first_joints(machine: sim.Machine, count: int) -> sim.Machine:
    """The machine of a robot's first links alone, with their disturbances."""
    of_robot = ("joints", "inertia", "links", "viscous", "dry")
    robot = dataclasses.replace(
        machine.robot,
        numbering=None,
        **{name: getattr(machine.robot, name)[:count] for name in of_robot},
    )
    fields = {field.name: getattr(machine, field.name) for field in dataclasses.fields(machine)}
    by_joint = {name: x[:count] for name, x in fields.items() if isinstance(x, tuple)}
    return dataclasses.replace(machine, robot=robot, **by_joint)


PATH = sim.MinimumJerk(np.array([0.3]), 0.1)


def guarded(machines: list[sim.Machine]) -> FaultMonitor:
    """Computed torque behind encoders and a guard, with each machine's coefficients."""
    network = jc.derive(machines[0].robot, lengths="numeric")
    k = jnp.stack([network.coefficients_from(machine.links) for machine in machines])

    def one(k: jax.Array) -> FaultMonitor:
        controller = ComputedTorque(network, k, 20.0, torque_limit=50.0)
        return FaultMonitor(OutputFeedback(controller), network, k, torque_limit=50.0)

    return eqx.filter_vmap(one)(k)


def test_mjx_does_with_servos_loads_and_faults_what_mujoco_does(
    one_joint: Callable[..., sim.Machine],
):
    """One loop a machine; a body that comes and goes; every kind of fault."""
    machines = [
        one_joint(mass=mass, length=0.3, inertia=0.1, gravity=(0.0, -9.81, 0.0))
        for mass in (1.0, 1.2)
    ]
    ball = LinkParameters(2.0, np.array([0.1, 0.4, 0.0]), 0.001 * np.eye(3))
    trajectory = sim.Trajectory(
        "servo",
        np.array([0.2]),
        guarded(machines),
        samples=40,
        path=PATH,
        per_machine=True,
        loads=(sim.Load(0.01, ball, 0.05),),
        faults=(
            sim.Fault("lost samples", 1, 0.02, 0.03),
            sim.Fault("stuck encoder", None, 0.04, 0.05),
            sim.Fault("reversed torque", 1, 0.07),
        ),
    )
    jobs = [sim.Job(machine, trajectory, seed) for seed, machine in enumerate(machines)]
    _agree(jobs)
    without = dataclasses.replace(trajectory, loads=(), faults=())
    (one, _), (other, _) = (
        sim.record([job._replace(trajectory=item) for job in jobs])
        for item in (trajectory, without)
    )
    assert np.abs(one.truth.position - other.truth.position).max() > 1e-3


def _agree(jobs: list[sim.Job]) -> None:
    for one, other in zip(sim.record(jobs, backend="mjx"), sim.record(jobs), strict=True):
        np.testing.assert_allclose(one.recording.position, other.recording.position, atol=1e-12)
        np.testing.assert_allclose(one.recording.torque, other.recording.torque, atol=1e-9)
        for field in dataclasses.fields(one.truth):
            values, expected = (
                np.asarray(getattr(truth, field.name), float) for truth in (one.truth, other.truth)
            )
            scale = max(float(np.abs(expected).max()), 1.0)
            np.testing.assert_allclose(values, expected, atol=1e-7 * scale, err_msg=field.name)


def test_mjx_needs_64_bits():
    with jax.enable_x64(False), pytest.raises(sim.MachineError, match="64-bit mode is off"):
        sim.record([sim.Job(sim.puma560(), sim.training(samples=2))], backend="mjx")

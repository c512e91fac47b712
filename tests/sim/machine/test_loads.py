"""Loads: as if part of the last link, from one sample to another."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters


BOX = LinkParameters(
    3.0, np.array([0.02, -0.03, 0.12]), np.diag([0.02, 0.03, 0.015]) + 0.002 * (np.ones((3, 3)))
)
BALL = LinkParameters(1.5, np.array([0.0, 0.05, 0.1]), 0.001 * np.eye(3))


def _pick_and_place(*loads: sim.Load, samples: int = 120) -> sim.Trajectory:
    return dataclasses.replace(sim.comparison(), samples=samples, loads=loads)


def test_a_load_from_the_start_is_part_of_the_link():
    machine = sim.puma560()
    loaded = sim.carrying(machine, BOX)
    _, truth = sim.simulate(machine, _pick_and_place(sim.Load(0.0, BOX)), seed=2)
    _, expected = sim.simulate(loaded, _pick_and_place(), seed=2)
    for field in dataclasses.fields(truth):
        if field.name != "carried":
            assert eqx.tree_equal(getattr(truth, field.name), getattr(expected, field.name))
    np.testing.assert_array_equal(truth.carried, 3.0)
    np.testing.assert_array_equal(expected.carried, 0.0)


def test_the_truth_obeys_the_equation_of_what_is_carried(
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]],
):
    """Two loads that overlap; the torque is that of Pinocchio's arm with the carried bodies."""
    machine = sim.puma560()
    loads = (sim.Load(0.06, BOX, 0.16), sim.Load(0.1, BALL, 0.2))
    _, truth = sim.simulate(machine, _pick_and_place(*loads))
    for first, last, bodies in (
        (0, 30, []),
        (30, 50, [BOX]),
        (50, 80, [BOX, BALL]),
        (80, 100, [BALL]),
        (100, 120, []),
    ):
        loaded = machine
        for body in bodies:
            loaded = sim.carrying(loaded, body)
        rows = slice(first, last)
        rigid = inverse_dynamics(loaded.robot)(
            truth.position[rows], truth.velocity[rows], truth.acceleration[rows]
        )
        np.testing.assert_allclose(rigid + truth.friction[rows], truth.torque[rows], atol=1e-10)
        mass = sum(float(body.mass) for body in bodies)
        np.testing.assert_array_equal(truth.carried[rows], mass)


def test_nothing_but_acceleration_jumps_when_a_load_comes(pinocchio_model: Callable[..., Any]):
    """And that by M⁻¹: of the same torque at the same state, without friction."""
    import pinocchio as pin

    machine = dataclasses.replace(sim.undisturbed(sim.puma560()), viscous=(0.0,) * 6)
    machine = dataclasses.replace(machine, dry=(0.0,) * 6, static=(0.0,) * 6)
    plant = sim.Plant(machine, np.array([0.1, -1.4, 1.3, 0.2, 0.3, 0.4]), interval=0.002)
    torque = np.array([10.0, 60.0, 20.0, 2.0, 1.0, 1.0])
    for _ in range(50):
        plant.drive(torque)
        plant.advance()
    plant.drive(torque)
    q, qd, before = plant.position, plant.velocity, plant.acceleration
    plant.carry(BOX)
    np.testing.assert_array_equal(plant.position, q)
    np.testing.assert_array_equal(plant.velocity, qd)
    plant.drive(torque)
    np.testing.assert_array_equal(plant.position, q)
    np.testing.assert_array_equal(plant.velocity, qd)
    for body, acceleration in ((None, before), (BOX, plant.acceleration)):
        model = pinocchio_model(sim.carrying(machine, body).robot)
        expected = pin.aba(model, model.createData(), q, qd, torque)
        np.testing.assert_allclose(acceleration, expected, rtol=1e-9, atol=1e-9)
    assert np.abs(before - plant.acceleration).max() > 1.0
    plant.advance()
    step = plant.velocity - qd
    np.testing.assert_allclose(step, 0.002 * acceleration, atol=5e-3 * np.abs(step).max())


def test_energy_is_conserved_while_a_load_is_carried(pinocchio_model: Callable[..., Any]):
    import pinocchio as pin

    none = (0.0,) * 6
    machine = dataclasses.replace(sim.puma560(), viscous=none, dry=none, static=none)
    plant = sim.Plant(machine, np.array([0.1, -2.0, 0.3, 0.4, 0.5, 0.6]), interval=0.002)
    still = np.zeros(6)
    for body in (None, BOX, None):
        plant.carry(body)
        plant.drive(still)
        model = pinocchio_model(sim.carrying(machine, body).robot)
        data = model.createData()
        energies: list[float] = []
        for _ in range(60):
            kinetic = pin.computeKineticEnergy(model, data, plant.position, plant.velocity)
            potential = pin.computePotentialEnergy(model, data, plant.position)
            energies.append(kinetic + potential)
            plant.advance()
        np.testing.assert_allclose(energies, energies[0], atol=1e-8)


def test_a_load_with_gears_and_tilted_axes():
    machine = sim.disturbed(sim.puma560())
    trajectory = _pick_and_place(sim.Load(0.04, BOX), samples=40)
    _, truth = sim.simulate(machine, trajectory)
    _, without = sim.simulate(machine, dataclasses.replace(trajectory, loads=()))
    np.testing.assert_array_equal(truth.position[:21], without.position[:21])
    assert np.abs(truth.position[21:] - without.position[21:]).max() > 1e-6
    assert sim.carrying(machine, BOX).tilt == (0.0,) * 6
    np.testing.assert_array_equal(
        sim.carrying(machine, BOX).links[1].inertia, machine.links[1].inertia
    )


def test_machines_side_by_side_carry_alike():
    machines = [sim.puma560(), sim.specimen(sim.puma560(), 1)]
    trajectory = _pick_and_place(sim.Load(0.02, BOX, 0.06), samples=50)
    jobs = [sim.Job(machine, trajectory, 5) for machine in machines]
    for job, result in zip(jobs, sim.record(jobs), strict=True):
        assert eqx.tree_equal(sim.simulate(job.machine, trajectory, seed=5), result)


@pytest.mark.parametrize(
    ("body", "times", "message"),
    [
        (dataclasses.replace(BALL, mass=-1.0), (0.0, None), "mass of -1.0 kg; expected zero"),
        (
            dataclasses.replace(BALL, inertia=np.diag([1.0, 1.0, 3.0])),
            (0.0, None),
            "load cannot be a rigid body: one of its principal moments is more than the sum",
        ),
        (dataclasses.replace(BALL, motor_inertia=1.0), (0.0, None), "motor inertia of 1.0"),
        (BALL, (-1.0, None), "load starts at -1.0 s; expected zero or more"),
        (BALL, (1.0, 1.0), "load stops at 1.0 s; expected later than its start, 1.0 s"),
    ],
)
def test_what_cannot_be_carried_is_refused(
    body: LinkParameters, times: tuple[float, float | None], message: str
):
    with pytest.raises(sim.MachineError, match=message):
        sim.Load(times[0], body, times[1])


def test_a_load_too_heavy_for_the_drives_is_refused_before_anything_moves():
    heavy = dataclasses.replace(BALL, mass=500.0)
    seen: list[int] = []
    trajectory = _pick_and_place(sim.Load(0.1, heavy))
    with pytest.raises(sim.MachineError, match=r"maximum_torque of joint .*gravity"):
        sim.close_loop([sim.puma560()], trajectory, [0], observe=lambda _: seen.append(1) or {})
    assert not seen

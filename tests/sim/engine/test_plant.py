"""Motion against closed forms: the pendulum's period, energy, a joint that falls freely."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import ellipk

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator


def without_friction(machine: sim.Machine) -> sim.Machine:
    none = (0.0,) * machine.joint_count
    return dataclasses.replace(machine, viscous=none, dry=none, static=none)


def test_pendulum_has_its_period(one_joint: Callable[..., sim.Machine]):
    """T = 4 K(sin²(θ/2)) √(I / m g l) for a swing of ±θ, at any amplitude."""
    mass, length, inertia, swing = 2.0, 0.3, 0.1, 2.0
    machine = one_joint(mass=mass, length=length, inertia=inertia, gravity=(9.81, 0.0, 0.0))
    about_axis = inertia + mass * length**2
    quarter = ellipk(np.sin(swing / 2) ** 2) * np.sqrt(about_axis / (mass * 9.81 * length))
    plant = sim.Plant(machine, np.array([swing]), interval=quarter / 400)
    plant.drive(np.zeros(1))
    for target in (0.0, -swing, 0.0, swing):
        for _ in range(400):
            plant.advance()
        np.testing.assert_allclose(plant.position, target, atol=1e-9)


def test_a_sliding_joint_falls_freely():
    link = LinkParameters(3.0, np.zeros(3), np.eye(3), 1.0)  # 1 kg of motor does not fall
    robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0)], kinds="P")
    machine = sim.Machine(
        robot=dataclasses.replace(robot, links=(link,)),
        viscous=(0.0,),
        dry=(0.0,),
        static=(0.0,),
        static_velocity=(1.0,),
        encoder_resolution=(0.0,),
        maximum_torque=(np.inf,),
        position_range=((-np.inf, np.inf),),
    )
    plant = sim.Plant(machine, np.zeros(1), interval=0.01)
    plant.drive(np.zeros(1))
    for _ in range(100):
        plant.advance()
    np.testing.assert_allclose(plant.position, -0.5 * 9.81 * 3 / 4, rtol=1e-12)


def test_energy_is_conserved_without_friction_and_drive(pinocchio_model: Callable[..., Any]):
    import pinocchio as pin

    machine = without_friction(sim.puma560())
    model = pinocchio_model(machine.robot)
    data = model.createData()
    plant = sim.Plant(machine, np.array([0.1, -2.0, 0.3, 0.4, 0.5, 0.6]), interval=0.002)
    plant.drive(np.zeros(6))

    def energies() -> tuple[float, float]:
        return (
            pin.computeKineticEnergy(model, data, plant.position, plant.velocity),
            pin.computePotentialEnergy(model, data, plant.position),
        )

    _, potential = energies()
    moved = 0.0
    for _ in range(500):
        plant.advance()
        kinetic, now = energies()
        moved = max(moved, kinetic)
        np.testing.assert_allclose(kinetic + now, potential, atol=1e-8)
    assert moved > 10  # J


def test_motion_converges_with_the_fourth_power_of_the_step():
    machine = dataclasses.replace(without_friction(sim.puma560()), viscous=(1.0,) * 6)

    def end(step: float) -> np.ndarray:
        plant = sim.Plant(dataclasses.replace(machine, time_step=step), np.zeros(6), interval=0.02)
        plant.drive(np.array([20.0, 10.0, 5.0, 1.0, 1.0, 1.0]))
        for _ in range(25):
            plant.advance()
        return plant.position

    exact = end(0.02 / 64)
    errors = [np.abs(end(step) - exact).max() for step in (0.02, 0.01)]
    assert 10 < errors[0] / errors[1] < 25


def test_the_interval_is_divided_into_equal_steps_no_longer_than_asked():
    machine = without_friction(sim.puma560())
    for time_step in (1.0, 0.002, 0.0015, 0.0003):
        plant = sim.Plant(
            dataclasses.replace(machine, time_step=time_step), np.zeros(6), interval=0.002
        )
        plant.drive(np.full(6, 0.1))
        plant.advance()
        moved = plant.velocity / plant.acceleration  # nearly constant: 2 ms from rest
        np.testing.assert_allclose(moved, 0.002, rtol=0.02)


def test_drives_give_no_more_than_they_can():
    machine = sim.puma560()
    plant = sim.Plant(machine, np.zeros(6), interval=0.002)
    plant.drive(np.array([1e3, -1e3, 10.0, 0.0, 1e3, -1e3]))
    limit = machine.maximum_torque
    np.testing.assert_array_equal(
        plant.torque, [limit[0], -limit[1], 10.0, 0.0, limit[4], -limit[5]]
    )


def test_halving_the_step_moves_no_encoder_by_more_than_a_count(
    performed: dict[str, sim.SimulatedRecording],
):
    machine, trajectory = sim.puma560(), sim.comparison()
    resolution = np.array(machine.encoder_resolution)
    finer = dataclasses.replace(machine, time_step=machine.time_step / 2)
    once = performed["comparison"].recording.position
    moved = once - sim.simulate(finer, trajectory, seed=3).recording.position
    assert np.abs(moved / resolution).max() < 1.01
    # Without quantisation readings need no rounding to agree, and the difference is the
    # integrator's.
    positions = [
        sim.simulate(
            dataclasses.replace(one, encoder_resolution=(0.0,) * 6), trajectory
        ).recording.position
        for one in (machine, finer)
    ]
    assert np.abs((positions[0] - positions[1]) / resolution).max() < 0.01

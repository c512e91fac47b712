"""Rotors, gears and links: closed forms, conservation, and the record of when gears are apart."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator


ROTOR, LINK = 0.7, 0.3  # kg m²


@pytest.fixture(scope="module")
def two_masses() -> Callable[..., sim.Machine]:
    """One revolute joint without gravity or friction: a rotor and a link behind a spring."""

    def build(**changes: Any) -> sim.Machine:
        link = LinkParameters(0.0, np.zeros(3), np.diag([0.0, LINK, LINK]), ROTOR)
        robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0)], gravity=(0.0, 0.0, 0.0))
        off: dict[str, Any] = {
            "viscous": (0.0,),
            "dry": (0.0,),
            "static": (0.0,),
            "static_velocity": (1.0,),
            "encoder_resolution": (0.0,),
            "maximum_torque": (math.inf,),
            "position_range": ((-math.inf, math.inf),),
            "start_spread": 0.0,
            "stiffness": (500.0,),
        }
        return sim.Machine(robot=dataclasses.replace(robot, links=(link,)), **(off | changes))

    return build


def run(plant: sim.Plant, intervals: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotor and link positions after each interval."""
    rotor, link = np.empty((2, intervals))
    for i in range(intervals):
        plant.advance()
        rotor[i], link[i] = plant.rotor_position[0], plant.position[0]
    return rotor, link


def test_two_masses_swing_against_each_other(two_masses: Callable[..., sim.Machine]):
    """A torque step: the centre accelerates evenly, the twist is (τ/J)(1 − cos ωt)/ω²."""
    plant = sim.Plant(two_masses(), np.zeros(1), interval=0.002)
    plant.drive(np.array([2.0]))
    rotor, link = run(plant, 200)
    time = 0.002 * np.arange(1, 201)
    omega = math.sqrt(500.0 * (1 / ROTOR + 1 / LINK))
    twist = 2.0 / ROTOR * (1 - np.cos(omega * time)) / omega**2
    centre = (ROTOR * rotor + LINK * link) / (ROTOR + LINK)
    np.testing.assert_allclose(rotor - link, twist, atol=1e-7)
    np.testing.assert_allclose(centre, 2.0 / (ROTOR + LINK) * time**2 / 2, rtol=1e-9)


def test_damping_takes_the_swing_away(two_masses: Callable[..., sim.Machine]):
    """The twist of a damped pair: its envelope falls as exp(−c/2 (1/J + 1/I) t)."""
    damping = 0.4
    plant = sim.Plant(two_masses(transmission_damping=(damping,)), np.zeros(1), interval=0.002)
    plant.drive(np.array([2.0]))
    rotor, link = run(plant, 400)
    time = 0.002 * np.arange(1, 401)
    rate = damping / 2 * (1 / ROTOR + 1 / LINK)
    omega = math.sqrt(500.0 * (1 / ROTOR + 1 / LINK) - rate**2)
    final = 2.0 / ROTOR / (omega**2 + rate**2)
    envelope = np.exp(-rate * time)
    twist = final * (1 - envelope * (np.cos(omega * time) + rate / omega * np.sin(omega * time)))
    np.testing.assert_allclose(rotor - link, twist, atol=1e-7)


def test_a_dead_band_is_crossed_freely(two_masses: Callable[..., sim.Machine]):
    """Until the gears meet, the rotor is alone: b/2 = (τ/J) t²/2; the link stands still."""
    band = 0.02
    plant = sim.Plant(two_masses(backlash=(band,)), np.zeros(1), interval=0.0005)
    plant.drive(np.array([1.0]))
    meet = math.sqrt(band * ROTOR)
    intervals = int(meet / 0.0005)
    rotor, link = run(plant, intervals)
    time = 0.0005 * np.arange(1, intervals + 1)
    np.testing.assert_allclose(rotor, time**2 / ROTOR / 2, rtol=1e-10)
    np.testing.assert_array_equal(link, 0.0)
    assert plant.apart[0]
    plant.drive(np.array([1.0]))
    np.testing.assert_allclose(plant.transmitted, 0.0, atol=1e-12)
    run(plant, 5)
    assert not plant.apart[0]
    plant.drive(np.array([1.0]))
    gap = plant.rotor_position[0] - plant.position[0]
    np.testing.assert_allclose(plant.transmitted, 500.0 * (gap - band / 2), rtol=1e-9)


def test_energy_and_momentum_are_conserved_across_the_dead_band(
    two_masses: Callable[..., sim.Machine],
):
    band, stiffness = 0.02, 500.0
    machine = two_masses(backlash=(band,), time_step=1e-4)
    plant = sim.Plant(machine, np.zeros(1), interval=0.002)
    plant.drive(np.array([1.0]))
    run(plant, 50)
    plant.drive(np.zeros(1))

    def state() -> tuple[float, float]:
        slow, fast = plant.velocity[0], plant.rotor_velocity[0]
        wound = max(abs(plant.rotor_position[0] - plant.position[0]) - band / 2, 0.0)
        energy = (ROTOR * fast**2 + LINK * slow**2 + stiffness * wound**2) / 2
        return float(energy), float(ROTOR * fast + LINK * slow)

    energy, momentum = state()
    crossings = 0
    apart = plant.apart[0]
    for _ in range(500):
        plant.advance()
        crossings += int(plant.apart[0] != apart)
        apart = plant.apart[0]
        now, still = state()
        # The spring's force has a corner where the gears meet, which costs the integrator order.
        np.testing.assert_allclose(now, energy, rtol=1e-5)
        np.testing.assert_allclose(still, momentum, rtol=1e-9)
    assert crossings > 4


def test_a_stiff_transmission_is_a_rigid_joint():
    """The limit, over 0.1 s of the training trajectory; what is left is the spring's give."""
    none = (0.0,) * 6
    rigid = sim.undisturbed(
        dataclasses.replace(sim.puma560(), start_spread=0.0, dry=none, static=none)
    )
    stiff = dataclasses.replace(
        rigid,
        stiffness=(1e7, 1e7, 1e7, 1e6, 1e6, 2e5),
        transmission_damping=(1e3, 1e3, 1e3, 5.0, 5.0, 1.0),
        link_share=(0.3,) * 6,
        time_step=1e-5,
    )
    trajectory = sim.training(samples=50)
    one, other = (sim.simulate(machine, trajectory).truth for machine in (rigid, stiff))
    give = np.abs(other.rotor_position - other.position).max(axis=0)
    np.testing.assert_array_less(np.abs(one.position - other.position).max(axis=0), 1e-5)
    np.testing.assert_array_less(give, 2e-5)


@pytest.fixture(scope="module")
def everything() -> dict[str, sim.SimulatedRecording]:
    """Both trajectories with every disturbance on."""
    machine = sim.disturbed(sim.puma560())
    short = sim.training(samples=600)
    return {
        "training": sim.simulate(machine, short, seed=4),
        "comparison": sim.simulate(machine, sim.comparison(), seed=4),
    }


@pytest.mark.parametrize("name", ["training", "comparison"])
def test_truth_obeys_the_equations_of_links_and_of_rotors(
    name: str,
    everything: dict[str, sim.SimulatedRecording],
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]],
):
    machine, truth = sim.disturbed(sim.puma560()), everything[name].truth
    links = [dataclasses.replace(link, motor_inertia=0.0) for link in machine.links]
    rigid = inverse_dynamics(machine.robot, links)(
        truth.position, truth.velocity, truth.acceleration
    )
    # To the accuracy of the constraint solver, tried by a stuck wrist of 4e-5 kg m² on a spring.
    np.testing.assert_allclose(rigid + truth.link_friction, truth.transmitted, atol=1e-5)
    error = np.abs(rigid + truth.link_friction - truth.transmitted)
    assert np.quantile(error, 0.99) < 1e-10
    inertia = np.array([float(link.motor_inertia) for link in machine.links])
    np.testing.assert_allclose(
        inertia * truth.rotor_acceleration
        + truth.friction
        - truth.link_friction
        + truth.transmitted,
        truth.torque,
        atol=1e-9,
    )


def test_the_gears_are_apart_where_nothing_is_transmitted(
    everything: dict[str, sim.SimulatedRecording],
):
    """But for what the oil between the teeth drags along."""
    machine, truth = sim.disturbed(sim.puma560()), everything["training"].truth
    drag = np.array(machine.transmission_damping) * (truth.rotor_velocity - truth.velocity)
    np.testing.assert_allclose(truth.transmitted[truth.apart], drag[truth.apart], atol=1e-9)
    met = ~truth.apart
    gap = np.abs(truth.rotor_position - truth.position) - np.array(machine.backlash) / 2
    spring = np.abs(truth.transmitted - drag)
    np.testing.assert_allclose(
        spring[met], (np.array(machine.stiffness) * gap)[met], rtol=1e-6, atol=1e-7
    )
    assert np.all(truth.apart.any(axis=0))


def test_encoders_are_on_the_rotors(everything: dict[str, sim.SimulatedRecording]):
    recording, truth = everything["comparison"]
    resolution = np.array(sim.puma560().encoder_resolution)
    slack = 2e-5 * np.abs(truth.rotor_velocity)  # the timing's jitter
    off = np.abs(recording.position - truth.rotor_position)
    assert np.all(off <= resolution + slack + 1e-12)
    assert np.abs(recording.position - truth.position).max() > 2 * resolution.max()


def test_halving_the_step_moves_no_encoder_by_more_than_a_count():
    """Backlash and compliance on, over the comparison trajectory (design: the simulator)."""
    for names in (("backlash", "compliance", "static friction", "quantisation"), ("backlash",)):
        machine = sim.disturbed(sim.puma560(), *names)
        finer = dataclasses.replace(machine, time_step=machine.time_step / 2)
        moved = (
            sim.simulate(machine, sim.comparison()).recording.position
            - sim.simulate(finer, sim.comparison()).recording.position
        )
        most = np.abs(moved / np.array(sim.puma560().encoder_resolution)).max()
        assert most < (1.01 if "quantisation" in names else 0.1), names


def test_the_model_is_mujoco_s_own_dead_band():
    machine = sim.disturbed(sim.puma560(), "backlash")
    model = mujoco.MjModel.from_xml_string(
        sim.mjcf(
            machine.robot,
            stiffness=machine.stiffness,
            backlash=machine.backlash,
            transmission_damping=machine.transmission_damping,
        )
    )
    assert (model.nv, model.nu, model.ntendon) == (12, 6, 6)
    half = np.array(machine.backlash) / 2
    np.testing.assert_allclose(model.tendon_lengthspring, np.stack([-half, half], axis=1))
    np.testing.assert_allclose(model.tendon_stiffness, machine.stiffness)
    motors = [float(link.motor_inertia) for link in machine.links]
    np.testing.assert_allclose(model.dof_armature, [0.0] * 6 + motors)


def test_a_step_too_long_for_the_gears_is_refused():
    machine = dataclasses.replace(sim.disturbed(sim.puma560(), "compliance"), time_step=2e-3)
    with pytest.raises(
        sim.MachineError, match=r"time_step is 0.002 s; expected no more than .* of joint 6"
    ):
        sim.simulate(machine, sim.comparison())

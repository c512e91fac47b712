"""Eqn. 2.5-4: the law itself, and that the plant obeys it when joints slide, stop and stick."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import sim


@pytest.fixture
def friction() -> sim.Friction:
    return sim.Friction.of(sim.puma560())


def test_law_is_eqn_2_5_4(friction: sim.Friction, rng: np.random.Generator):
    qd = rng.normal(size=(40, 6))
    k_v, k_d, k_s, gamma = (
        friction.viscous,
        friction.dry,
        friction.static,
        friction.static_velocity,
    )
    expected = k_v * qd + np.sign(qd) * (k_d + (k_s - k_d) * np.exp(-np.abs(qd) / gamma))
    np.testing.assert_allclose(friction.torque(qd), expected, rtol=1e-14)
    np.testing.assert_array_equal(friction.torque(-qd), -friction.torque(qd))


def test_law_at_its_ends(friction: sim.Friction):
    assert not friction.torque(np.zeros(6)).any()
    np.testing.assert_allclose(friction.torque(np.full(6, 1e-12)), friction.static, rtol=1e-9)
    fast = np.full(6, 100.0)
    np.testing.assert_allclose(
        friction.torque(fast), friction.viscous * fast + friction.dry, rtol=1e-14
    )


def test_help_is_continuous_at_rest(friction: sim.Friction):
    tiny = np.full(6, 1e-15)
    np.testing.assert_allclose(friction.help(tiny), friction.help(-tiny), atol=1e-12)


def test_sliding_joints_obey_the_law(performed: dict[str, sim.SimulatedRecording]):
    """Except where a joint stops within the next step: there friction is what stops it."""
    machine = sim.puma560()
    friction = sim.Friction.of(machine)
    for name, (_, truth) in performed.items():
        speed = np.abs(truth.velocity)
        slides = speed > 1.01 * machine.time_step * np.abs(truth.acceleration) + 1e-4
        np.testing.assert_allclose(
            truth.friction[slides],
            friction.torque(truth.velocity)[slides],
            atol=1e-10,
            err_msg=name,
        )
        assert slides.mean() > 0.8, name
        assert np.mean(slides | (speed < 1e-3)) > 0.998, name
        # Never more than it can be; a joint about to turn is already held from the other side.
        most = (
            friction.viscous * speed
            + friction.static
            + np.where(slides, 0.0, np.abs(friction.help(truth.velocity)))
        )
        assert np.all(np.abs(truth.friction) <= most + 1e-10), name


def test_viscous_friction_slows_exponentially(one_joint: Callable[..., sim.Machine]):
    plant = sim.Plant(one_joint(inertia=0.5, viscous=(2.0,)), np.zeros(1), interval=0.002)
    plant.drive(np.array([1.0]))
    for _ in range(500):
        plant.advance()
    # I dω/dt = τ − k ω
    np.testing.assert_allclose(plant.velocity, 0.5 * (1 - np.exp(-4.0)), rtol=1e-10)


def test_dry_friction_stops_a_joint_and_holds_it(one_joint: Callable[..., sim.Machine]):
    machine = one_joint(inertia=0.5, dry=(2.0,), static=(2.0,))
    plant = sim.Plant(machine, np.zeros(1), interval=0.002)
    plant.drive(np.array([3.0]))
    for _ in range(100):
        plant.advance()
    np.testing.assert_allclose(plant.velocity, (3.0 - 2.0) / 0.5 * 0.2, rtol=1e-6)
    plant.drive(np.zeros(1))
    for _ in range(50):
        plant.advance()
    # Stopped on time but for the last step, whose stages each see less speed left to brake.
    np.testing.assert_allclose(plant.velocity, 0.0, atol=0.4 * 2.0 / 0.5 * machine.time_step)
    np.testing.assert_allclose(plant.position, 0.04 + 0.4 * 0.1 / 2, rtol=1e-3)
    for _ in range(50):
        plant.advance()
    np.testing.assert_allclose(plant.velocity, 0.0, atol=1e-12)
    stopped = plant.position
    for _ in range(500):
        plant.advance()
    np.testing.assert_allclose(plant.position, stopped, atol=1e-9)


@pytest.mark.parametrize("share", [0.5, 0.99, -0.99])
def test_a_joint_sticks_below_breakaway(one_joint: Callable[..., sim.Machine], share: float):
    machine = one_joint(inertia=0.2, dry=(1.0,), static=(1.25,), static_velocity=(0.1,))
    plant = sim.Plant(machine, np.zeros(1), interval=0.002)
    plant.drive(np.array([share * 1.25]))
    for _ in range(1000):
        plant.advance()
    # Two seconds of creep, in counts of a PUMA's encoder.
    assert abs(float(plant.position[0])) / 8e-5 < 0.01
    plant.drive(np.array([share * 1.25]))
    np.testing.assert_allclose(plant.friction, share * 1.25, atol=1e-6)


def test_a_joint_breaks_away_and_then_needs_less(one_joint: Callable[..., sim.Machine]):
    machine = one_joint(inertia=0.2, dry=(1.0,), static=(1.25,), static_velocity=(0.1,))
    plant = sim.Plant(machine, np.zeros(1), interval=0.002)
    plant.drive(np.array([1.26]))
    for _ in range(1000):
        plant.advance()
    assert plant.velocity[0] > 0.5
    plant.drive(np.array([1.1]))  # would not have started it
    np.testing.assert_allclose(plant.acceleration, (1.1 - 1.0) / 0.2, rtol=1e-2)


def test_without_friction_nothing_is_taken(one_joint: Callable[..., sim.Machine]):
    plant = sim.Plant(one_joint(inertia=0.2), np.zeros(1), interval=0.002)
    plant.drive(np.array([1.0]))
    np.testing.assert_allclose(plant.acceleration, 5.0, rtol=1e-12)
    assert plant.friction[0] == 0.0


def test_static_friction_off_leaves_dry(friction: sim.Friction):
    machine = dataclasses.replace(sim.puma560(), static=sim.puma560().dry)
    qd = np.full(6, 1e-6)
    np.testing.assert_allclose(
        sim.Friction.of(machine).torque(qd), friction.viscous * qd + friction.dry, rtol=1e-14
    )


def test_asymmetric_law(rng: np.random.Generator):
    """1 + a times the law forwards, 1 − a times backwards."""
    machine = dataclasses.replace(sim.puma560(), asymmetry=(0.2, -0.1, 0.0, 0.5, 0.3, -0.4))
    qd = np.abs(rng.normal(size=(20, 6)))
    even, odd = sim.Friction.of(sim.puma560()), sim.Friction.of(machine)
    a = np.array(machine.asymmetry)
    np.testing.assert_allclose(odd.torque(qd), (1 + a) * even.torque(qd), rtol=1e-13)
    np.testing.assert_allclose(odd.torque(-qd), (1 - a) * even.torque(-qd), rtol=1e-13)
    tiny = np.full(6, 1e-15)
    np.testing.assert_allclose(odd.help(tiny), odd.help(-tiny), atol=1e-12)


@pytest.mark.parametrize(
    ("torque", "moves"), [(1.4, False), (1.6, True), (-0.9, False), (-1.1, True)]
)
def test_an_asymmetric_joint_breaks_away_sooner_one_way(
    one_joint: Callable[..., sim.Machine], torque: float, moves: bool
):
    """k^s (1 + a) = 1.5 forwards and k^s (1 − a) = 1 backwards."""
    machine = one_joint(
        inertia=0.2, dry=(1.0,), static=(1.25,), static_velocity=(0.1,), asymmetry=(0.2,)
    )
    plant = sim.Plant(machine, np.zeros(1), interval=0.002)
    plant.drive(np.array([torque]))
    for _ in range(200):
        plant.advance()
    assert (abs(float(plant.position[0])) > 1e-3) == moves


def test_friction_is_shared_between_rotor_and_link():
    machine = sim.disturbed(sim.puma560(), "compliance")
    friction = sim.Friction.of(machine)
    _, truth = sim.simulate(machine, sim.comparison(), seed=1)
    forwards = (truth.velocity > 0.05) & (truth.rotor_velocity > 0.05)
    link, rotor = truth.link_friction, truth.friction - truth.link_friction
    np.testing.assert_allclose(
        link[forwards], 0.3 * friction.torque(truth.velocity)[forwards], atol=1e-9
    )
    np.testing.assert_allclose(
        rotor[forwards], 0.7 * friction.torque(truth.rotor_velocity)[forwards], atol=1e-9
    )

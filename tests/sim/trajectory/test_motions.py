"""Circles of the hand and motions drawn at random: where the hand is, by other kinematics."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import Manipulator


NEAR = np.array([0.0, -0.5, 2.9, 0.0, 0.8, 0.0])
CENTRE, RADIUS, FLANGE = np.array([0.62, 0.15, -0.12]), 0.1, 0.05625


@pytest.fixture(scope="module")
def path() -> sim.SampledPath:
    return sim.circle(
        sim.puma560(),
        CENTRE.tolist(),
        RADIUS,
        near=NEAR,
        duration=1.0,
        normal=(1.0, 0.0, 1.0),
        turns=-1.0,
        point=(0.0, 0.0, FLANGE),
    )


def test_the_hand_goes_around_without_turning(
    path: sim.SampledPath, pinocchio_model: Callable[..., Any]
):
    """By Pinocchio: on the circle at every row, the orientation that of `near`."""
    import pinocchio as pin

    model = pinocchio_model(sim.puma560().robot)
    data = model.createData()

    def poses(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pin.forwardKinematics(model, data, q)
        last = data.oMi[6]
        return last.act(np.array([0.0, 0.0, FLANGE])), last.rotation.copy()

    points, rotations = (np.stack(rows) for rows in zip(*(poses(q) for q in path.q), strict=True))
    arms = points - CENTRE
    normal = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), RADIUS, atol=1e-11)
    np.testing.assert_allclose(arms @ normal, 0.0, atol=1e-11)
    np.testing.assert_allclose(rotations, np.broadcast_to(poses(NEAR)[1], (501, 3, 3)), atol=1e-11)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-11)
    # A whole turn, negative about the normal, along minimum jerk.
    second = np.cross(normal, arms[0])
    angle = np.unwrap(np.arctan2(arms @ second, arms @ arms[0]))
    expected = -2 * np.pi * sim.minimum_jerk(np.linspace(0, 1, 501))
    np.testing.assert_allclose(angle, expected, atol=1e-9)


def test_its_rates_are_those_of_the_hand(path: sim.SampledPath):
    """J qd is the circle's velocity, and what J qdd + (J qd)·∂J gives its acceleration."""
    hand = sim.Hand.of(sim.puma560().robot, (0.0, 0.0, FLANGE))
    time = np.linspace(0.0, 1.0, 501)
    angle = -2 * np.pi * sim.minimum_jerk(time)
    rate = -2 * np.pi * 30 * (time * (1 - time)) ** 2
    change = -2 * np.pi * 60 * time * (1 - time) * (1 - 2 * time)
    point, jacobian = hand.locate(path.q)
    first = (np.asarray(point)[0] - CENTRE) / RADIUS
    normal = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    radial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(normal, first)
    tangent = np.cross(normal, radial)
    velocity = RADIUS * rate[:, None] * tangent
    acceleration = RADIUS * (change[:, None] * tangent - (rate**2)[:, None] * radial)

    def moving(q: jax.Array, qd: jax.Array) -> Any:
        return (hand.locate(q)[1] @ qd[:, None])[:, 0]

    drift = jax.jit(jax.vmap(lambda q, qd: jax.jvp(lambda q: moving(q, qd), (q,), (qd,))[1]))
    np.testing.assert_allclose(np.einsum("sij,sj->si", jacobian, path.qd), velocity, atol=1e-8)
    np.testing.assert_allclose(
        np.einsum("sij,sj->si", jacobian, path.qdd) + drift(path.q, path.qd),
        acceleration,
        atol=1e-4,
    )
    for rows in (path.qd, path.qdd):
        np.testing.assert_allclose(rows[[0, -1]], 0.0, atol=1e-8)


def test_an_arm_of_two_joints_goes_around_if_it_may_turn_its_hand():
    robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)])
    link = sim.puma560().links[1]
    machine = sim.Machine(
        robot=dataclasses.replace(robot, links=(link, link)),
        viscous=(0.0,) * 2,
        dry=(0.0,) * 2,
        static=(0.0,) * 2,
        static_velocity=(1.0,) * 2,
        encoder_resolution=(0.0,) * 2,
        maximum_torque=(np.inf,) * 2,
        position_range=((-np.inf, np.inf),) * 2,
    )
    arguments: dict[str, Any] = {"near": np.array([0.2, 1.0]), "duration": 0.5}
    with pytest.raises(sim.MachineError, match="2 joints cannot keep the hand from turning"):
        sim.circle(machine, (1.0, 0.8, 0.0), 0.2, **arguments)
    path = sim.circle(
        machine, (1.0, 0.8, 0.0), 0.2, point=(0.7, 0.0, 0.0), keep_orientation=False, **arguments
    )
    point, _ = sim.Hand.of(robot, (0.7, 0.0, 0.0)).locate(path.q)
    np.testing.assert_allclose(
        np.linalg.norm(np.asarray(point) - [1.0, 0.8, 0.0], axis=1), 0.2, atol=1e-9
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"centre": (1.5, 0.15, 0.0)}, r"circle, 0 s: the hand cannot reach \(1\.4"),
        ({"radius": 0.0}, "circle of radius 0.0 m"),
        ({"duration": 0.01}, "a duration of 8 intervals"),
        ({"normal": (0.0, 0.0, 0.0)}, "its normal is zero"),
        ({"near": np.zeros(2)}, "near has 2 joints; the machine has 6"),
        ({"centre": (0.3, 0.15, 0.1), "radius": 0.3}, r"circle, \d"),
    ],
)
def test_circles_that_cannot_be_gone_are_refused(changes: dict[str, Any], message: str):
    arguments: dict[str, Any] = {
        "centre": (0.62, 0.15, -0.12),
        "radius": 0.1,
        "near": NEAR,
        "duration": 0.5,
    }
    with pytest.raises(sim.MachineError, match=message):
        sim.circle(sim.puma560(), **(arguments | changes))


def test_a_circle_out_of_a_joint_range_is_refused():
    narrow = dataclasses.replace(
        sim.puma560(), position_range=((-0.05, 3.0), *sim.puma560().position_range[1:])
    )
    with pytest.raises(sim.MachineError, match=r"s: joint 1 is at -0\.05.*, outside its range"):
        sim.circle(narrow, CENTRE.tolist(), RADIUS, near=NEAR, duration=0.5)


def test_random_motions_keep_to_ranges_and_speeds():
    machine = sim.puma560()
    low, high = np.array(machine.position_range).T
    speed = np.array([1.0, 1.0, 1.5, 2.0, 2.0, 2.0])
    for seed in range(20):
        start, path = sim.go_to(machine, seed, speed, margin=0.1)
        for ends in (start, path.end):
            assert np.all(ends >= low + 0.1 * (high - low) - 1e-12)
            assert np.all(ends <= high - 0.1 * (high - low) + 1e-12)
        time = np.linspace(0, path.duration, 201)[:, None]
        rate = np.abs(np.asarray(path.reference(time, np.tile(start, (201, 1))).qd))
        np.testing.assert_allclose((rate / speed).max(), 1.0, rtol=1e-9)
    one, again, other = (sim.go_to(machine, seed, speed)[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, again)
    assert np.any(one != other)


def test_random_motions_that_cannot_be_are_refused():
    with pytest.raises(sim.MachineError, match="speed is 0"):
        sim.go_to(sim.puma560(), 1, 0.0)
    with pytest.raises(sim.MachineError, match=r"margin is 0\.5"):
        sim.go_to(sim.puma560(), 1, 1.0, margin=0.5)

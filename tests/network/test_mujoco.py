"""Torque against MuJoCo's inverse dynamics, on models built independently."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import jaxcslc
from jaxcslc.codegen import array_outputs, named
from jaxcslc.manipulator import LinkParameters, Manipulator
from jaxcslc.network import RigidBodyRecursion, code


# Of the largest torque among a robot's samples. Both sides round at 1e-15 per operation.
AGREEMENT = 1e-9
# Of every chain: robots of as many joints and samples share compiled programs.
SAMPLES = 16

# Craig's rows with Armstrong's lengths, written out so that the robot file is tested as well.
PUMA = [
    (0.0, 0.0, 0.0, 0.0),
    (-math.pi / 2, 0.0, 0.2435, 0.0),
    (0.0, 0.4318, -0.0934, 0.0),
    (math.pi / 2, -0.0203, 0.4331, 0.0),
    (-math.pi / 2, 0.0, 0.0, 0.0),
    (math.pi / 2, 0.0, 0.0, 0.0),
]
PANDA = [
    (0.0, 0.0, 0.333, 0.0),
    (-math.pi / 2, 0.0, 0.0, 0.0),
    (math.pi / 2, 0.0, 0.316, 0.0),
    (math.pi / 2, 0.0825, 0.0, 0.0),
    (-math.pi / 2, -0.0825, 0.384, 0.0),
    (math.pi / 2, 0.0, 0.0, 0.0),
    (math.pi / 2, 0.088, 0.0, 0.0),
]
DOWN = (0.0, 0.0, -9.81)

MujocoTorque = Callable[..., Callable[..., np.ndarray]]
RandomLinks = Callable[..., tuple[LinkParameters, ...]]


def disagreement(actual: Any, expected: np.ndarray) -> float:
    return float(np.max(np.abs(np.asarray(actual) - expected)) / np.max(np.abs(expected)))


def frictionless(robot: Manipulator, links: Any, lengths: Any, evaluator: str) -> Any:
    """The function (q, qd, qdd) -> torque of the network with those links' coefficients."""
    network = jaxcslc.derive(robot.with_friction(), lengths=lengths, evaluator=evaluator)  # type: ignore[arg-type]
    k = network.coefficients_from(links)
    return lambda *state: network.torque(k, *state)


def straight_line(robot: Manipulator, links: Any) -> Callable[..., np.ndarray]:
    """The same by straight-line code, on NumPy's arrays: nothing is compiled."""
    network = jaxcslc.derive(robot.with_friction(), lengths="numeric", evaluator="unrolled")
    k = np.asarray(network.coefficients_from(links))
    assert isinstance(network.rigid_body, RigidBodyRecursion)
    expressed = code(network.rigid_body, "torque")

    def torque(*states: np.ndarray) -> np.ndarray:
        inputs = named("k", k)
        for name, values in zip(("q", "qd", "qdd"), states, strict=True):
            inputs |= named(name, values.T)
        outputs = array_outputs(expressed.graph, expressed.outputs, inputs)
        return np.stack(np.broadcast_arrays(*outputs), axis=1)

    return torque


def rigid_puma(links: tuple[LinkParameters, ...]) -> tuple[LinkParameters, ...]:
    """Armstrong's links, made into bodies that can exist without a change of any torque.

    Link 3's measured moments break the triangle inequality. 0.004 more of its Ixx and Iyy, and as
    much less of link 1's Izz, cancel in every coefficient. Link 1 turns about the vertical: its
    mass on that axis and its other moments enter no joint torque.
    """
    first, third = links[0], links[2]
    moment = float(first.inertia[2, 2]) - 0.004
    return (
        LinkParameters(1.0, np.zeros(3), moment * np.eye(3), first.motor_inertia),
        links[1],
        LinkParameters(
            third.mass,
            third.centre_of_gravity,
            np.asarray(third.inertia) + np.diag([0.004, 0.004, 0.0]),
            third.motor_inertia,
        ),
        *links[3:],
    )


@pytest.mark.parametrize(
    ("lengths", "evaluator"),
    [("symbolic", "tables"), ("numeric", "tables"), ("numeric", "recursive")],
)
def test_puma560(
    mujoco_torque: MujocoTorque, rng: np.random.Generator, lengths: str, evaluator: str
) -> None:
    robot = jaxcslc.puma560()
    assert robot.links is not None
    torque = frictionless(robot, robot.links, lengths, evaluator)
    states = rng.uniform(-3, 3, (3, 50, 6))
    expected = mujoco_torque(PUMA, "RRRRRR", DOWN, rigid_puma(robot.links))(*states)
    assert disagreement(torque(*states), expected) < AGREEMENT


@pytest.mark.parametrize("motors", [False, True], ids=["bare", "motors"])
def test_panda(
    mujoco_torque: MujocoTorque,
    rng: np.random.Generator,
    random_links: RandomLinks,
    motors: bool,
) -> None:
    robot = jaxcslc.panda().with_inertia("full", motor_inertia=motors)
    links = random_links(rng, 7, motors=motors)
    torque = frictionless(robot, links, "numeric", "auto")
    states = rng.uniform(-3, 3, (3, 50, 7))
    expected = mujoco_torque(PANDA, "RRRRRRR", DOWN, links)(*states)
    assert disagreement(torque(*states), expected) < AGREEMENT
    assert disagreement(straight_line(robot, links)(*states), expected) < AGREEMENT


def random_chain(rng: np.random.Generator, joints: int) -> tuple[list[Any], str, list[float]]:
    """Rows, kinds and gravity: any twists, with parallel and perpendicular axes among them."""
    kinds = "".join(rng.choice(["R", "P"], joints, p=[0.7, 0.3]))
    quarters = rng.integers(-2, 3, joints) * math.pi / 2
    alpha = np.where(rng.random(joints) < 0.4, quarters, rng.uniform(-math.pi, math.pi, joints))
    a, d = rng.uniform(-0.5, 0.5, (2, joints)) * (rng.random((2, joints)) < 0.7)
    theta = rng.uniform(-math.pi, math.pi, joints) * (rng.random(joints) < 0.5)
    rows = [tuple(float(x) for x in row) for row in zip(alpha, a, d, theta, strict=True)]
    gravity = rng.standard_normal(3)
    return rows, kinds, [float(x) for x in 9.81 * gravity / np.linalg.norm(gravity)]


# A hundred chains in ten tests, so that workers can share them. Deriving an arbitrary chain of 7
# joints takes seconds, one of 2 milliseconds: there are more of the short ones.
JOINTS = [2, 2, 3, 3, 4, 4, 5, 5, 6, 7]


@pytest.mark.parametrize("group", range(10))
def test_a_hundred_random_chains(
    mujoco_torque: MujocoTorque, random_links: RandomLinks, rng: np.random.Generator, group: int
) -> None:
    del group  # names the test, and so seeds it
    for joints in JOINTS:
        rows, kinds, gravity = random_chain(rng, joints)
        robot = Manipulator.from_modified_dh(rows, kinds=kinds, gravity=gravity)
        links = random_links(rng, joints)
        torque = frictionless(robot, links, "numeric", "recursive")
        states = rng.uniform(-3, 3, (3, SAMPLES, joints))
        expected = mujoco_torque(rows, kinds, gravity, links)(*states)
        assert disagreement(torque(*states), expected) < AGREEMENT, (rows, kinds, gravity)
        unrolled = straight_line(robot, links)(*states)
        assert disagreement(unrolled, expected) < AGREEMENT, (rows, kinds, gravity)


@pytest.mark.parametrize("lengths", ["symbolic", "numeric"])
@pytest.mark.parametrize("kinds", ["RR", "PR", "RP", "RRP", "PPR", "RPR"])
def test_tables_of_short_random_chains(
    mujoco_torque: MujocoTorque,
    random_links: RandomLinks,
    rng: np.random.Generator,
    lengths: str,
    kinds: str,
) -> None:
    n = len(kinds)
    rows, _, gravity = random_chain(rng, n)
    robot = Manipulator.from_modified_dh(rows, kinds=kinds, gravity=gravity)
    links = random_links(rng, n)
    torque = frictionless(robot, links, lengths, "tables")
    states = rng.uniform(-3, 3, (3, SAMPLES, n))
    expected = mujoco_torque(rows, kinds, gravity, links)(*states)
    assert disagreement(torque(*states), expected) < AGREEMENT, (rows, kinds, gravity)


SINGULAR: dict[str, tuple[Any, str]] = {
    "single revolute": ([(0.3, 0.1, 0.2, 0.4)], "R"),
    "single prismatic": ([(0.3, 0.1, 0.2, 0.4)], "P"),
    "three parallel": ([(0.0, 0.0, 0.1, 0.0), (0.0, 0.4, 0.0, 0.0), (0.0, 0.3, 0.2, 0.5)], "RRR"),
    "antiparallel": (
        [(0.0, 0.0, 0.1, 0.0), (math.pi, 0.4, 0.2, 0.3), (-math.pi, 0.3, 0.0, 0.0)],
        "RRR",
    ),
    "antiparallel with a slide between": (
        [(0.0, 0.0, 0.1, 0.2), (math.pi, 0.4, 0.2, 0.3), (math.pi, 0.3, -0.1, 0.0)],
        "RPR",
    ),
    "prismatic first": ([(0.0, 0.0, 0.0, 0.0), (-math.pi / 2, 0.2, 0.1, 0.0)], "PR"),
    "all prismatic": (
        [(0.0, 0.0, 0.0, 0.0), (math.pi / 2, 0.2, 0.1, 0.0), (math.pi / 2, 0.0, 0.0, 1.0)],
        "PPP",
    ),
    "nearly parallel": ([(0.0, 0.0, 0.1, 0.0), (1e-3, 0.4, 0.0, 0.0)], "RR"),
}


@pytest.mark.parametrize(
    "gravity", [(0.0, 0.0, 0.0), DOWN, (3.0, -2.0, 9.0)], ids=["none", "down", "tilted"]
)
@pytest.mark.parametrize("name", list(SINGULAR))
def test_singular_chains(
    mujoco_torque: MujocoTorque,
    random_links: RandomLinks,
    rng: np.random.Generator,
    name: str,
    gravity: tuple[float, float, float],
) -> None:
    rows, kinds = SINGULAR[name]
    links = random_links(rng, len(kinds))
    robot = Manipulator.from_modified_dh(rows, kinds=kinds, gravity=gravity)
    states = rng.uniform(-3, 3, (3, SAMPLES, len(kinds)))
    expected = mujoco_torque(rows, kinds, gravity, links)(*states)
    for evaluator in ("tables", "recursive"):
        torque = frictionless(robot, links, "numeric", evaluator)
        assert disagreement(torque(*states), expected) < AGREEMENT, evaluator


def test_singular_positions(mujoco_torque: MujocoTorque, rng: np.random.Generator) -> None:
    """The straight arm, the folded arm and aligned wrist axes: every joint at the same angle."""
    robot = jaxcslc.puma560()
    assert robot.links is not None
    angles = np.array([0.0, 1e-7, math.pi / 2, math.pi, -math.pi])
    q = np.repeat(angles, 10)[:, None] * np.ones(6)
    qd, qdd = rng.uniform(-3, 3, (2, 50, 6))
    expected = mujoco_torque(PUMA, "RRRRRR", DOWN, rigid_puma(robot.links))(q, qd, qdd)
    for lengths, evaluator in (("symbolic", "tables"), ("numeric", "recursive")):
        torque = frictionless(robot, robot.links, lengths, evaluator)
        assert disagreement(torque(q, qd, qdd), expected) < AGREEMENT


def test_many_joints(
    mujoco_torque: MujocoTorque, random_links: RandomLinks, rng: np.random.Generator
) -> None:
    """Ten joints, parallel in pairs: names such as c9_10, and a chain longer than any arm."""
    rows = [(0.0, 0.2, 0.0, 0.0) if i % 2 else (math.pi / 2, 0.0, 0.1, 0.0) for i in range(10)]
    robot = Manipulator.from_modified_dh(rows)
    links = random_links(rng, 10)
    torque = frictionless(robot, links, "numeric", "auto")
    states = rng.uniform(-3, 3, (3, SAMPLES, 10))
    expected = mujoco_torque(rows, "R" * 10, DOWN, links)(*states)
    assert disagreement(torque(*states), expected) < AGREEMENT

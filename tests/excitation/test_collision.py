"""Distances of bodies: closed forms, slopes, bounds between samples, designs beside obstacles."""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcslc as jc
from jaxcslc.excitation import (
    BSplines,
    CollisionBodies,
    DenseCheck,
    Effort,
    Knowledge,
    Limits,
    Noise,
    Planner,
    Surroundings,
)
from jaxcslc.manipulator import link_poses


RADIUS = 0.05


@pytest.fixture(scope="module")
def arm() -> jc.Manipulator:
    """Two upright axes half a metre apart; the second link is a ball at its axis."""
    return jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])


@pytest.fixture(scope="module")
def bodies(arm: jc.Manipulator) -> CollisionBodies:
    surroundings = Surroundings(radius=RADIUS, spheres=(((0.0, 0.65, 0.0), 0.1),), clearance=0.03)
    return CollisionBodies.of(arm, surroundings)


def distance_of(angle: float) -> float:
    """Of the ball at the end of the first link from the sphere."""
    end = 0.5 * np.array([math.cos(angle), math.sin(angle)])
    return float(np.linalg.norm(end - [0.0, 0.65])) - RADIUS - 0.1


@pytest.mark.parametrize("angle", [0.9, 1.4, math.pi / 2])
def test_distances_are_those_of_geometry(bodies: CollisionBodies, angle: float) -> None:
    distance, _ = bodies.distances(np.array([angle, 0.3]), 2.0)
    assert distance.min() == pytest.approx(distance_of(angle), abs=1e-6)


def test_slopes_are_those_of_differences(bodies: CollisionBodies) -> None:
    q = np.array([[1.45, 0.2]])
    contacts = bodies.contacts(q)
    step = 1e-5
    numeric = (distance_of(1.45 + step) - distance_of(1.45 - step)) / (2 * step)
    assert contacts.jacobian[0] == pytest.approx([numeric, 0.0], abs=1e-4)


def test_the_least_distance_of_a_motion_is_bounded_closely(bodies: CollisionBodies) -> None:
    family = BSplines(1.0, 4)
    parameters = np.zeros((family.size, 2))
    parameters[1:, 0] = np.linspace(0.3, 1.2, family.size - 1)  # ends at 1.2 rad
    least, name = bodies.clearance(family, parameters)
    angles = family.derivative(parameters, np.linspace(0, 1, 5001))[:, 0]
    exact = min(distance_of(angle) for angle in angles) - 0.03
    assert -1e-9 <= least <= exact + 1e-9
    assert "obstacle sphere 1" in name


def test_a_collision_between_samples_is_noticed(bodies: CollisionBodies) -> None:
    family = BSplines(1.0, 4)
    parameters = np.zeros((family.size, 2))
    parameters[1:, 0] = 1.6
    assert bodies.clearance(family, parameters)[0] < 0.0


def test_a_design_keeps_its_distance(arm: jc.Manipulator) -> None:
    network = jc.derive(arm, lengths="numeric")
    k = np.ones(network.size)
    surroundings = Surroundings(radius=RADIUS, boxes=(((0.0, 0.6, 0.0), (0.2, 0.2, 0.2)),))
    stated = {"position": [-2, 2], "velocity": 3, "torque": 50}
    limits = Limits.of(arm, stated, surroundings)
    planner = Planner.of(
        network,
        limits,
        Noise(0.1, 1e-4),
        BSplines(2.0, 6),
        knowledge=Knowledge(k, None, np.full(network.size, np.inf)),
    )
    design = planner.design(Effort(1, 3, 10))
    assert design.use.feasible
    bodies = CollisionBodies.of(arm, surroundings)
    time = np.linspace(0.0, 2.0, 2001)
    q = design.family.derivative(design.parameters, time)
    assert min(bodies.distances(pose, 1.0)[0].min() for pose in q) >= 0.02
    check = DenseCheck(network, k, limits, planner.family, distance=bodies.clearance)
    assert check.use(design.parameters).feasible


def test_robots_without_shapes_have_capsules(arm: jc.Manipulator) -> None:
    """A link of half a metre, and the usual part of it as radius."""
    bodies = CollisionBodies.of(arm, Surroundings(spheres=(((0.0, 0.65, 0.0), 0.1),)))
    assert bodies.notes[-1].startswith("capsules of 27.5 mm radius stand for all links")
    distance, _ = bodies.distances(np.array([math.pi / 2, 0.0]), 2.0)
    assert distance.min() == pytest.approx(0.15 - 0.1 - 0.0275, abs=1e-6)


def test_a_wrong_number_of_radii_is_named(arm: jc.Manipulator) -> None:
    message = "radius: expected one number above 0 or 2"
    with pytest.raises(ValueError, match=message):
        CollisionBodies.of(arm, Surroundings(radius=(0.1, 0.1, 0.1)))


def heights_of_urdf(path: Path, q: dict[str, np.ndarray]) -> np.ndarray:
    """Heights of all joints' and frames' origins (samples, origins), by the file alone."""
    samples = len(next(iter(q.values())))
    root = ElementTree.parse(path).getroot()
    poses: dict[str, np.ndarray] = {root.findall("link")[0].attrib["name"]: np.eye(4)}
    heights: list[np.ndarray] = []
    for joint in root.iter("joint"):  # these files list them from the base outwards
        ends = {end: joint.find(end) for end in ("parent", "child", "origin", "axis")}
        entry = {key: {} if x is None else x.attrib for key, x in ends.items()}
        fixed = np.eye(4)
        angles = np.fromstring(entry["origin"].get("rpy", "0 0 0"), sep=" ")
        fixed[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
        fixed[:3, 3] = np.fromstring(entry["origin"].get("xyz", "0 0 0"), sep=" ")
        turn = np.tile(np.eye(4), (samples, 1, 1))
        if (angle := q.get(joint.attrib["name"])) is not None:
            axis = np.fromstring(entry["axis"]["xyz"], sep=" ")
            turn[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
        pose = poses[entry["parent"]["link"]] @ fixed @ turn
        poses[entry["child"]["link"]] = pose
        heights.append(pose[:, 2, 3])
    return np.stack(heights, axis=1)


@pytest.mark.parametrize("name", ["ur5", "puma560"])
def test_no_pose_of_a_design_is_below_the_floor(name: str) -> None:
    """Of the example's robot files, with what a file without surroundings gives."""
    path = Path(jc.__file__).parent / "examples" / "robots" / f"{name}.urdf"
    robot = jc.puma560() if name == "puma560" else jc.load_robot(path)
    limits = Limits.of(robot, surroundings="usual")
    planner = Planner.of(
        jc.derive(robot, lengths="numeric"), limits, Noise(0.5, 1e-4), BSplines(4.0, 8)
    )
    design = planner.design(Effort(1, 1, 10, seed=1))
    assert design.use.feasible
    q = design.family.derivative(design.parameters, np.linspace(0.0, 4.0, 2001))
    assert np.ptp(q, axis=0).max() > 0.1
    if name == "puma560":
        poses = np.asarray(link_poses(robot, q))
        tip = poses[:, -1] @ [0.0, 0.0, 0.064, 1.0]  # twice the centre of gravity of link 6
        heights = np.column_stack([poses[..., 2, 3], tip[:, 2]]) + 0.6718
    else:
        heights = heights_of_urdf(path, dict(zip(robot.joint_names, q.T, strict=True)))
    radius = {"ur5": 0.0636, "puma560": 0.0615}[name]
    assert heights.min() >= radius

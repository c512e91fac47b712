"""Distances of bodies: closed forms, slopes, bounds between samples, designs beside obstacles."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.excitation import (
    BSplines,
    CollisionBodies,
    DenseCheck,
    Knowledge,
    Limits,
    Noise,
    Planner,
    Surroundings,
)


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
    distance, _, _ = bodies.distances(np.array([angle, 0.3]), 2.0)
    assert distance.min() == pytest.approx(distance_of(angle), abs=1e-6)


def test_slopes_are_those_of_differences(bodies: CollisionBodies) -> None:
    q = np.array([[1.3, 0.2]])
    contacts = bodies.contacts(q)
    step = 1e-5
    numeric = (distance_of(1.3 + step) - distance_of(1.3 - step)) / (2 * step)
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


SHAPES = """<mujoco><asset><mesh name="wedge"
  vertex="0 0 0  .2 0 0  0 .15 0  0 0 .25  .1 .1 .1  .05 .02 .2"/></asset>
<worldbody><body name="base"><geom type="box" size=".1 .15 .05"/>
 <body name="upper" pos="0 0 .3"><joint name="j1" axis="0 0 1" range="-3 3"/>
  <geom type="cylinder" size=".04 .1"/>
  <body name="lower" pos=".35 0 0"><joint name="j2" axis="0 1 0" range="-3 3"/>
   <geom type="capsule" size=".05" fromto="0 0 0 .2 0 0"/>
   <body name="hand" pos=".3 0 0"><joint name="j3" axis="1 0 0" range="-3 3"/>
    <geom type="mesh" mesh="wedge" pos="0 0 .05"/><geom type="ellipsoid" size=".05 .03 .04"/>
 </body></body></body></body></worldbody></mujoco>"""


def test_coal_and_mujoco_agree(tmp_path: Path, rng: np.random.Generator) -> None:
    """Distances and nearest points of meshes and of all other shapes, apart and overlapping."""
    (tmp_path / "arm.xml").write_text(SHAPES)
    arm = jc.load_robot(tmp_path / "arm.xml")
    surroundings = Surroundings(floor=-0.1, spheres=(((0.4, 0.3, 0.2), 0.12),))
    mujoco, coal = (
        CollisionBodies.of(arm, dataclasses.replace(surroundings, distances=name))
        for name in ("mujoco", "coal")
    )
    np.testing.assert_array_equal(mujoco.pairs, coal.pairs)
    overlapping = 0
    for q in rng.uniform(-2.5, 2.5, (40, 3)):
        expected, _, _ = mujoco.distances(q, 2.0)
        distance, ends, _ = coal.distances(q, 2.0)
        overlapping += int(np.sum(expected < 0))
        apart = expected > 1e-6
        np.testing.assert_allclose(distance[apart], expected[apart], atol=2e-5)
        np.testing.assert_array_equal(distance < 0, expected < 0)
        gap = np.linalg.norm(ends[apart, 3:] - ends[apart, :3], axis=1)
        np.testing.assert_allclose(gap, distance[apart], atol=1e-6)
    assert overlapping > 10


def test_a_motion_is_as_clear_by_coal(arm: jc.Manipulator) -> None:
    surroundings = Surroundings(radius=RADIUS, spheres=(((0.0, 0.65, 0.0), 0.1),))
    family = BSplines(1.0, 4)
    parameters = np.zeros((family.size, 2))
    parameters[1:, 0] = np.linspace(0.3, 1.2, family.size - 1)
    least, slopes = zip(
        *(
            (bodies.clearance(family, parameters)[0], bodies.contacts(np.array([[1.3, 0.2]])))
            for bodies in (
                CollisionBodies.of(arm, dataclasses.replace(surroundings, distances=name))
                for name in ("mujoco", "coal")
            )
        ),
        strict=True,
    )
    assert least[0] == pytest.approx(least[1], abs=1e-5)
    np.testing.assert_allclose(slopes[0].jacobian[0], slopes[1].jacobian[0], atol=1e-4)


def test_other_distances_are_named() -> None:
    with pytest.raises(ValueError, match="distances: expected mujoco or coal, got 'fcl'"):
        Surroundings(distances="fcl")


def test_a_design_keeps_its_distance(arm: jc.Manipulator) -> None:
    network = jc.derive(arm, lengths="numeric")
    k = np.ones(network.size)
    limits = Limits.of(arm, {"position": [-2, 2], "velocity": 3, "torque": 50})
    surroundings = Surroundings(radius=RADIUS, boxes=(((0.0, 0.6, 0.0), (0.2, 0.2, 0.2)),))
    planner = Planner.of(
        network,
        limits,
        Noise(0.1, 1e-4),
        BSplines(2.0, 6),
        knowledge=Knowledge(k, None, np.full(network.size, np.inf)),
        surroundings=surroundings,
    )
    design = planner.design(0, 1, 3, 10, lambda _: None)
    assert design.use.feasible
    bodies = CollisionBodies.of(arm, surroundings)
    time = np.linspace(0.0, 2.0, 2001)
    q = design.family.derivative(design.parameters, time)
    assert min(bodies.distances(pose, 1.0)[0].min() for pose in q) >= 0.02
    check = DenseCheck(network, k, limits, planner.family, distance=bodies.clearance)
    assert check.use(design.parameters).feasible


@pytest.mark.parametrize(
    ("surroundings", "message"),
    [
        (Surroundings(), "has no shapes; expected 'radius'"),
        (Surroundings(radius=(0.1, 0.1, 0.1)), "radius: expected one number above 0 or 2"),
    ],
)
def test_robots_without_shapes_are_named(
    arm: jc.Manipulator, surroundings: Surroundings, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        CollisionBodies.of(arm, surroundings)

"""Distances of bodies: closed forms, slopes, bounds between samples, designs beside obstacles."""

import math

import numpy as np
import pytest

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
    design = planner.design(0, Effort(1, 3, 10))
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

"""The possible machine whose coefficients are nearest to others."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

import sim
from jaxcslc import CSLC
from jaxcslc.manipulator import LinkParameters, Manipulator, panda, puma560
from sim.machine._nearest_links import CoefficientMap, links_of, nearest_links, parameters_of
from sim.machine._thesis_machines import thesis_coefficients


# Relative increase of the distance by the regularisation towards the robot's nominal links.
REGULARISATION = 1e-3

RandomLinks = Callable[..., tuple[LinkParameters, ...]]


def spread(parameters: np.ndarray) -> np.ndarray:
    """Of each link's mass along its axes [kg m²]."""
    moments = parameters[:, 4:7]
    return moments.sum(axis=1, keepdims=True) / 2 - moments


def with_spread(parameters: np.ndarray, value: np.ndarray) -> np.ndarray:
    result = parameters.copy()
    result[:, 4:7] = value.sum(axis=1, keepdims=True) - value
    return result


def nominal(robot: Manipulator) -> np.ndarray:
    assert robot.links is not None
    return parameters_of(sim.possible_links(robot, robot.links))


def draw_like(robot: Manipulator, rng: np.random.Generator, by: float = 1.0) -> np.ndarray:
    """A machine well within what `nearest_links` allows, `by` of the way to its limits."""
    at = nominal(robot)
    drawn = with_spread(at, spread(at) * 2 ** (by * rng.uniform(-0.9, 3.0, (len(at), 3))))
    drawn[:, [0, 7]] *= 2 ** (by * rng.uniform(-0.9, 0.9, (len(at), 2)))
    drawn[:, 1:4] += by * rng.uniform(-0.09, 0.09, (len(at), 3))
    return of_kind(robot, drawn)


def of_kind(robot: Manipulator, parameters: np.ndarray) -> np.ndarray:
    """With the robot's zeros and equal moments."""
    result, at = parameters.copy(), nominal(robot)
    for i, inertia in enumerate(robot.inertia):
        for j, name in enumerate(("rx", "ry", "rz"), start=1):
            if name in inertia.zero or at[i, 0] == 0:
                result[i, j] = at[i, j]
        if inertia.equal == (("Ixx", "Iyy"),):
            result[i, 4:6] = result[i, 4:6].mean()
    return result


@pytest.fixture(scope="module")
def arm() -> Manipulator:
    """Two parallel joints in a vertical plane."""
    robot = Manipulator.from_modified_dh(
        [(-np.pi / 2, 0, 0, 0), (0, 0.4, 0, 0)], gravity=(0, 0, -9.81), inertia="principal"
    )
    links = (
        LinkParameters(3.0, np.array([0.2, 0.01, 0.0]), np.diag([0.01, 0.05, 0.05]), 0.4),
        LinkParameters(1.0, np.array([0.15, 0.0, 0.0]), np.diag([0.004, 0.02, 0.02]), 0.1),
    )
    return dataclasses.replace(robot, links=links)


def test_the_map_is_the_networks(
    puma: CSLC, random_links: RandomLinks, rng: np.random.Generator
) -> None:
    mapping = CoefficientMap.of(puma.robot)
    inertial = puma.layout.inertial
    assert mapping.names == puma.names[inertial]
    links = random_links(rng, 6, principal=True)
    np.testing.assert_allclose(
        mapping.values(parameters_of(links)), puma.coefficients_from(links)[inertial], rtol=1e-12
    )


def test_the_maps_derivative(rng: np.random.Generator) -> None:
    mapping, at = CoefficientMap.of(puma560()), rng.uniform(0.5, 1.5, (6, 8))
    direction = rng.normal(size=(6, 8))
    step = 1e-5
    slope = (mapping.values(at + step * direction) - mapping.values(at - step * direction)) / (
        2 * step
    )
    along = np.tensordot(mapping.jacobian(at), direction, axes=2)
    np.testing.assert_allclose(along, slope, rtol=1e-8, atol=1e-8)


def test_links_and_parameters_make_the_round_trip(rng: np.random.Generator) -> None:
    parameters = rng.uniform(size=(3, 8))
    np.testing.assert_array_equal(parameters_of(links_of(parameters)), parameters)


def test_armstrongs_links_stay_as_they_are() -> None:
    robot = puma560()
    k = CoefficientMap.of(robot).values(nominal(robot))
    result = nearest_links(robot, k, np.ones(31))
    np.testing.assert_allclose(parameters_of(result), nominal(robot), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(("weight", "seed"), [(1.0, 446027310), (30.0, 402240129)])
def test_coefficients_of_a_possible_machine_are_kept(weight: float, seed: int) -> None:
    robot = puma560()
    mapping = CoefficientMap.of(robot)
    k = mapping.values(draw_like(robot, np.random.default_rng(seed)))
    result = mapping.values(parameters_of(nearest_links(robot, k, np.full(31, weight))))
    start = np.linalg.norm(mapping.values(nominal(robot)) - k)
    assert np.linalg.norm(result - k) < 1e-4 * start


@pytest.mark.parametrize("name", ["A", "B"])
def test_no_possible_machine_is_nearer(name: str, rng: np.random.Generator) -> None:
    """Neither near the result nor elsewhere."""
    robot, thesis = puma560(), thesis_coefficients(name)
    mapping = CoefficientMap.of(robot)
    k, w = thesis.coefficients[:31], thesis.sensitivity[:31]

    def distance(parameters: np.ndarray) -> float:
        return float(np.linalg.norm(w * (mapping.values(parameters) - k)))

    at = nominal(robot)
    best = parameters_of(nearest_links(robot, k, w))
    for _ in range(500):
        anywhere = draw_like(robot, rng)
        assert distance(anywhere) > distance(best)
        # The constraints are bounds on these variables, so the set of machines is convex in them.
        part = 10.0 ** rng.uniform(-4, 0)
        beside = with_spread(best, spread(best) + part * (spread(anywhere) - spread(best)))
        others = [0, 1, 2, 3, 7]
        beside[:, others] += part * (anywhere - best)[:, others]
        assert distance(beside) > (1 - REGULARISATION) * distance(best)
    assert distance(best) < distance(at)


def test_another_optimiser_finds_the_same(arm: Manipulator, rng: np.random.Generator) -> None:
    """SLSQP over the parameters themselves, from many starts, against impossible coefficients."""
    mapping, at = CoefficientMap.of(arm), nominal(arm)
    k = mapping.values(at) * [0.3, 2.0, -1.0, 1.5, 0.6, 3.0, 2.0, 1.1, 0.9][: len(mapping.names)]
    w = rng.uniform(0.5, 2.0, len(k))
    best = parameters_of(nearest_links(arm, k, w))
    distance = float(np.sum((w * (mapping.values(best) - k)) ** 2))
    assert distance > 0.01

    def unpack(z: np.ndarray) -> np.ndarray:
        return with_spread(z.reshape(2, 8), z.reshape(2, 8)[:, 4:7])

    nominal_spread = spread(at)
    low, high = with_spread(at, nominal_spread), with_spread(at, nominal_spread)
    low[:, [0, 7]], high[:, [0, 7]] = at[:, [0, 7]] / 2, at[:, [0, 7]] * 2
    low[:, 1:4], high[:, 1:4] = at[:, 1:4] - 0.1, at[:, 1:4] + 0.1
    low[:, 4:7], high[:, 4:7] = nominal_spread / 2, nominal_spread + 10
    result = [
        minimize(
            lambda z: np.sum((w * (mapping.values(unpack(z)) - k)) ** 2),
            rng.uniform(low, np.minimum(high, low + 1)).ravel(),
            method="SLSQP",
            bounds=list(zip(low.ravel(), high.ravel(), strict=True)),
            options={"maxiter": 500, "ftol": 1e-14},
        ).fun
        for _ in range(10)
    ]
    assert distance == pytest.approx(min(result), rel=2 * REGULARISATION)


def test_the_result_is_of_the_robots_kind_and_like_it(rng: np.random.Generator) -> None:
    robot = puma560()
    at, mapping = nominal(robot), CoefficientMap.of(robot)
    k = mapping.values(at) * rng.uniform(-3, 3, 31)
    links = nearest_links(robot, k, np.ones(31), least=0.4, shift=0.05)
    result = parameters_of(links)
    slack = 1e-12
    np.testing.assert_array_equal(of_kind(robot, result), result)
    assert (result[:, [0, 7]] >= 0.4 * at[:, [0, 7]] - slack).all()
    assert (result[:, [0, 7]] <= at[:, [0, 7]] / 0.4 + slack).all()
    assert (np.abs(result - at)[:, 1:4] <= 0.05 + slack).all()
    assert (spread(result) >= 0.4 * spread(at) - slack).all()
    assert all(a is b for a, b in zip(sim.possible_links(robot, links), links, strict=True))


def test_a_moment_that_vanishes_by_construction_stays_away() -> None:
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia="principal")
    (inertia,) = robot.inertia
    rod = LinkParameters(1.0, np.array([0.2, 0, 0]), np.diag([0.0, 0.01, 0.01]), 0.1)
    thin = dataclasses.replace(
        robot, inertia=(dataclasses.replace(inertia, zero=("Ixx", "ry", "rz")),), links=(rod,)
    )
    (link,) = nearest_links(thin, np.array([5.0]), np.array([1.0]))
    np.testing.assert_allclose(np.diag(link.inertia)[0], 0.0, atol=1e-15)
    assert link.inertia[2, 2] > 4.0


def test_the_same_again() -> None:
    robot, thesis = puma560(), thesis_coefficients("A")
    first, second = (
        parameters_of(nearest_links(robot, thesis.coefficients[:31], thesis.sensitivity[:31]))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_what_is_refused() -> None:
    robot, ones = puma560(), np.ones(31)
    with pytest.raises(sim.MachineError, match=r"has no link parameters; expected nominal values"):
        nearest_links(dataclasses.replace(robot, links=None), ones, ones)
    full = (LinkParameters(1.0, np.zeros(3), np.eye(3)),) * 7
    with pytest.raises(sim.MachineError, match=r"link 1 has a full inertia tensor"):
        nearest_links(dataclasses.replace(panda(), links=full), ones, ones)
    with pytest.raises(sim.MachineError, match=r"coefficients has 30 values; expected 31, kM1 to"):
        nearest_links(robot, ones[1:], ones)
    with pytest.raises(sim.MachineError, match=r"weight has 43 values; expected 31"):
        nearest_links(robot, ones, np.ones(43))
    with pytest.raises(sim.MachineError, match=r"coefficients: kM2 is nan; expected a finite"):
        nearest_links(robot, np.where(np.arange(31) == 1, np.nan, ones), ones)
    with pytest.raises(sim.MachineError, match=r"weight of kG5 is -1.0; expected zero or more"):
        nearest_links(robot, ones, np.where(np.arange(31) == 30, -1.0, ones))
    for least in (0.0, 1.5, float("nan")):
        with pytest.raises(sim.MachineError, match=r"least is .*; expected more than 0"):
            nearest_links(robot, ones, ones, least=least)
    with pytest.raises(sim.MachineError, match=r"shift is -1.0 m; expected zero or more"):
        nearest_links(robot, ones, ones, shift=-1.0)

"""Links that no rigid body can be: made into ones that can, with the same dynamics."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.manipulator import LinkParameters, Manipulator, puma560


def spread(link: LinkParameters) -> np.ndarray:
    inertia = np.asarray(link.inertia)
    return np.trace(inertia) / 2 * np.eye(3) - inertia


def chain(rng: np.random.Generator, kinds: str) -> Manipulator:
    """A chain of random twists whose tensors were 'measured' with too large an error."""
    n = len(kinds)
    rows = rng.uniform(-1.0, 1.0, (n, 4)) * [np.pi, 1.0, 1.0, np.pi]
    robot = Manipulator.from_modified_dh(
        rows.tolist(), kinds=kinds, gravity=rng.normal(size=3).tolist()
    )
    links: list[LinkParameters] = []
    for _ in range(n):
        across = rng.normal(size=(3, 3))
        mass_spread = across @ across.T + 5.0 * np.eye(3)
        mass_spread[2, 2] -= rng.uniform(5.0, 10.0)  # negative along z
        inertia = np.trace(mass_spread) * np.eye(3) - mass_spread
        links.append(LinkParameters(rng.uniform(1, 2), rng.normal(size=3), inertia, 0.1))
    return dataclasses.replace(robot, links=tuple(links))


def test_possible_links_are_bodies():
    robot = puma560()
    assert robot.links is not None
    assert np.linalg.eigvalsh(spread(robot.links[2]))[0] < -1e-3  # Armstrong's link 3
    for link in sim.possible_links(robot, robot.links):
        assert np.linalg.eigvalsh(spread(link))[0] >= 0


def test_possible_links_of_the_puma_keep_its_torques(
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]], rng: np.random.Generator
):
    robot = puma560()
    assert robot.links is not None
    motion = rng.normal(size=(3, 50, 6)) * [[[3.0]], [[5.0]], [[20.0]]]
    changed = sim.possible_links(robot, robot.links)
    np.testing.assert_allclose(
        inverse_dynamics(robot, changed)(*motion), inverse_dynamics(robot)(*motion), atol=1e-11
    )


@pytest.mark.parametrize("kinds", ["R", "P", "RR", "RPR", "PRRP", "RRRRRR"])
def test_possible_links_keep_any_chains_torques(
    kinds: str, inverse_dynamics: Callable[..., Callable[..., np.ndarray]], rng: np.random.Generator
):
    robot = chain(rng, kinds)
    assert robot.links is not None
    changed = sim.possible_links(robot, robot.links)
    assert min(float(np.linalg.eigvalsh(spread(link))[0]) for link in changed) >= 0
    motion = rng.normal(size=(3, 20, len(kinds)))
    expected = inverse_dynamics(robot)(*motion)
    np.testing.assert_allclose(
        inverse_dynamics(robot, changed)(*motion), expected, atol=1e-12 * np.abs(expected).max()
    )


def test_bodies_stay_as_they_are():
    robot = puma560()
    assert robot.links is not None
    once = sim.possible_links(robot, robot.links)
    twice = sim.possible_links(robot, once)
    assert all(a is b for a, b in zip(once, twice, strict=True))
    assert all(once[i] is robot.links[i] for i in (3, 4, 5))


def test_a_link_without_any_mass_is_no_trouble():
    robot = jc.examples.turntable()
    link = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)), 1.0)
    assert sim.possible_links(robot, [link]) == (link,)


def test_what_cannot_be_lent_is_refused():
    robot = jc.examples.turntable()
    wrong = LinkParameters(1.0, np.zeros(3), np.diag([5.0, 1.0, 1.0]), 0.0)
    with pytest.raises(sim.MachineError, match=r"link 1 cannot be a rigid body: .* across"):
        sim.possible_links(robot, [wrong])
    negative = LinkParameters(-1.0, np.zeros(3), np.eye(3), 0.0)
    with pytest.raises(sim.MachineError, match=r"link 1 has a mass of -1"):
        sim.possible_links(robot, [negative])

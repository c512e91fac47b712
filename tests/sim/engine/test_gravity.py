"""Gravity's largest torque against MuJoCo's, in the same postures."""

import mujoco
import numpy as np
import pytest

import sim
from sim.engine._models import largest_gravity
from tests.sim.engine.test_mjcf import RELATIVE, mujoco_torque, random_chain


@pytest.mark.parametrize("kinds", ["R", "P", "RPR", "RRPRRR"])
def test_the_largest_torque_is_mujocos(kinds: str, rng: np.random.Generator):
    """Of 256 draws within the ranges, by the generator of seed 0; a joint without a range turns
    half a turn either way."""
    robot = random_chain(rng, kinds)
    assert robot.links is not None
    ranges = tuple((-float(x), 1.0) for x in rng.uniform(size=len(kinds) - 1))
    ranges += ((-np.inf, np.inf),)
    low, high = np.array([*ranges[:-1], (-np.pi, np.pi)]).T
    postures = low + np.random.default_rng(0).uniform(size=(256, len(kinds))) * (high - low)
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    still = np.zeros(postures.shape)
    expected = np.max(np.abs(mujoco_torque(model, postures, still, still)), axis=0)
    np.testing.assert_allclose(
        largest_gravity(robot, robot.links, ranges), expected, atol=RELATIVE * expected.max()
    )

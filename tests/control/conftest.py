"""A small arm for what any network shows as well as the PUMA 560's, which takes long to compile."""

from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxcslc as jc


class SmallArm(NamedTuple):
    network: jc.CSLC
    k: jax.Array


@pytest.fixture(scope="session")
def small_arm() -> SmallArm:
    """Two revolute joints, the second across the first, with friction."""
    arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", 0.3, 0, 0)])
    network = jc.derive(arm.with_friction("viscous", "dry"), lengths="numeric")
    links = [jc.LinkParameters(1.0, np.array([0.2, 0.0, 0.1]), 0.01 * np.eye(3), 0.5)] * 2
    k = network.coefficients_from(links, viscous=[0.5, 0.4], dry=[1.0, 0.8])
    return SmallArm(network, k)

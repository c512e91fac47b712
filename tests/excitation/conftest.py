from typing import TYPE_CHECKING

import numpy as np
import pytest


if TYPE_CHECKING:
    from jaxcslc.excitation import Design, Planner


@pytest.fixture(scope="session")
def pendulum_planner() -> "Planner":
    """Of a pendulum with friction: quick to compile."""
    from jaxcslc.excitation import BSplines, Knowledge, Limits, Noise, Planner
    from tests import arms

    network = arms.pendulum()
    knowledge = Knowledge(np.array([0.5, 2.0, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    stated = {"position": [-2, 2], "velocity": 3, "torque": 30, "torque_margin": 0.0}
    limits = Limits.of(network.robot, stated)
    return Planner.of(network, limits, Noise(0.1, 1e-4), BSplines(3.0, 8), knowledge=knowledge)


@pytest.fixture(scope="session")
def pendulum_design(pendulum_planner: "Planner") -> "Design":
    from jaxcslc.excitation import Effort

    return pendulum_planner.design(Effort(1, 3, 15))

from typing import TYPE_CHECKING

import numpy as np
import pytest


if TYPE_CHECKING:
    from jaxcslc.excitation import Design, Planner


@pytest.fixture(scope="session")
def pendulum_planner() -> "Planner":
    """Of a pendulum with friction: quick to compile."""
    import jaxcslc as jc
    from jaxcslc.excitation import BSplines, Knowledge, Limits, Noise, Planner

    arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(arm, lengths="numeric")
    knowledge = Knowledge(np.array([0.5, 2.0, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    limits = Limits.of(
        arm, {"position": [-2, 2], "velocity": 3, "torque": 30, "torque_margin": 0.0}
    )
    return Planner.of(network, limits, Noise(0.1, 1e-4), BSplines(3.0, 8), knowledge=knowledge)


@pytest.fixture(scope="session")
def pendulum_design(pendulum_planner: "Planner") -> "Design":
    return pendulum_planner.design(0, 1, 3, 15, lambda _: None)

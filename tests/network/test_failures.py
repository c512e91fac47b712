"""Arguments that do not fit: refused when a function is traced, in one line."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc
from jaxcslc import CSLC, Manipulator, RobotError
from jaxcslc.network import RigidBodyRecursion


@pytest.fixture(scope="module")
def network() -> CSLC:
    return jaxcslc.derive(jaxcslc.puma560())


def test_wrong_number_of_joints(network: CSLC) -> None:
    q = jnp.zeros((4, 7))
    message = r"expected arrays of shape \(\.\.\., 6\) for 'PUMA 560', got \(4, 7\)"
    with pytest.raises(ValueError, match=message):
        network.torque(np.zeros(43), q, q, q)
    with pytest.raises(ValueError, match=message):
        network.regressor(q, q, q)
    with pytest.raises(ValueError, match=message):
        jax.jit(network.gravity_term)(jnp.zeros(43), q)


def test_wrong_number_of_coefficients(network: CSLC) -> None:
    q = np.zeros((4, 6))
    for k in (np.zeros(31), np.zeros(44)):
        with pytest.raises(ValueError, match=rf"k: expected shape \(43,\), got \({len(k)},\)"):
            network.torque(k, q, q, q)
        with pytest.raises(ValueError, match=r"k: expected shape \(43,\)"):
            network.friction_term(k, q)


def test_wrong_number_of_links(network: CSLC) -> None:
    links = network.robot.links
    assert links is not None
    with pytest.raises(ValueError, match="links: expected 6 entries, one a joint, got 5"):
        network.coefficients_from(links[:5])


def test_friction_that_does_not_fit(network: CSLC) -> None:
    links = network.robot.links
    assert links is not None
    with pytest.raises(ValueError, match=r"dry: expected 6 values, one a joint, got \(5,\)"):
        network.coefficients_from(links, dry=(1.0,) * 5)
    with pytest.raises(
        ValueError, match="offset: the network has no such friction term; it has viscous, dry"
    ):
        network.coefficients_from(links, offset=(1.0,) * 6)
    bare = jaxcslc.derive(network.robot.with_friction())
    with pytest.raises(ValueError, match="dry: the network has no such friction term; it has none"):
        bare.coefficients_from(links, dry=(1.0,) * 6)


def test_recursion_with_symbolic_lengths() -> None:
    with pytest.raises(ValueError, match="recursive evaluator needs numeric lengths"):
        jaxcslc.derive(jaxcslc.puma560(), evaluator="recursive")
    with pytest.raises(ValueError, match="recursive evaluator needs numeric lengths"):
        RigidBodyRecursion.from_algebra(jaxcslc.derive(jaxcslc.puma560()).algebra)


def test_lengths_without_values() -> None:
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", "reach", 0, 0)], name="arm")
    assert jaxcslc.derive(robot).size > 0
    with pytest.raises(RobotError, match="robot 'arm': length 'reach' has no value"):
        jaxcslc.derive(robot, lengths="numeric")


def test_a_link_parameter_that_is_missing_has_no_coefficients() -> None:
    """A value for a length is needed to evaluate coefficients, not to derive them."""
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", "reach", 0, 0)], name="arm")
    links: Any = [jaxcslc.LinkParameters(1.0, np.zeros(3), np.eye(3))] * 2
    with pytest.raises(RobotError, match="robot 'arm': length 'reach' has no value"):
        jaxcslc.derive(robot).coefficients_from(links)


def test_a_robot_of_which_nothing_moves_the_joint() -> None:
    """No inertial terms at all: no coefficients, and no torque."""
    nothing = jaxcslc.LinkInertia(
        zero=("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"), motor=False
    )
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia=nothing, friction=("viscous",))
    for evaluator in ("tables", "recursive"):
        network = jaxcslc.derive(robot, lengths="numeric", evaluator=evaluator)
        assert network.names == ("kv1",)
        qd = np.array([[0.5], [-1.0]])
        torque = network.torque(np.array([2.0]), 0 * qd, qd, 0 * qd)
        assert np.array_equal(torque, 2.0 * qd)


@pytest.mark.parametrize("evaluator", ["tables", "recursive"])
def test_a_regressor_of_friction_alone(evaluator: Any) -> None:
    nothing = jaxcslc.LinkInertia(
        zero=("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"), motor=False
    )
    robot = Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia=nothing, friction=("viscous",))
    network = jaxcslc.derive(robot, lengths="numeric", evaluator=evaluator)
    qd = np.array([[0.5], [-1.0]])
    assert np.array_equal(network.regressor(0 * qd, qd, 0 * qd), qd[..., None])


def test_more_joints_than_can_be_derived() -> None:
    robot = Manipulator.from_modified_dh([(0, 0.1, 0, 0)] * 41)
    with pytest.raises(RobotError, match="has 41 joints; expected at most 40"):
        jaxcslc.derive(robot, lengths="numeric")

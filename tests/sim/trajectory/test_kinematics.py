"""The hand's position and Jacobian, against MuJoCo's."""

import dataclasses

import jax
import mujoco
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator, RobotError, puma560
from sim.trajectory._kinematics import Hand


_POINT = (0.1, -0.2, 0.3)
_ROD = LinkParameters(1.0, np.zeros(3), np.eye(3))


def _scara() -> Manipulator:
    """Revolute and prismatic joints, every kind of offset and no right angles."""
    rows = [(0.3, 0.1, 0.2, 0.4), (-1.0, 0.5, -0.1, 0.2), (2.0, 0.3, 0.2, 1.0), (0.5, 0.1, 0.3, 0)]
    robot = Manipulator.from_modified_dh(rows, kinds="RPRP")
    return dataclasses.replace(robot, links=(_ROD,) * 4)


@pytest.mark.parametrize("robot", [puma560(), _scara()], ids=["puma560", "mixed"])
def test_position_and_jacobian_are_mujocos(robot: Manipulator, rng: np.random.Generator):
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    data = mujoco.MjData(model)
    q = rng.normal(size=(20, robot.joint_count))
    points, jacobians = Hand.of(robot, _POINT).locate(q)
    for row, point, jacobian in zip(q, points, jacobians, strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        last = data.body(f"link_{robot.joint_count}")
        expected = last.xpos + last.xmat.reshape(3, 3) @ _POINT
        by_mujoco = np.zeros((3, robot.joint_count))
        mujoco.mj_jac(model, data, by_mujoco, None, expected, last.id)
        np.testing.assert_allclose(point, expected, atol=1e-14)
        np.testing.assert_allclose(jacobian, by_mujoco, atol=1e-14)


def test_jacobian_is_the_derivative(rng: np.random.Generator):
    hand = Hand.of(_scara(), _POINT)
    q = rng.normal(size=4)
    _, jacobian = hand.locate(q)
    np.testing.assert_allclose(
        jax.jit(jax.jacobian(lambda q: hand.locate(q)[0]))(q), jacobian, atol=1e-14
    )


@pytest.mark.parametrize("batch", [(), (1,), (3, 1, 2)])
def test_a_batch_is_its_rows(batch: tuple[int, ...], rng: np.random.Generator):
    hand = Hand.of(puma560(), _POINT)
    q = rng.normal(size=(*batch, 6))
    point, jacobian = hand.locate(q)
    for index in np.ndindex(*batch):
        one = hand.locate(q[index])
        np.testing.assert_allclose(point[index], one[0], atol=1e-15)
        np.testing.assert_allclose(jacobian[index], one[1], atol=1e-15)


def test_a_length_without_a_value_is_named():
    robot = Manipulator.from_modified_dh([(0.0, "a0", 0.0, 0.0)])
    with pytest.raises(RobotError, match="a0"):
        Hand.of(robot)

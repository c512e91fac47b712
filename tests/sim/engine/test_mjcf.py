"""The MuJoCo model against the numbers it was made from and against Pinocchio."""

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters, Manipulator, RobotError, puma560


# Two recursive algorithms in float64: rounding of a few operations a joint.
RELATIVE = 1e-12


def random_chain(rng: np.random.Generator, kinds: str) -> Manipulator:
    n = len(kinds)
    rows = rng.uniform(-1.0, 1.0, (n, 4)) * [np.pi, 1.0, 1.0, np.pi]
    links: list[LinkParameters] = []
    for _ in range(n):
        points = rng.normal(size=(5, 3))  # a body of five unit masses
        points -= points.mean(axis=0)
        spread = points.T @ points
        inertia = np.trace(spread) * np.eye(3) - spread
        links.append(LinkParameters(5.0, rng.normal(size=3), inertia, rng.uniform(0, 2)))
    robot = Manipulator.from_modified_dh(
        rows.tolist(), kinds=kinds, gravity=rng.normal(size=3).tolist()
    )
    return dataclasses.replace(robot, links=tuple(links))


def mujoco_torque(
    model: mujoco.MjModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> np.ndarray:
    data = mujoco.MjData(model)
    torque = np.empty(q.shape)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], qd[row], qdd[row]
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse
    return torque


@pytest.mark.parametrize("kinds", ["R", "P", "RR", "RPR", "PPR", "RRPRRR", "RRRRRRR"])
def test_torques_of_any_chain_are_pinocchios(
    kinds: str, inverse_dynamics: Callable[..., Callable[..., np.ndarray]], rng: np.random.Generator
):
    robot = random_chain(rng, kinds)
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    motion = rng.normal(size=(3, 30, len(kinds)))
    expected = inverse_dynamics(robot)(*motion)
    np.testing.assert_allclose(
        mujoco_torque(model, *motion), expected, atol=RELATIVE * np.abs(expected).max()
    )


def test_torques_of_the_puma_are_pinocchios(
    inverse_dynamics: Callable[..., Callable[..., np.ndarray]], rng: np.random.Generator
):
    robot = puma560()
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    motion = rng.normal(size=(3, 100, 6)) * [[[3.0]], [[5.0]], [[20.0]]]
    expected = inverse_dynamics(robot)(*motion)  # with Armstrong's own link 3
    np.testing.assert_allclose(
        mujoco_torque(model, *motion), expected, atol=RELATIVE * np.abs(expected).max()
    )


def test_bodies_have_the_link_parameters(rng: np.random.Generator):
    robot = random_chain(rng, "RPR")
    assert robot.links is not None
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    for i, link in enumerate(robot.links):
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[i + 1])
        axes = axes.reshape(3, 3)
        np.testing.assert_allclose(
            axes @ np.diag(model.body_inertia[i + 1]) @ axes.T, link.inertia, atol=1e-13
        )
        assert model.body_mass[i + 1] == link.mass
        np.testing.assert_array_equal(model.body_ipos[i + 1], link.centre_of_gravity)
        assert model.dof_armature[i] == link.motor_inertia


def test_frames_are_products_of_eqn_2_6_1(rng: np.random.Generator):
    robot = random_chain(rng, "RPRP")
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot))
    data = mujoco.MjData(model)
    q = rng.normal(size=4)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    frame = np.eye(4)
    for i, joint in enumerate(robot.joints):
        theta = joint.theta + (q[i] if joint.kind == "R" else 0.0)
        d = float(joint.d.value or 0.0) + (q[i] if joint.kind == "P" else 0.0)
        ca, sa, ct, st = np.cos(joint.alpha), np.sin(joint.alpha), np.cos(theta), np.sin(theta)
        frame = frame @ np.array(
            [
                [ct, -st, 0, joint.a.value],
                [st * ca, ct * ca, -sa, -sa * d],
                [st * sa, ct * sa, ca, ca * d],
                [0, 0, 0, 1],
            ]
        )
        np.testing.assert_allclose(data.xpos[i + 1], frame[:3, 3], atol=1e-14)
        np.testing.assert_allclose(data.xmat[i + 1].reshape(3, 3), frame[:3, :3], atol=1e-14)


def test_a_lamina_and_a_rod_are_bodies():
    robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0), (0.3, 0.5, 0.0, 0.0)])
    turn = np.linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0]
    lamina = turn @ np.diag([0.1, 0.2, 0.1 + 0.2]) @ turn.T
    rod = np.diag([0.0, 1 / 3, 1 / 3])
    links = [
        LinkParameters(1.0, np.zeros(3), (tensor + tensor.T) / 2, 0.0) for tensor in (lamina, rod)
    ]
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot, links))
    np.testing.assert_allclose(np.sort(model.body_inertia[1]), [0.1, 0.2, 0.3], rtol=1e-12)
    np.testing.assert_allclose(np.sort(model.body_inertia[2]), [0, 1 / 3, 1 / 3], atol=1e-12)


def test_a_name_may_have_any_characters():
    robot = dataclasses.replace(puma560(), name='R&D\'s "arm" <2>')
    assert mujoco.MjModel.from_xml_string(sim.mjcf(robot)).nv == 6


def test_failures_say_what_is_missing():
    robot = Manipulator.from_modified_dh([(0.0, "a0", 0.0, 0.0)], name="stick")
    with pytest.raises(sim.MachineError, match="robot 'stick': expected 1 link parameters, got no"):
        sim.mjcf(robot)
    link = LinkParameters(1.0, np.zeros(3), np.eye(3), 0.0)
    with pytest.raises(sim.MachineError, match="expected 1 link parameters, got 2"):
        sim.mjcf(robot, [link, link])
    with pytest.raises(RobotError, match="length 'a0' has no value"):
        sim.mjcf(robot, [link])
    with pytest.raises(sim.MachineError, match="breakaway has 2 values; expected 6"):
        sim.mjcf(puma560(), breakaway=[1.0, 1.0])

"""Friction that grows with the load, kl sign(qd) |rigid torque|: the rigid torque is MuJoCo's."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
import sim
from jaxcslc.training import inverse_dynamics


ROBOT = jc.puma560().with_friction("viscous", "dry", "load")
KL = np.array([0.1, 0.2, 0.05, 0.3, 0.0, 0.15])
SAMPLES = 16
# Both sides round at 1e-15 per operation; torques are up to a hundred N m.
AGREEMENT = 1e-10


Arm = tuple[jc.CSLC, np.ndarray]
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def network_of(robot: jc.Manipulator, **friction: Any) -> Arm:
    network = jc.derive(robot, lengths="numeric")
    assert ROBOT.links is not None
    k = network.coefficients_from(ROBOT.links, load=KL, **friction)
    return network.with_load(k), np.asarray(k)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return network_of(ROBOT, viscous=np.array(ROBOT.viscous), dry=np.array(ROBOT.dry))


@pytest.fixture(scope="module")
def motion() -> Motion:
    q, qd, qdd = np.random.default_rng(0).uniform(-1.0, 1.0, (3, SAMPLES, 6))
    qd[0] = 0.0
    return q, qd, qdd


def test_torque_is_the_formula_on_mujocos_rigid_torque(arm: Arm, motion: Motion) -> None:
    network, k = arm
    model = mujoco.MjModel.from_xml_string(sim.mjcf(ROBOT))
    data = mujoco.MjData(model)
    rigid = np.empty((SAMPLES, 6))
    for row, state in zip(rigid, zip(*motion, strict=True), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        row[:] = data.qfrc_inverse
    qd = motion[1]
    friction = ROBOT.viscous * qd + np.sign(qd) * (ROBOT.dry + KL * np.abs(rigid))
    assert_allclose(network.torque(k, *motion), rigid + friction, atol=1e-7)


@pytest.fixture(scope="module")
def directional() -> Arm:
    """Joints 1 to 5 with a coefficient for each direction of power, joint 6 with one for both."""
    robot = ROBOT
    for joint in range(1, 6):
        robot = robot.with_friction("viscous", "dry", "directional_load", joint=joint)
    network = jc.derive(robot, lengths="numeric")
    assert ROBOT.links is not None
    last = np.arange(6) == 5
    by_direction = np.where(last[:, None], 0.0, np.stack([1.5 * KL, 0.4 * KL], axis=1))
    k = network.coefficients_from(
        ROBOT.links,
        load=np.where(last, KL, 0.0),
        directional_load=by_direction,
        viscous=np.array(ROBOT.viscous),
        dry=np.array(ROBOT.dry),
    )
    return network.with_load(k), np.asarray(k)


def test_directions_of_power_have_their_coefficients(
    arm: Arm, directional: Arm, motion: Motion
) -> None:
    """On the rigid torque that is left when friction is taken off."""
    q, qd, qdd = motion
    network, k = directional
    rigid = np.asarray(arm[0].torque(arm[0].without_friction(arm[1]), *motion))
    factor = np.where(qd * rigid > 0.0, 1.5 * KL, 0.4 * KL)
    factor[:, 5] = KL[5]
    friction = ROBOT.viscous * qd + np.sign(qd) * (ROBOT.dry + factor * np.abs(rigid))
    torque = network.torque(k, *motion)
    assert_allclose(torque, rigid + friction, atol=AGREEMENT)
    assert_allclose(network.regressor(*motion) @ k, torque, atol=AGREEMENT)
    columns = network.columns(*(x.T for x in motion))
    by_joint = [k[list(s)] @ rows for s, rows in zip(network.support, columns, strict=True)]
    assert_allclose(np.stack(by_joint, axis=1), torque, atol=AGREEMENT)
    assert_allclose(network.forward_dynamics(k, q, qd, torque), qdd, atol=AGREEMENT)
    with pytest.raises(jc.RobotError, match="load and directional_load exclude"):
        ROBOT.with_friction("load", "directional_load")


def test_regressor_and_columns_agree_with_torque(arm: Arm, motion: Motion) -> None:
    network, k = arm
    torque = np.asarray(network.torque(k, *motion))
    assert_allclose(network.regressor(*motion) @ k, torque, atol=AGREEMENT)
    columns = network.columns(*(x.T for x in motion))
    assert isinstance(columns[0], np.ndarray)  # nothing is compiled
    by_joint = [k[list(s)] @ rows for s, rows in zip(network.support, columns, strict=True)]
    assert_allclose(np.stack(by_joint, axis=1), torque, atol=AGREEMENT)


def test_the_adaptive_network_agrees(arm: Arm, motion: Motion) -> None:
    network, k = arm
    outputs = inverse_dynamics(network).outputs(jnp.asarray(k), tuple(map(jnp.asarray, motion)))
    assert_allclose(outputs, network.torque(k, *motion), atol=AGREEMENT)


def test_forward_dynamics_inverts_torque(arm: Arm, motion: Motion) -> None:
    network, k = arm
    q, qd, qdd = motion
    torque = network.torque(k, *motion)
    assert_allclose(network.forward_dynamics(k, q, qd, torque), qdd, atol=AGREEMENT)


def test_forward_dynamics_where_the_load_is_of_other_coefficients(arm: Arm, motion: Motion) -> None:
    """With a shared shaft, and bodies a quarter heavier than those that friction follows."""
    network, k = network_of(ROBOT.with_coupling((5, 6)), coupled=np.array([[0.05, 0.1, 0.2]]))
    k = np.where(np.arange(k.size) < network.layout.inertial.stop, 1.25 * k, k)
    q, qd, qdd = motion
    torque = network.torque(k, *motion)
    assert_allclose(network.forward_dynamics(k, q, qd, torque), qdd, atol=AGREEMENT)


def test_derivatives(arm: Arm, motion: Motion) -> None:
    """Of accelerations by torques: the inverse of the derivative of torques by accelerations."""
    network, k = arm
    q, qd, qdd = (x[1] for x in motion)
    tau = network.torque(k, q, qd, qdd)
    mass = jax.jacobian(lambda qdd: network.torque(k, q, qd, qdd))(jnp.asarray(qdd))
    inverse = jax.jacrev(lambda tau: network.forward_dynamics(k, q, qd, tau))(tau)
    assert_allclose(inverse @ mass, np.eye(6), atol=AGREEMENT)


def test_it_is_friction_but_no_part_of_what_velocities_alone_say(arm: Arm, motion: Motion) -> None:
    network, k = arm
    load = network.layout.indices("load")
    assert np.isin(load, network.layout.friction).all()
    assert not np.asarray(network.without_friction(k))[load].any()
    qd = motion[1]
    expected = ROBOT.viscous * qd + ROBOT.dry * np.sign(qd)
    assert_allclose(network.friction_term(k, qd), expected, atol=AGREEMENT)


class TestWhatItCannotDo:
    def test_torque_before_the_load_is_known(self) -> None:
        network = jc.derive(ROBOT, lengths="numeric")
        still = np.zeros(6)
        with pytest.raises(ValueError, match="rigid torque is not known before a fit"):
            network.torque(np.zeros(network.size), still, still, still)

    def test_a_payload(self, arm: Arm) -> None:
        with pytest.raises(ValueError, match="friction of kind 'load' does not know it"):
            arm[0].with_payload()

    def test_load_without_the_term(self) -> None:
        network = jc.derive(jc.puma560())
        with pytest.raises(ValueError, match="has no friction of kind 'load'"):
            network.with_load(np.zeros(network.size))
        assert network.without_load() is network

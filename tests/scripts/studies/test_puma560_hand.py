"""Torque errors at the hand, against MuJoCo's forward dynamics."""

import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters, Manipulator, link_poses
from scripts.studies.puma560.hand import hand_effects, hand_errors


ROWS = [(0.0, 0.0, 0.2, 0.0), (0.7, 0.3, 0.1, 0.0), (-1.1, 0.2, 0.15, 0.0), (0.4, 0.1, 0.0, 0.0)]
KINDS = "RPRR"
POINT = (0.05, -0.1, 0.2)
DOWN = (0.0, 0.0, -9.81)
SAMPLES = 20


@pytest.fixture
def links(random_links: object, rng: np.random.Generator) -> tuple[LinkParameters, ...]:
    return random_links(rng, 4)  # type: ignore[operator]


@pytest.fixture
def network() -> jc.CSLC:
    robot = Manipulator.from_modified_dh(ROWS, kinds=KINDS, gravity=DOWN, friction=())
    return jc.derive(robot, lengths="numeric")


def mujoco_arm(links: tuple[LinkParameters, ...]) -> mujoco.MjModel:
    """Nested bodies at Craig's frames, with a sensor of the hand's acceleration."""

    def text(values: object) -> str:
        return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values, float)))

    body = f'<site name="hand" pos="{text(POINT)}"/>'
    for (alpha, a, d, _), kind, link in reversed(list(zip(ROWS, KINDS, links, strict=True))):
        position = (a, -math.sin(alpha) * d, math.cos(alpha) * d)
        turn = (math.cos(alpha / 2), math.sin(alpha / 2), 0.0, 0.0)
        tensor = np.asarray(link.inertia)
        entries = [tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        body = (
            f'<body pos="{text(position)}" quat="{text(turn)}">'
            f'<inertial pos="{text(link.centre_of_gravity)}" mass="{text(link.mass)}"'
            f' fullinertia="{text(entries)}"/>'
            f'<joint type="{"hinge" if kind == "R" else "slide"}" axis="0 0 1"'
            f' armature="{text(link.motor_inertia)}"/>{body}</body>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="{text(DOWN)}"/><worldbody>{body}</worldbody>'
        '<sensor><framelinacc objtype="site" objname="hand"/></sensor></mujoco>'
    )


def test_difference_of_accelerations_in_mujoco(
    network: jc.CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> None:
    """Of the same motion under torques and under torques with errors."""
    model = mujoco_arm(links)
    data = mujoco.MjData(model)
    q, qd, torque, error = rng.normal(size=(4, SAMPLES, 4))

    def acceleration(i: int, applied: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[i], qd[i], applied
        mujoco.mj_forward(model, data)
        return data.sensordata.copy()

    expected = [
        acceleration(i, torque[i] + error[i]) - acceleration(i, torque[i]) for i in range(SAMPLES)
    ]
    effects = hand_effects(network, network.coefficients_from(links), q, point=POINT)
    assert_allclose(jnp.einsum("sij,sj->si", effects, error), expected, rtol=1e-8, atol=1e-9)


def test_jacobian_is_the_derivative_of_the_hand(
    network: jc.CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> None:
    """J M⁻¹ M is J: of a link within the chain, too, which later joints do not move."""
    k, q = network.coefficients_from(links), jnp.asarray(rng.normal(size=4))
    for link in (1, 2, 4):
        point = jnp.array(POINT)

        def hand(q: jax.Array, link: int = link, point: jax.Array = point) -> jax.Array:
            pose = jnp.asarray(link_poses(network.robot, q))[link - 1]
            return pose[:3, :3] @ point + pose[:3, 3]

        jacobian = hand_effects(network, k, q, point=POINT, link=link) @ network.mass_matrix(k, q)
        assert_allclose(jacobian, jax.jacfwd(hand)(q), atol=1e-12)
        assert np.all(np.asarray(jacobian)[:, link:] == 0) or np.max(jacobian[:, link:]) < 1e-12


def test_a_branch_that_does_not_carry_the_hand(rng: np.random.Generator) -> None:
    rows = [(0, 0, 0, 0), ("pi/2", 0.3, 0, 0), ("pi/2", 0.4, 0, 0)]
    tree = Manipulator.from_modified_dh(rows, parents=[0, 1, 1], gravity=DOWN, friction=())
    network = jc.derive(tree, lengths="numeric")
    k = network.coefficients_from(
        [LinkParameters(1.0, np.array([0.1, 0.0, 0.2]), 0.01 * np.eye(3), 0.1)] * 3
    )
    q = rng.normal(size=3)
    jacobian = hand_effects(network, k, q, point=POINT) @ network.mass_matrix(k, q)
    assert_allclose(jacobian[:, 1], 0.0, atol=1e-12)
    assert np.linalg.norm(jacobian[:, 2]) > 0.1


def test_transforms(
    network: jc.CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> None:
    k, q = network.coefficients_from(links), jnp.asarray(rng.normal(size=(SAMPLES, 4)))
    eager = hand_effects(network, k, q, point=POINT)

    def of_one(q: jax.Array) -> jax.Array:
        return hand_effects(network, k, q, point=POINT)

    assert_allclose(jax.jit(of_one)(q), eager, rtol=1e-10, atol=1e-12)
    assert_allclose(jax.vmap(of_one)(q), eager, rtol=1e-10, atol=1e-12)
    step = 1e-6
    direction = rng.normal(size=4)
    slope = jax.jvp(of_one, (q[0],), (jnp.asarray(direction),))[1]
    central = (of_one(q[0] + step * direction) - of_one(q[0] - step * direction)) / (2 * step)
    assert_allclose(slope, central, rtol=1e-5, atol=1e-7)


def patterns_of(
    network: jc.CSLC, k: jax.Array, error: np.ndarray, rng: np.random.Generator
) -> jc.Patterns:
    q, qd, qdd = rng.normal(size=(3, SAMPLES, 4))
    torque = np.asarray(network.torque(k, q, qd, qdd)) + error
    mask = np.ones(torque.shape, bool)
    mask[:5, 2] = False
    return jc.Patterns(np.arange(float(SAMPLES)), q, qd, qdd, torque, mask, mask)


def test_errors_of_models(
    network: jc.CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> None:
    """Means by hand, of patterns whose joints are all judged; and linear in the error."""
    k = network.coefficients_from(links)
    error = rng.normal(size=(SAMPLES, 4))
    patterns = patterns_of(network, k, error, rng)
    result = hand_errors(network, patterns, {"true": k, "none": 0 * k}, k, point=POINT)
    effects = np.asarray(hand_effects(network, k, patterns.q, point=POINT))
    lengths = [np.linalg.norm(effects[i] @ error[i]) for i in range(5, SAMPLES)]
    alone = [np.linalg.norm(effects[i][:, 1] * error[i, 1]) for i in range(5, SAMPLES)]
    assert result.patterns == SAMPLES - 5
    assert_allclose(result.total[0], np.mean(lengths), rtol=1e-9)
    assert_allclose(result.per_joint[0, 1], np.mean(alone), rtol=1e-9)
    assert np.all(result.total <= result.per_joint.sum(axis=1))
    assert result.rows()[-1] == {"": "all joints", "true": result.total[0], "none": result.total[1]}
    assert str(result).startswith("mean acceleration error of the hand [m/s²], 15 patterns: true")


def test_failures(
    network: jc.CSLC, links: tuple[LinkParameters, ...], rng: np.random.Generator
) -> None:
    k = network.coefficients_from(links)
    with pytest.raises(ValueError, match="link: expected 1 to 4, got 5"):
        hand_effects(network, k, np.zeros(4), link=5)
    patterns = patterns_of(network, k, np.zeros((SAMPLES, 4)), rng)
    with pytest.raises(ValueError, match="none has all joints"):
        hand_errors(network, patterns.between(0.0, 4.5), {"true": k}, k)

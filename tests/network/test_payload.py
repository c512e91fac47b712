"""A payload: ten more coefficients of the same network (8.2.4)."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
import sim
from jaxcslc.manipulator import RobotError, fixed_together
from jaxcslc.network import PAYLOAD, carrier


LINKS: tuple[jc.LinkParameters, ...] = jc.puma560().links or ()
BALL = jc.LinkParameters(
    1.7,
    np.array([0.03, -0.05, 0.12]),
    np.array([[0.012, 0.001, -0.002], [0.001, 0.010, 0.0015], [-0.002, 0.0015, 0.009]]),
)


@pytest.fixture(scope="module")
def loaded(puma: jc.CSLC) -> jc.CSLC:
    return puma.with_payload()


@pytest.fixture(scope="module")
def loaded_k(loaded: jc.CSLC) -> Array:
    robot = loaded.robot
    return loaded.coefficients_from(LINKS, viscous=robot.viscous, dry=robot.dry, payload=BALL)


def _motion(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Random q, qd and qdd of six joints, of one number of samples: tests share programs."""
    return tuple(rng.uniform(-2, 2, (16, 6)) for _ in range(3))


def test_torque_is_mujocos_of_an_arm_whose_last_link_holds_the_body(
    loaded: jc.CSLC, loaded_k: Array, rng: np.random.Generator
) -> None:
    """Against MuJoCo's inverse dynamics of one body, links and payload fused by its parameters."""
    robot = loaded.robot
    fused = (*LINKS[:-1], fixed_together([LINKS[-1], BALL]))
    model = mujoco.MjModel.from_xml_string(sim.mjcf(robot, fused))
    data = mujoco.MjData(model)
    viscous, dry = np.array(robot.viscous), np.array(robot.dry)
    motion = _motion(rng)
    expected: list[np.ndarray] = []
    for q, qd, qdd in zip(*motion, strict=True):
        data.qpos, data.qvel, data.qacc = q, qd, qdd
        mujoco.mj_inverse(model, data)
        expected.append(data.qfrc_inverse + viscous * qd + dry * np.sign(qd))
    np.testing.assert_allclose(loaded.torque(loaded_k, *motion), expected, rtol=0, atol=1e-9)


def test_coefficients_are_the_ten_numbers_of_a_body(loaded: jc.CSLC, loaded_k: Array) -> None:
    ten = np.asarray(loaded_k[loaded.layout.payload])
    centre = np.asarray(BALL.centre_of_gravity)
    tensor = BALL.inertia + BALL.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    np.testing.assert_allclose(ten[:3], np.diag(tensor))
    np.testing.assert_allclose(ten[3:6], [tensor[0, 1], tensor[0, 2], tensor[1, 2]])
    np.testing.assert_allclose(ten[6:], [*(float(BALL.mass) * centre), float(BALL.mass)])
    assert loaded.names[loaded.layout.payload] == PAYLOAD
    assert {c.group for c in loaded.coefficients[loaded.layout.payload]} == {"payload"}
    assert [c.unit for c in loaded.coefficients[loaded.layout.payload]] == [
        *["kg m²"] * 6,
        *["kg m"] * 3,
        "kg",
    ]
    assert loaded.coefficients[-1].expression == "mp"
    assert loaded.coefficients[-4].expression == "mp*rxp"


def test_terms_add_up_to_the_torque(
    loaded: jc.CSLC, loaded_k: Array, rng: np.random.Generator
) -> None:
    q, qd, qdd = _motion(rng)
    torque = loaded.torque(loaded_k, q, qd, qdd)
    mass = jnp.einsum("...ij,...j->...i", loaded.mass_matrix(loaded_k, q), qdd)
    parts = loaded.velocity_term(loaded_k, q, qd) + loaded.gravity_term(loaded_k, q)
    np.testing.assert_allclose(mass + parts + loaded.friction_term(loaded_k, qd), torque, atol=1e-9)
    np.testing.assert_allclose(loaded.regressor(q, qd, qdd) @ loaded_k, torque, atol=1e-9)
    np.testing.assert_allclose(
        loaded.forward_dynamics(loaded_k, q, qd, torque), qdd, rtol=0, atol=1e-8
    )


def test_columns_are_the_regressors(loaded: jc.CSLC, rng: np.random.Generator) -> None:
    q, qd, qdd = _motion(rng)
    regressor = np.asarray(loaded.regressor(q, qd, qdd))
    columns = loaded.columns(*(jnp.asarray(x.T) for x in (q, qd, qdd)))
    for joint, (support, rows) in enumerate(zip(loaded.support, columns, strict=True)):
        np.testing.assert_allclose(np.asarray(rows).T, regressor[:, joint, list(support)])
        left = np.delete(regressor[:, joint], list(support), axis=1)
        assert not left.any()


def test_nothing_is_no_payload(
    puma: jc.CSLC, puma_k: Array, loaded: jc.CSLC, rng: np.random.Generator
) -> None:
    q, qd, qdd = _motion(rng)
    k = jnp.concatenate([puma_k, jnp.zeros(10)])
    np.testing.assert_allclose(
        loaded.torque(k, q, qd, qdd), puma.torque(puma_k, q, qd, qdd), atol=1e-12
    )
    assert puma.payload is None


def test_the_closed_form_of_the_payload_agrees_with_the_recursion(
    loaded: jc.CSLC, rng: np.random.Generator
) -> None:
    """The algebra's tables of an arm with no mass but the payload's, derived independently."""
    alone = jc.derive(carrier(loaded.robot), lengths="numeric", evaluator="tables")
    q, qd, qdd = _motion(rng)
    none = [jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))] * 5
    alone_k = alone.coefficients_from([*none, BALL])
    k = (
        jnp.zeros(loaded.size)
        .at[loaded.layout.payload]
        .set(loaded.coefficients_from([*none, none[0]], payload=BALL)[loaded.layout.payload])
    )
    np.testing.assert_allclose(
        loaded.torque(k, q, qd, qdd), alone.torque(alone_k, q, qd, qdd), atol=1e-11
    )


def test_a_short_arm_does_not_determine_all_ten_parameters() -> None:
    """In a vertical plane an elbow determines one moment and two first moments beside the mass."""
    arm = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, -9.81, 0), motor_inertia=False
    )
    assert jc.derive(carrier(arm), lengths="numeric").size == 4
    network = jc.derive(arm, lengths="numeric").with_payload()
    assert network.order_per_joint[0] == jc.derive(arm, lengths="numeric").order_per_joint[0] + 4
    assert network.counts["payload"]["coefficients"] == 4


@pytest.mark.parametrize("link", [3, 6])
def test_any_link_can_carry(
    puma: jc.CSLC, puma_k: Array, rng: np.random.Generator, link: int
) -> None:
    network = puma.with_payload(link)
    assert network.carrying_link == link and puma.carrying_link is None
    robot = network.robot
    links = list(LINKS)
    links[link - 1] = fixed_together([links[link - 1], BALL])
    full = jc.derive(robot.with_inertia("full"), lengths="numeric")
    q, qd, qdd = _motion(rng)
    expected = full.torque(
        full.coefficients_from(links, viscous=robot.viscous, dry=robot.dry), q, qd, qdd
    )
    k = network.coefficients_from(LINKS, viscous=robot.viscous, dry=robot.dry, payload=BALL)
    np.testing.assert_allclose(network.torque(k, q, qd, qdd), expected, atol=1e-9)


def test_transforms(loaded: jc.CSLC, loaded_k: Array, rng: np.random.Generator) -> None:
    q, qd, qdd = (jnp.asarray(x) for x in _motion(rng))
    torque = loaded.torque(loaded_k, q, qd, qdd)
    np.testing.assert_allclose(jax.jit(loaded.torque)(loaded_k, q, qd, qdd), torque, atol=1e-12)
    mapped = jax.vmap(loaded.torque, in_axes=(None, 0, 0, 0))(loaded_k, q, qd, qdd)
    np.testing.assert_allclose(mapped, torque, atol=1e-12)
    direction = jnp.asarray(rng.normal(size=loaded.size))
    _, slope = jax.jvp(lambda k: loaded.torque(k, q, qd, qdd), (loaded_k,), (direction,))
    np.testing.assert_allclose(slope, loaded.regressor(q, qd, qdd) @ direction, atol=1e-11)


def test_refusals(puma: jc.CSLC, loaded: jc.CSLC) -> None:
    with pytest.raises(ValueError, match="has a payload already"):
        loaded.with_payload()
    with pytest.raises(RobotError, match="no link 7; expected 1 to 6"):
        puma.with_payload(7)
    with pytest.raises(ValueError, match="payload: the network has none"):
        puma.coefficients_from(LINKS, payload=BALL)

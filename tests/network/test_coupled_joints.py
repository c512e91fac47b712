"""Joints that follow others: against Pinocchio and MuJoCo, and fitted like any network."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.least_squares import regressor_of
from jaxcslc.manipulator import fixed_together


HAND = (Path(__file__).parents[1] / "data" / "hand.urdf").read_text(encoding="utf-8")
_ROUNDING = 1e-10


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> jc.CSLC:
    path = tmp_path_factory.mktemp("hand") / "hand.urdf"
    path.write_text(HAND)
    return jc.derive(jc.load_robot(path, mimic="couple"), lengths="numeric")


@pytest.fixture(scope="module")
def k(coupled: jc.CSLC) -> Float[np.ndarray, " coefficients"]:
    links = coupled.robot.links or ()
    viscous, dry = [0.3, 0.2, 0.0, 0.0], [0.1, 0.4, 0.0, 0.0]
    return np.asarray(coupled.coefficients_from(links, viscous=viscous, dry=dry))


def test_the_laws_are_those_of_the_file(coupled: jc.CSLC) -> None:
    """Those of the last one by way of another: -0.8 left + 0.2 - 0.3."""
    assert coupled.output_names == ("shoulder", "left") and coupled.motion_count == 2
    q = coupled.positions_of_all_joints(np.array([0.5, 1.0]))
    np.testing.assert_allclose(q, [0.5, 1.0, -0.3, -0.9])
    assert coupled.robot.joint_count == 4 and coupled.robot.independent_joints == (0, 1)
    assert coupled.joint_kinds == "RR" and coupled.robot.kinds == "RRPR"
    assert coupled.robot.with_friction("dry").friction_per_joint[1:] == (("dry",), (), ())


def test_torque_is_pinocchios(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    """Virtual work of its inverse dynamics of all joints, moved as the file says."""
    model = pinocchio.buildModelFromXML(re.sub(r"<mimic[^>]*/>", "", HAND))
    assert list(model.names)[1:] == ["shoulder", "left", "right", "end"]
    data = model.createData()
    matrix = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -0.4], [0.0, -0.8]])
    offset = np.array([0.0, 0.0, 0.1, -0.1])
    for u, ud, udd in rng.uniform(-2, 2, (5, 3, 2)):
        q = matrix @ u + offset
        # Pinocchio has cosine and sine of joints without limits.
        of_model = [np.cos(q[0]), np.sin(q[0]), np.cos(q[1]), np.sin(q[1]), q[2]]
        of_model = np.array([*of_model, np.cos(q[3]), np.sin(q[3])])
        rigid = matrix.T @ pinocchio.rnea(model, data, of_model, matrix @ ud, matrix @ udd)
        friction = [0.3, 0.2] * ud + [0.1, 0.4] * np.sign(ud)
        np.testing.assert_allclose(coupled.torque(k, u, ud, udd), rigid + friction, atol=_ROUNDING)


def test_regressor_columns_and_torque_agree(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    motion = rng.uniform(-2, 2, (3, 40, 2))
    torque = np.asarray(coupled.torque(k, *motion))
    regressor = np.asarray(coupled.regressor(*motion))
    np.testing.assert_allclose(regressor @ k, torque, atol=_ROUNDING)
    columns = coupled.columns(*(np.ascontiguousarray(x.T) for x in motion))
    for joint, (rows, support) in enumerate(zip(columns, coupled.support, strict=True)):
        np.testing.assert_allclose(np.asarray(rows).T @ k[list(support)], torque[:, joint])


def test_it_is_fitted_from_motion_of_the_independent_joints(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    """Coefficients of which only a finger by itself would tell are left undetermined."""
    motion = rng.uniform(-2, 2, (3, 300, 2))
    torque = np.asarray(coupled.torque(k, *motion))
    every = np.ones(torque.shape, bool)
    q, qd, qdd = motion
    patterns = jc.Patterns(0.01 * np.arange(300), q, qd, qdd, torque, every, every)
    fit = jc.LeastSquares(errors="independent").fit(coupled, patterns)
    assert 0 < int(fit.rank) < coupled.size and fit.unidentifiable
    predicted = np.asarray(regressor_of(coupled, patterns)) @ np.asarray(fit.k)
    np.testing.assert_allclose(predicted, torque, atol=1e-8)
    friction = coupled.layout.friction
    np.testing.assert_allclose(np.asarray(fit.k)[friction], k[friction], atol=1e-8)


def test_friction_and_springs_of_followers_are_their_leaders(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    """By virtual work: viscous and spring coefficients times the multiplier's square, Coulomb ones
    times its size; a follower's spring at rest elsewhere is an offset of the leader."""
    matrix = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -0.4], [0.0, -0.8]])
    zero = np.array([0.0, 0.0, 0.1, -0.1])
    viscous, dry, spring = rng.uniform(0.1, 1.0, (3, 4))
    q, qd, qdd = rng.uniform(-2, 2, (3, 300, 2))
    of_joints = viscous * (qd @ matrix.T) + dry * np.sign(qd @ matrix.T)
    of_joints += spring * (q @ matrix.T + zero)
    rigid = np.array(k)
    rigid[coupled.layout.friction] = 0.0
    torque = np.asarray(coupled.torque(rigid, q, qd, qdd)) + of_joints @ matrix
    network = coupled.with_joint_friction([("viscous", "dry", "spring", "offset")] * 2)
    every = np.ones(torque.shape, bool)
    patterns = jc.Patterns(0.01 * np.arange(300), q, qd, qdd, torque, every, every)
    fit = jc.LeastSquares(errors="independent").fit(network, patterns)
    value = dict(zip(network.names, np.asarray(fit.k), strict=True))
    squares, sizes = matrix**2, np.abs(matrix)
    expected = {"kv": viscous @ squares, "kd": dry @ sizes, "ke": spring @ squares}
    for letters, values in (expected | {"ko": (spring * zero) @ matrix}).items():
        found = [value[f"{letters}{joint}"] for joint in (1, 2)]
        np.testing.assert_allclose(found, values, atol=1e-8)


MJCF = """<mujoco><worldbody><body name="a"><joint name="x" axis="0 1 0" ref="20"/>
<geom size="0.1" pos="0.1 0 0"/><body name="b" pos="0 0 0.2">
<joint name="y" axis="1 0 0" ref="-35"/><geom size="0.1" pos="0 0.1 0"/></body></body></worldbody>
<equality><joint joint1="y" joint2="x" polycoef="0.2 -1.5 {0} 0 0"/></equality></mujoco>"""


def test_a_law_of_mujoco(tmp_path: Path) -> None:
    """From its zero position on: MuJoCo's constraint holds where the law puts the joints."""
    path = tmp_path / "two.xml"
    path.write_text(MJCF.format(0))
    network = jc.derive(jc.load_robot(path, mimic="couple"), lengths="numeric")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for u in (0.3, -1.2):
        data.qpos[:] = network.positions_of_all_joints(np.array([u]))
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.efc_pos[:1], 0.0, atol=1e-12)
    path.write_text(MJCF.format(0.5))
    with pytest.raises(
        jc.RobotError, match=r"joint 'y' mimics 'x'; .*\(or --fix x\), which fixes both"
    ):
        jc.load_robot(path, mimic="couple")


@pytest.mark.parametrize("number", ["nan", "x", ""])
def test_a_law_that_is_none(tmp_path: Path, number: str) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.replace('"-0.4"', f'"{number}"'))
    with pytest.raises(jc.RobotError, match=r"expected a finite number|nan|bad format"):
        jc.load_robot(path, mimic="couple")


def test_what_it_needs(coupled: jc.CSLC, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"shape \(..., 2\)"):
        coupled.torque(np.ones(coupled.size), *np.zeros((3, 4)))
    with pytest.raises(jc.RobotError, match=r"joint 3 \(right\) follows another"):
        coupled.robot.with_friction("dry", joint=3)
    with pytest.raises(jc.RobotError, match=r"coupled: joint 4 \(end\) follows another"):
        jc.derive(coupled.robot.with_coupling((1, 4)), lengths="numeric")
    path = tmp_path / "hand.urdf"
    path.write_text(HAND)
    assert jc.load_robot(path, mimic="fix").joint_names == ("shoulder",)


def test_parts_of_the_equation_of_motion(
    coupled: jc.CSLC, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    q, qd, qdd = rng.uniform(-2, 2, (3, 6, 2))
    mass = np.asarray(coupled.mass_matrix(k, q))
    np.testing.assert_allclose(mass, np.swapaxes(mass, 1, 2), atol=_ROUNDING)
    parts = coupled.velocity_term(k, q, qd) + coupled.gravity_term(k, q)
    parts += coupled.friction_term(k, qd) + np.einsum("tij,tj->ti", mass, qdd)
    tau = coupled.torque(k, q, qd, qdd)
    np.testing.assert_allclose(parts, tau, atol=_ROUNDING)
    np.testing.assert_allclose(coupled.forward_dynamics(k, q, qd, tau), qdd, atol=1e-8)


def test_a_payload_on_a_finger(coupled: jc.CSLC, rng: np.random.Generator) -> None:
    """It is a part of the link that carries it."""
    links = list(coupled.robot.links or ())
    body = jc.LinkParameters(0.4, np.array([0.0, 0.1, 0.02]), 0.001 * np.eye(3))
    loaded = coupled.with_payload(link=3)
    assert loaded.carrying_link == 3 and loaded.names[-1] == "pm"
    motion = rng.uniform(-2, 2, (3, 5, 2))
    with_it = loaded.torque(loaded.coefficients_from(links, payload=body), *motion)
    links[2] = fixed_together([links[2], body])
    np.testing.assert_allclose(
        with_it, coupled.torque(coupled.coefficients_from(links), *motion), atol=_ROUNDING
    )

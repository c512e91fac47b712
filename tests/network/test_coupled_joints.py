"""Joints that follow others: against Pinocchio and MuJoCo, and fitted like any network."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.identification.solver import regressor_of
from jaxcslc.network import CoupledJoints


# An arm, and on its link two fingers and a tip that follow the first finger by way of the second.
LINK = """<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/>
<inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>
<origin xyz="{4}" rpy="0.3 0 0.2"/><axis xyz="{5}"/>{6}</joint>"""
HAND = "".join(
    [
        '<robot name="hand"><link name="floor"/>',
        LINK.format("arm", "0.2 0 0.1", 2.0),
        LINK.format("finger", "0.05 0.1 0", 0.5),
        LINK.format("thumb", "0.02 0 0.1", 0.7),
        LINK.format("tip", "0 0.04 0.1", 0.3),
        JOINT.format("shoulder", "continuous", "floor", "arm", "0 0 0.2", "0 1 0", ""),
        JOINT.format("left", "continuous", "arm", "finger", "0.3 0 0", "1 0 0", ""),
        JOINT.format(
            *("right", "prismatic", "arm", "thumb", "0.3 0.1 0", "0 1 0"),
            '<limit lower="-9" upper="9" velocity="9" effort="9"/>'
            '<mimic joint="left" multiplier="-0.4" offset="0.1"/>',
        ),
        JOINT.format(
            *("end", "continuous", "thumb", "tip", "0 0 0.1", "0 0 1"),
            '<mimic joint="right" multiplier="2" offset="-0.3"/>',
        ),
        "</robot>",
    ]
)
_ROUNDING = 1e-10


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> CoupledJoints:
    path = tmp_path_factory.mktemp("hand") / "hand.urdf"
    path.write_text(HAND)
    return CoupledJoints.of(jc.derive(jc.load_robot(path, keep_mimics=True), lengths="numeric"))


@pytest.fixture(scope="module")
def k(coupled: CoupledJoints) -> Float[np.ndarray, " coefficients"]:
    links = coupled.robot.links or ()
    viscous, dry = [0.3, 0.2, 0.0, 0.0], [0.1, 0.4, 0.0, 0.0]
    return np.asarray(coupled.network.coefficients_from(links, viscous=viscous, dry=dry))


def test_the_laws_are_those_of_the_file(coupled: CoupledJoints) -> None:
    """Those of the last one by way of another: -0.8 left + 0.2 - 0.3."""
    assert coupled.output_names == ("shoulder", "left") and coupled.motion_count == 2
    q, qd, qdd = coupled.of_all_joints(*np.array([[0.5, 1.0], [2.0, 3.0], [4.0, 5.0]]))
    np.testing.assert_allclose(q, [0.5, 1.0, -0.3, -0.9])
    np.testing.assert_allclose(qd, [2.0, 3.0, -1.2, -2.4])
    np.testing.assert_allclose(qdd, [4.0, 5.0, -2.0, -4.0])
    assert coupled.network.robot.friction_per_joint[2:] == ((), ())


def test_torque_is_pinocchios(
    coupled: CoupledJoints, k: Float[np.ndarray, " _"], rng: np.random.Generator
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
    coupled: CoupledJoints, k: Float[np.ndarray, " _"], rng: np.random.Generator
) -> None:
    motion = rng.uniform(-2, 2, (3, 40, 2))
    torque = np.asarray(coupled.torque(k, *motion))
    regressor = np.asarray(coupled.regressor(*motion))
    np.testing.assert_allclose(regressor @ k, torque, atol=_ROUNDING)
    columns = coupled.columns(*(np.ascontiguousarray(x.T) for x in motion))
    for joint, (rows, support) in enumerate(zip(columns, coupled.support, strict=True)):
        np.testing.assert_allclose(np.asarray(rows).T @ k[list(support)], torque[:, joint])


def test_it_is_fitted_from_motion_of_the_independent_joints(
    coupled: CoupledJoints, k: Float[np.ndarray, " _"], rng: np.random.Generator
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


MJCF = """<mujoco><worldbody><body name="a"><joint name="x" axis="0 1 0" ref="20"/>
<geom size="0.1" pos="0.1 0 0"/><body name="b" pos="0 0 0.2">
<joint name="y" axis="1 0 0" ref="-35"/><geom size="0.1" pos="0 0.1 0"/></body></body></worldbody>
<equality><joint joint1="y" joint2="x" polycoef="0.2 -1.5 {0} 0 0"/></equality></mujoco>"""


def test_a_law_of_mujoco(tmp_path: Path) -> None:
    """From its zero position on: MuJoCo's constraint holds where the law puts the joints."""
    path = tmp_path / "two.xml"
    path.write_text(MJCF.format(0))
    network = CoupledJoints.of(jc.derive(jc.load_robot(path, keep_mimics=True), lengths="numeric"))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for u in (0.3, -1.2):
        data.qpos[:] = network.of_all_joints(*np.array([[u], [0.0], [0.0]]))[0]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.efc_pos[:1], 0.0, atol=1e-12)
    path.write_text(MJCF.format(0.5))
    with pytest.raises(jc.RobotError, match=r"joint 'y' mimics 'x'; .*--fix x fixes"):
        jc.load_robot(path, keep_mimics=True)


@pytest.mark.parametrize("number", ["nan", "x", ""])
def test_a_law_that_is_none(tmp_path: Path, number: str) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.replace('"-0.4"', f'"{number}"'))
    with pytest.raises(jc.RobotError, match=r"expected a finite number|nan|bad format"):
        jc.load_robot(path, keep_mimics=True)


def test_what_it_needs(coupled: CoupledJoints) -> None:
    with pytest.raises(jc.RobotError, match="no joints that mimic others"):
        CoupledJoints.of(jc.derive(jc.puma560()))
    with pytest.raises(ValueError, match=r"shape \(..., 2\)"):
        coupled.torque(np.ones(coupled.size), *np.zeros((3, 4)))

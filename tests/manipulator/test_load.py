"""Robots from URDF and MJCF: torque and base parameters against Pinocchio and MuJoCo."""

import re
from collections.abc import Callable, Iterator
from importlib.metadata import files
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

import jaxcslc as jc


DATA = Path(__file__).parents[1] / "data"
TX40 = Path(__file__).parents[3] / "shared" / "data" / "staubli_tx40" / "tx40_mdh_modified.urdf"
STATES = 1000
AGREEMENT = 1e-9  # of the largest torque


def example(name: str) -> Path:
    """A robot of the package example-robot-data."""
    (path,) = [path for path in files("example-robot-data") or [] if path.name == name]
    return Path(str(path.locate()))


def states(rng: np.random.Generator, samples: int, joints: int) -> Iterator[np.ndarray]:
    yield from rng.uniform(-3.0, 3.0, (3, samples, joints))


def rigid_torque(robot: jc.Manipulator) -> Callable[..., np.ndarray]:
    """Torque without friction, by the links that the file gives."""
    network = jc.derive(robot.with_friction(), lengths="numeric", evaluator="recursive")
    assert robot.links is not None
    k = network.coefficients_from(robot.links)
    return lambda *state: np.asarray(network.torque(k, *state))


def disagreement(actual: np.ndarray, expected: np.ndarray) -> float:
    return float(np.max(np.abs(actual - expected)) / np.max(np.abs(expected)))


class Oracle(NamedTuple):
    """Pinocchio's model of the same part of a file, joints in Pinocchio's order."""

    model: Any
    data: Any
    order: list[int]

    @classmethod
    def of(cls, path: Path, robot: jc.Manipulator) -> "Oracle":
        assert robot.source is not None
        model: Any = pin.buildModelFromUrdf(str(path))
        locked = [
            model.getJointId(n) for n in list(model.names)[1:] if n not in robot.source.joints
        ]
        model = pin.buildReducedModel(model, locked, pin.neutral(model))
        names = list(model.names)[1:]
        return cls(model, model.createData(), [robot.source.joints.index(n) for n in names])

    def q(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio has cosine and sine of joints without limits."""
        parts = [
            [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            for joint, x in zip(list(self.model.joints)[1:], q[self.order], strict=True)
        ]
        return np.concatenate(parts)

    def torque(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        torque = np.empty_like(q)
        for row, (x, v, a) in enumerate(zip(q, qd, qdd, strict=True)):
            at = pin.rnea(self.model, self.data, self.q(x), v[self.order], a[self.order])
            torque[row, self.order] = at
        return torque

    def rank(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> int:
        """Numeric rank of the regressor over all link parameters, columns of unit length."""
        rows = [
            pin.computeJointTorqueRegressor(
                self.model, self.data, self.q(x), v[self.order], a[self.order]
            )
            for x, v, a in zip(q, qd, qdd, strict=True)
        ]
        matrix = np.concatenate(rows)
        norms = np.linalg.norm(matrix, axis=0)
        visible = norms > 1e-9 * np.max(norms)  # the others are rounding, and would be scaled up
        singular = np.linalg.svd(matrix[:, visible] / norms[visible], compute_uv=False)
        return int(np.sum(singular > 1e-9 * singular[0]))


def base_parameters(robot: jc.Manipulator) -> int:
    """How many there are without motors, which Pinocchio's regressor does not have."""
    without = robot.with_inertia("full", motor_inertia=False).with_friction()
    return jc.derive(without, lengths="numeric").size


FILES = {
    "panda": ("panda.urdf", {"tip": "panda_hand"}),
    "ur5": ("ur5_robot.urdf", {}),
    "finger": ("finger_edu.urdf", {}),
}


@pytest.mark.parametrize("name", FILES)
def test_urdf_is_pinocchios(rng: np.random.Generator, name: str) -> None:
    """Torque on 1,000 states, and as many base parameters as the regressor has rank."""
    file, part = FILES[name]
    is_pinocchios(rng, example(file), **part)


def test_robots_of_others_load_or_say_why_not() -> None:
    """As `docs/robots.md` tells of the package example-robot-data."""
    paths = [
        Path(str(f.locate())) for f in files("example-robot-data") or [] if f.suffix == ".urdf"
    ]
    refused: dict[str, int] = {}
    for path in paths:
        try:
            jc.load_robot(path)
        except jc.RobotError as error:
            (line,) = str(error).splitlines()
            kinds = ("expected --mimic couple", "no joint that moves", "no joint of this file")
            (kind,) = (kind for kind in kinds if kind in line)
            refused[kind] = refused.get(kind, 0) + 1
            if kind == kinds[0]:
                assert jc.load_robot(path, mimic="fix").joint_count > 0
    assert sorted(refused.values()) == [1, 3, 8]
    text = " ".join((Path(__file__).parents[2] / "docs" / "robots.md").read_text("utf-8").split())
    loaded = len(paths) - sum(refused.values())
    assert f"the {len(paths)} URDFs" in text and f"{loaded} of them load" in text


@pytest.mark.skipif(not TX40.is_file(), reason="the TX40's files are not beside the project")
def test_the_tx40_is_pinocchios(rng: np.random.Generator) -> None:
    is_pinocchios(rng, TX40)


def is_pinocchios(rng: np.random.Generator, path: Path, **part: Any) -> None:
    robot = jc.load_robot(path, **part)
    oracle = Oracle.of(path, robot)
    state = tuple(states(rng, STATES, robot.joint_count))
    assert disagreement(rigid_torque(robot)(*state), oracle.torque(*state)) < AGREEMENT
    assert base_parameters(robot) == oracle.rank(*(x[:100] for x in state))


def test_inertial_origins_turn_the_tensor(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "turned.urdf"
    link = urdf_link("bar", 2.0, (0.1, 0.2, 0.3), "0.3 -0.2 0.9", np.diag([0.1, 0.2, 0.25]))
    joint = urdf_joint("hinge", "floor", "bar", (0.1, 0, 0), "0.4 0.1 0", (1.0, 2.0, 3.0))
    path.write_text(f'<robot name="r"><link name="floor"/>{link}{joint}</robot>')
    robot = jc.load_robot(path)
    state = tuple(states(rng, 20, 1))
    expected = Oracle.of(path, robot).torque(*state)
    assert disagreement(rigid_torque(robot)(*state), expected) < AGREEMENT


@pytest.mark.parametrize(
    ("file", "part"),
    [
        ("puma560.xml", {}),
        ("two_arms.xml", {}),
        ("two_arms.xml", {"base": "torso"}),
        ("two_arms.xml", {"tip": "left forearm"}),
        ("two_arms.xml", {"base": "torso", "tip": "right forearm"}),
    ],
)
def test_mjcf_is_mujocos(rng: np.random.Generator, file: str, part: dict[str, Any]) -> None:
    """Rigid torque, armature included, on 1,000 states; joints off the part fixed at zero."""
    robot = jc.load_robot(DATA / file, **part)
    assert robot.source is not None
    model: Any = compiled(DATA / file, part.get("base"))
    model.dof_damping[:], model.dof_frictionloss[:] = 0.0, 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data: Any = mujoco.MjData(model)
    dofs = [model.joint(name).dofadr[0] for name in robot.source.joints]
    q, qd, qdd = states(rng, STATES, robot.joint_count)
    expected = np.empty_like(q)
    for i in range(STATES):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0.0, 0.0
        data.qpos[dofs], data.qvel[dofs], data.qacc[dofs] = q[i], qd[i], qdd[i]
        mujoco.mj_inverse(model, data)
        expected[i] = data.qfrc_inverse[dofs]
    assert disagreement(rigid_torque(robot)(q, qd, qdd), expected) < AGREEMENT


def compiled(path: Path, base: str | None) -> Any:
    """MuJoCo's model without the meshes that are not there, nothing moving up to the base."""
    spec: Any = mujoco.MjSpec.from_file(str(path))
    for geom in [g for body in spec.bodies for g in body.geoms]:
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    for key in list(spec.keys):
        spec.delete(key)
    body = spec.body(base) if base else None
    while body is not None and body.name != "world":
        for joint in list(body.joints):
            for actuator in list(spec.actuators):
                spec.delete(actuator)
            for sensor in list(spec.sensors):
                spec.delete(sensor)
            spec.delete(joint)
        body = body.parent
    return spec.compile()


def test_what_a_file_says_of_drives() -> None:
    robot = jc.load_robot(DATA / "two_arms.xml")
    assert robot.source is not None and robot.links is not None
    assert robot.source.joints == (
        *("waist", "lift", "left shoulder", "left elbow"),
        *("right shoulder", "right elbow", "right twist"),
    )
    assert robot.kinds == "RPRRRRR"
    assert robot.parents == (-1, 0, 1, 2, 1, 4, 5)
    assert robot.viscous == (0.7, 0.7, 0.7, 0.1, 0.7, 0.1, 0.1)
    assert robot.dry == (0, 0, 0, 0.05, 0, 0.05, 0.05)
    assert [float(link.motor_inertia) for link in robot.links] == [
        *(0.02, 0.02, 0.02, 0.0, 0.02, 0.0, 0.0)
    ]


def test_what_mjcf_says_of_limits(tmp_path: Path) -> None:
    """Ranges are of positions as recorded, `ref` included; torques are those of both directions."""
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><default><default class="big"><general forcerange="-87 87"/></default></default>
        <worldbody><body><joint name="a" axis="0 1 0" range="-30 45" ref="10"/><geom size="0.1"/>
        <body><joint name="b" axis="0 1 0" limited="false" range="-1 1" actuatorfrcrange="-5 7"/>
        <geom size="0.1"/><body><joint name="c" type="slide" range="-0.1 0.2"/><geom size="0.1"/>
        </body></body></body></worldbody>
        <actuator><general class="big" joint="a" gear="2"/><motor joint="b" forcerange="-9 9"/>
        <motor joint="c" forcerange="0 255"/></actuator></mujoco>"""
    )
    a, b, c = jc.load_robot(path).joint_limits
    assert_allclose([a.low, a.high, a.torque], [-np.pi / 6, np.pi / 4, 174.0])
    assert (b.low, b.high, b.torque) == (-np.inf, np.inf, 5.0)
    assert (c.low, c.high, c.torque) == (-0.1, 0.2, np.inf)
    assert jc.load_robot(path, fix="a").joint_limits == (b, c)


def test_springs_and_rest(tmp_path: Path) -> None:
    path = tmp_path / "sprung.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint stiffness="3"/><geom size="0.1"/></body></worldbody>'
        "</mujoco>"
    )
    assert jc.load_robot(path).friction == ("viscous", "dry", "spring", "offset")


def test_a_mesh_s_inertia_is_not_guessed(tmp_path: Path) -> None:
    path = tmp_path / "shell.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="none.stl"/></asset><worldbody><body>'
        '<joint axis="0 1 0"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    robot = jc.load_robot(path)
    assert robot.links is None
    assert base_parameters(robot) == 3


def test_bodies_without_geometry_weigh_nothing(tmp_path: Path) -> None:
    """Frames, and bodies whose geometry has no mass, add nothing to their link."""
    looks = '<geom type="mesh" mesh="m" mass="0"/>'
    path = tmp_path / "frames.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="none.stl"/></asset><worldbody><body>'
        '<joint axis="0 1 0"/><geom size="0.1" mass="2"/><body pos="1 0 0"/>'
        f'<body pos="1 0 0">{looks}</body></body></worldbody></mujoco>'
    )
    robot = jc.load_robot(path)
    assert robot.links is not None and robot.source is not None
    assert float(robot.links[0].mass) == 2.0
    assert robot.source.carried == (None,)


def test_carried_bodies_are_distinguished() -> None:
    """Composite = the file's own body, in the link's frame, and what is fixed to it."""
    robot = jc.load_robot(example("panda.urdf"), tip="panda_link7")
    assert robot.links is not None and robot.source is not None
    model: Any = pin.buildModelFromUrdf(str(example("panda.urdf")))
    hand = 0.73 + 2 * float(model.inertias[-1].mass)
    carried = robot.source.carried[-1]
    assert carried is not None
    assert_allclose(float(carried.mass), hand)
    assert_allclose(float(robot.links[-1].mass), hand + 0.735522)
    assert robot.source.carried[:-1] == (None,) * 6


def urdf_link(
    name: str, mass: float, centre: tuple[float, ...], rpy: str, tensor: np.ndarray
) -> str:
    i = tensor
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre[0]} {centre[1]} {centre[2]}"'
        f' rpy="{rpy}"/><mass value="{mass}"/><inertia ixx="{i[0, 0]}" iyy="{i[1, 1]}"'
        f' izz="{i[2, 2]}" ixy="{i[0, 1]}" ixz="{i[0, 2]}" iyz="{i[1, 2]}"/></inertial></link>'
    )


def urdf_joint(
    name: str,
    parent: str,
    child: str,
    at: tuple[float, ...],
    rpy: str,
    axis: tuple[float, ...],
    kind: str = "continuous",
) -> str:
    limit = '<limit effort="1" velocity="1" lower="-9" upper="9"/>' if kind == "prismatic" else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{rpy}"/>{limit}'
        f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/></joint>'
    )


def random_urdf(rng: np.random.Generator, joints: int, chain: bool, special: bool) -> str:
    """A tree with any axes, or with axes and offsets along those of the frames."""
    parts = ['<link name="link0"/>']
    for i in range(1, joints + 1):
        spread = rng.uniform(-1.0, 1.0, (3, 3))
        tensor = 0.05 * (np.eye(3) * np.trace(spread @ spread.T) - spread @ spread.T)
        centre = tuple(rng.uniform(-0.2, 0.2, 3))
        parts.append(urdf_link(f"link{i}", rng.uniform(0.5, 5.0), centre, "0.1 0.2 0.3", tensor))
        if special:
            axis = tuple(float(x) for x in rng.permutation([0.0, 0.0, rng.choice([-1.0, 1.0])]))
            at = tuple(rng.choice([0.0, 0.25, -0.4], 3))
            rpy = " ".join(str(x) for x in rng.choice([0.0, np.pi / 2, -np.pi / 2], 3))
        else:
            direction = rng.normal(size=3)
            axis = tuple(direction / np.linalg.norm(direction))
            at = tuple(rng.uniform(-0.5, 0.5, 3))
            rpy = " ".join(str(x) for x in rng.uniform(-3.0, 3.0, 3))
        parent = i - 1 if chain else int(rng.integers(0, i))
        kind = "prismatic" if rng.random() < 0.2 else "continuous"
        parts.append(urdf_joint(f"j{i}", f"link{parent}", f"link{i}", at, rpy, axis, kind))
    return f'<robot name="random">{"".join(parts)}</robot>'


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    joints=st.integers(2, 9),
    chain=st.booleans(),
    special=st.booleans(),
)
def test_random_robots(
    tmp_path_factory: pytest.TempPathFactory, seed: int, joints: int, chain: bool, special: bool
) -> None:
    """Chains and trees of any axes: torque and number of base parameters are Pinocchio's."""
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("random") / "robot.urdf"
    path.write_text(random_urdf(rng, joints, chain, special))
    robot = jc.load_robot(path)
    oracle = Oracle.of(path, robot)
    state = tuple(states(rng, 60, joints))
    assert base_parameters(robot) == oracle.rank(*state)
    few = tuple(x[:4] for x in state)
    assert disagreement(rigid_torque(robot)(*few), oracle.torque(*few)) < AGREEMENT


def test_materials_and_memory_do_not_matter(tmp_path: Path) -> None:
    """Geometry that masses follow from may refer to materials, which are not read."""
    text = """<mujoco><size memory="20K"/><asset><texture name="t" type="2d" builtin="flat"
    width="9" height="9"/><material name="grey" texture="t"/></asset>
    <default><geom material="grey"/></default>
    <worldbody><geom type="plane" size="1 1 1" material="grey"/><body name="arm">
    <joint name="hinge" axis="0 1 0"/><geom name="rod" size="0.1" pos="0.3 0 0" mass="2"/></body>
    </worldbody></mujoco>"""
    (tmp_path / "grey.xml").write_text(text)
    (tmp_path / "plain.xml").write_text(re.sub(' material="grey"|<size[^>]*>', "", text))
    of_grey, of_plain = (
        jc.load_robot(tmp_path / f"{name}.xml").links for name in ("grey", "plain")
    )
    assert of_grey is not None and of_plain is not None
    assert float(of_grey[0].mass) == float(of_plain[0].mass) == pytest.approx(2.0)
    assert_allclose(of_grey[0].inertia, of_plain[0].inertia)

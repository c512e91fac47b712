"""Parameters into files and back: round trips, and that nothing else changes."""

import dataclasses
import difflib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.export import read_motor_inertias
from jaxcslc.export._parameter_files import XmlEdits
from jaxcslc.manipulator import parse_xml


Links = tuple[jc.LinkParameters, ...]
_ROUNDING = 1e-9

URDF = """<?xml version="1.0"?>
<!-- an arm; 'quotes' and > signs in a comment -->
<robot name="arm">
  <link name="floor"/>
  <link name='upper'>
    <visual><origin xyz="0 0 1"/><geometry><sphere radius="0.1"/></geometry></visual>
    <inertial>
      <!-- turned on purpose -->
      <mass value='2.0'  />
      <origin rpy="0.3 -0.2 0.5" xyz="0.1 0 0"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/>
    </inertial>
  </link>
  <link name="fore"/>
  <link name="tool">
    <inertial><mass value="0.3"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>
    </inertial>
  </link>
  <joint name="shoulder" type="continuous">
    <parent link="floor"/> <child link="upper"/> <origin xyz="0 0 0.3" rpy="0.1 0 0.2"/>
    <axis xyz="0 1 0"/>
    <dynamics friction="0.5"/>
  </joint>
  <joint name="elbow" type="revolute"><limit lower="-1" upper="1" effort="5" velocity="2"/>
    <parent link="upper"/> <child link="fore"/> <origin xyz="0.3 0 0"/> <axis xyz="0 0.6 0.8"/>
  </joint>
  <joint name="bolt" type="fixed">
    <parent link="fore"/> <child link="tool"/> <origin xyz="0.2 0.1 0" rpy="0 0 0.4"/>
  </joint>
</robot>
"""

MJCF = """<mujoco model="arm">
  <compiler angle="radian"/>
  <default><joint damping="0.3" armature="0.02"/></default>
  <worldbody>
    <!-- the arm -->
    <body name="upper" pos="0 0 0.3" euler="0.1 0.2 0">
      <joint name="shoulder" axis="0 1 0" pos="0.01 0 0"/>
      <inertial pos="0.1 0 0.02" quat="1 0.1 0 0" mass="3" diaginertia="0.02 0.03 0.04"/>
      <body name="fore" pos="0.3 0 0">
        <joint axis="0 0.2 1" frictionloss="0.4"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03"/>
        <body name="tool" pos="0.2 0 0">
          <inertial pos="0.02 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>
        </body>
      </body>
      <body name="side" pos="0 0.2 0.1" quat="0.7 0.7 0.1 0">
        <joint name="slider" type="slide" axis="1 1 0"/>
        <inertial pos="0 0.05 0" mass="0.7" fullinertia="0.01 0.02 0.02 0.001 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/></actuator>
</mujoco>
"""

TOML = """# An arm of two links.
name = "arm"   # a remark
[lengths]
a1 = 0.4

[[joint]]
alpha = "pi/2"
viscous = 0.1
dry = 0.2

[joint.link]
inertia = "principal"
zero = ["ry"]   # by symmetry
mass = 1.0
centre_of_gravity = [0.1, 0, 0.2]
inertia_tensor = [0.1, 0.1, 0.05]

[[joint]]
a = "a1"
viscous = 0.3
dry = 0.4
link = { mass = 2.0, centre_of_gravity = [0, 0, 0], inertia_tensor = [0.1, 0.1, 0.05] }
"""


class Fit(NamedTuple):
    k: Float[np.ndarray, " coefficients"]
    covariance: Float[np.ndarray, "coefficients coefficients"]
    undetermined: Float[np.ndarray, "rows coefficients"]


def parameters_near(network: jc.CSLC, rng: np.random.Generator) -> jc.PhysicalParameters:
    """Coefficients that differ from the file's, and bodies nearest to them."""
    robot = network.robot
    assert robot.links is not None and robot.source is not None
    n = network.joint_count
    k = np.asarray(network.coefficients_from(robot.links, viscous=[1.0] * n, dry=[2.0] * n))
    k = k * rng.uniform(0.8, 1.2, k.shape)
    fit = Fit(k, 1e-4 * np.eye(len(k)), np.zeros((0, len(k))))
    fixed = robot.source.carried
    return jc.physical_parameters(
        network,
        fit,
        fixed=fixed if any(body is not None for body in fixed) else None,
        motors=robot.source.format != "urdf",
    )


@pytest.fixture(params=["arm.urdf", "arm.xml", "arm.toml"])
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    path.write_text({".urdf": URDF, ".xml": MJCF, ".toml": TOML}[path.suffix])
    return path


def changed_lines(before: str, after: str) -> list[str]:
    """Lines of either that are not in the other."""
    difference = difflib.ndiff(before.splitlines(), after.splitlines())
    return [line[2:] for line in difference if line[:2] in ("- ", "+ ")]


def test_the_file_predicts_what_was_found(file: Path, rng: np.random.Generator) -> None:
    network = jc.derive(jc.load_robot(file), lengths="numeric")
    parameters = parameters_near(network, rng)
    written = jc.write_robot(network, parameters, file.with_stem("written"))
    assert written.left_out == ()
    assert np.all(written.largest < _ROUNDING)
    assert np.all(written.rms <= written.largest)
    assert written.robot.links is not None
    k = network.coefficients_from(
        written.robot.links, viscous=written.robot.viscous, dry=written.robot.dry
    )
    np.testing.assert_allclose(np.asarray(k), parameters.k, atol=_ROUNDING)


def test_nothing_else_changes(file: Path, rng: np.random.Generator) -> None:
    """Every line that differs holds a number of a body or a drive; without numbers the text is
    the same but for elements that were missing."""
    network = jc.derive(jc.load_robot(file), lengths="numeric")
    jc.write_robot(network, parameters_near(network, rng), path := file.with_stem("written"))
    before, after = file.read_text(), path.read_text()
    words = {
        ".urdf": "mass|origin|inertia|dynamics|inertial|link name=.fore|</link|elbow",
        ".xml": "inertial|joint",
        ".toml": "viscous|dry|mass|centre_of_gravity|inertia_tensor|motor_inertia|link =",
    }[file.suffix]
    lines = changed_lines(before, after)
    assert lines
    for line in lines:
        assert re.search(words, line), line
    for kept in ("turned on purpose", "'quotes' and > signs", "<visual>", "the arm", "<actuator>"):
        assert (kept in before) == (kept in after)
    for kept in ("# An arm", "# a remark", "# by symmetry", "<limit", "<default>", "euler="):
        assert (kept in before) == (kept in after)


def test_writing_twice_is_writing_once(file: Path, rng: np.random.Generator) -> None:
    network = jc.derive(jc.load_robot(file), lengths="numeric")
    parameters = parameters_near(network, rng)
    written = jc.write_robot(network, parameters, file.with_stem("once"))
    again = jc.derive(written.robot, lengths="numeric")
    jc.write_robot(again, parameters, file.with_stem("twice"))
    assert file.with_stem("twice").read_bytes() == file.with_stem("once").read_bytes()


def test_a_payload_is_no_part_of_the_robot(file: Path, rng: np.random.Generator) -> None:
    """The file is that of the arm without it, and says that it was left out."""
    network = jc.derive(jc.load_robot(file), lengths="numeric")
    loaded = network.with_payload()
    parameters = parameters_near(loaded, rng)
    assert parameters.k.shape == (loaded.size,)
    written = jc.write_robot(loaded, parameters, file.with_stem("loaded"))
    jc.write_robot(network, parameters, file.with_stem("alone"))
    assert written.left_out == loaded.names[loaded.layout.payload]
    assert np.max(written.largest) < _ROUNDING
    assert file.with_stem("loaded").read_bytes() == file.with_stem("alone").read_bytes()


def test_pinocchio_reads_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    """An independent reader of URDF: the bodies in the file move as the parameters say."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    parameters = parameters_near(network, rng)
    jc.write_robot(network, parameters, tmp_path / "written.urdf")
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "written.urdf"))
    data = model.createData()
    q, qd, qdd = rng.uniform(-1, 1, (3, 2))
    # A continuous joint is a point of the circle to Pinocchio.
    theirs = pinocchio.rnea(model, data, np.array([np.cos(q[0]), np.sin(q[0]), q[1]]), qd, qdd)
    friction = np.asarray(network.friction_term(parameters.k, qd))
    mine = np.asarray(network.torque(parameters.k, q, qd, qdd)) - friction
    np.testing.assert_allclose(mine, theirs, atol=1e-9)


def test_fixed_bodies_keep_theirs(tmp_path: Path, rng: np.random.Generator) -> None:
    """The tool is bolted on: its element stays, and the forearm has what remains."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    parameters = parameters_near(network, rng)
    jc.write_robot(network, parameters, tmp_path / "written.urdf")
    tool = re.search(r'<link name="tool">.*?</link>', URDF, re.DOTALL)
    assert tool is not None and tool[0] in (tmp_path / "written.urdf").read_text()
    assert float(parameters.links[1].mass) - float(
        parameters.links_without_fixed[1].mass
    ) == pytest.approx(0.3)


def test_what_urdf_has_no_words_for(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    robot = jc.load_robot(path).with_friction("viscous", "dry", "offset")
    network = jc.derive(robot, lengths="numeric")
    k = rng.uniform(0.5, 1.0, network.size)
    fit = Fit(k, 1e-4 * np.eye(len(k)), np.zeros((0, len(k))))
    assert robot.source is not None
    parameters = jc.physical_parameters(network, fit, fixed=robot.source.carried)
    written = jc.write_robot(network, parameters, tmp_path / "written.urdf")
    assert written.left_out == ("ko1", "ko2")
    assert np.all(written.largest < _ROUNDING)


def test_motor_inertias_of_a_urdf_are_beside_it(tmp_path: Path, rng: np.random.Generator) -> None:
    """Pinocchio, with the URDF's bodies and the file's armature, has the network's torque."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace("elbow", "el&quot;bow"))
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    robot = network.robot
    assert robot.links is not None and robot.source is not None
    links = [dataclasses.replace(link, motor_inertia=0.3 + i) for i, link in enumerate(robot.links)]
    k = np.asarray(network.coefficients_from(links, viscous=[1.0, 1.0], dry=[1.0, 1.0]))
    fit = Fit(k, 1e-8 * np.eye(len(k)), np.zeros((0, len(k))))
    parameters = jc.physical_parameters(network, fit, fixed=robot.source.carried)
    written = jc.write_robot(network, parameters, tmp_path / "written.urdf")
    assert written.motors is not None and written.motors.name == "written.motors.toml"
    assert np.all(written.largest < _ROUNDING)
    model = pinocchio.buildModelFromUrdf(str(written.path))
    for name, inertia in read_motor_inertias(written.motors).items():
        model.armature[model.joints[model.getJointId(name)].idx_v] = inertia
    q, qd, qdd = rng.uniform(-1, 1, (3, 2))
    state = np.array([np.cos(q[0]), np.sin(q[0]), q[1]]), qd, qdd
    theirs = pinocchio.rnea(model, model.createData(), *state)
    friction = np.asarray(network.friction_term(parameters.k, qd))
    mine = np.asarray(network.torque(parameters.k, q, qd, qdd)) - friction
    np.testing.assert_allclose(mine, theirs, atol=1e-9)
    np.testing.assert_allclose(parameters.k, k, atol=1e-3)
    # Without motors the bodies make up for them, and no file is left.
    bare = jc.physical_parameters(network, fit, fixed=robot.source.carried, motors=False)
    assert jc.write_robot(network, bare, tmp_path / "written.urdf").motors is None
    assert not (tmp_path / "written.motors.toml").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[motor_inertia]\nelbow = -1", "motor_inertia, elbow: expected 0 or more, got -1"),
        ("robot = 3", r"expected a table \[motor_inertia\]"),
        ("=", "not valid TOML"),
    ],
)
def test_wrong_files_of_motor_inertias(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "arm.motors.toml").write_text(text)
    with pytest.raises(ValueError, match=f"arm.motors.toml.*{message}"):
        read_motor_inertias(tmp_path / "arm.motors.toml")


def test_what_is_fixed_cannot_be_forgotten(tmp_path: Path, rng: np.random.Generator) -> None:
    """Parameters that leave no body beside the tool are an error, and no file is written."""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    light = jc.LinkParameters(0.1, np.zeros(3), 1e-4 * np.eye(3))
    k = np.asarray(network.coefficients_from([light, light]))
    parameters = jc.physical_parameters(
        network, Fit(k, 1e-8 * np.eye(len(k)), np.zeros((0, len(k)))), (light, light)
    )
    with pytest.raises(jc.RobotError, match="'fore' without the bodies that the file has fixed"):
        jc.write_robot(network, parameters, tmp_path / "written.urdf")
    assert [entry.name for entry in tmp_path.iterdir()] == ["arm.urdf"]


PER_JOINT = TOML.replace('name = "arm"', 'friction = ["viscous", "dry", "static"]\nname = "arm"')


def test_words_of_some_joints(tmp_path: Path, rng: np.random.Generator) -> None:
    """TOML takes viscous friction of all joints or none: here none, and dry of all. Slopes of
    static friction go where the term is."""
    path = tmp_path / "arm.toml"
    words = 'friction = ["asymmetric_viscous", "dry"]\na = "a1"'
    text = PER_JOINT.replace('a = "a1"', words)
    path.write_text(text.replace("viscous = 0.1\n", "").replace("viscous = 0.3\n", ""))
    network = jc.derive(jc.load_robot(path), lengths="numeric").with_static_slopes([7.5, 1.0])
    k = rng.uniform(0.5, 1.0, network.size)
    parameters = jc.physical_parameters(
        network, Fit(k, 1e-4 * np.eye(len(k)), np.zeros((0, len(k))))
    )
    written = jc.write_robot(network, parameters, tmp_path / "written.toml")
    assert written.left_out == ("kv1", "ks1", "kvp2", "kvn2")
    assert np.all(written.largest < _ROUNDING)
    assert written.robot.viscous is None
    np.testing.assert_allclose(written.robot.dry or (), parameters.friction["dry"])
    assert written.robot.static_slopes is not None and written.robot.static_slopes[0] == 7.5
    assert written.path.read_text().count("static_slope") == 1


def test_words_that_only_the_network_has(tmp_path: Path, rng: np.random.Generator) -> None:
    """Nothing is written that the file's friction model forbids."""
    path = tmp_path / "arm.toml"
    dry = re.compile(r"^dry = .*\n", re.MULTILINE)
    path.write_text(dry.sub("", TOML.replace('name = "arm"', 'friction = ["viscous"]\nname="arm"')))
    robot = jc.load_robot(path).with_friction("viscous", "dry", "static")
    network = jc.derive(robot, lengths="numeric")
    k = rng.uniform(0.5, 1.0, network.size)
    parameters = jc.physical_parameters(
        network, Fit(k, 1e-4 * np.eye(len(k)), np.zeros((0, len(k))))
    )
    written = jc.write_robot(network, parameters, tmp_path / "written.toml")
    assert written.left_out == ("kd1", "kd2", "ks1", "ks2")
    assert np.all(written.largest < _ROUNDING)
    assert "static_slope" not in written.path.read_text()
    np.testing.assert_allclose(written.robot.viscous or (), parameters.friction["viscous"])


def test_folders(file: Path, rng: np.random.Generator) -> None:
    """Missing ones are made; errors name what was asked for and not what is written first."""
    network = jc.derive(jc.load_robot(file), lengths="numeric")
    parameters = parameters_near(network, rng)
    written = jc.write_robot(network, parameters, file.parent / "some" / "where" / file.name)
    there = {entry.name for entry in written.path.parent.iterdir()}
    assert there == {file.name, ".jaxcslc"}
    taken = file.parent / f"taken{file.suffix}"
    taken.mkdir()
    with pytest.raises(OSError, match=f"'{taken}'") as caught:
        jc.write_robot(network, parameters, taken)
    assert ".unfinished" not in str(caught.value)


class TestXmlEdits:
    def test_no_change_is_no_change(self) -> None:
        assert XmlEdits(URDF.encode()).text() == URDF.encode()

    def test_attributes(self) -> None:
        text = b"""<a><b  x = '1' y="2>3" >text</b ><c/></a>"""
        root = parse_xml(text, "test")
        edits = XmlEdits(text)
        edits.set(root.children[0], {"x": "4", "new": "5"}, without=("y", "absent"))
        edits.set(root.children[1], {"z": "6"})
        assert edits.text() == b"""<a><b  x = '4' new="5" >text</b ><c z="6"/></a>"""

    def test_new_elements_are_indented(self) -> None:
        text = b"<a>\n  <b/>\n  <c>\n      <d/>\n  </c>\n</a>"
        root = parse_xml(text, "test")
        edits = XmlEdits(text)
        edits.insert(root.children[0], "<new>\n  <inner/>\n</new>")
        edits.insert(root.children[1], "<new/>")
        assert edits.text().decode().splitlines() == [
            *("<a>", "  <b>", "    <new>", "      <inner/>", "    </new>", "  </b>"),
            *("  <c>", "      <new/>", "      <d/>", "  </c>", "</a>"),
        ]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace('name="arm"', 'name="arm" x="1"'), None),
        (
            lambda text: text.replace("</worldbody>", "</worldbody>").replace(
                '<joint name="slider"', '<joint name="extra" axis="0 0 1"/>\n<joint name="slider"'
            ),
            "body 'side' has several joints",
        ),
    ],
)
def test_bodies_of_several_joints_are_refused(
    change: Callable[[str], str], words: str | None, tmp_path: Path, rng: np.random.Generator
) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(change(MJCF))
    network = jc.derive(jc.load_robot(path), lengths="numeric")
    parameters = parameters_near(network, rng)
    if words is None:
        jc.write_robot(network, parameters, tmp_path / "written.xml")
        return
    with pytest.raises(jc.RobotError, match=words):
        jc.write_robot(network, parameters, tmp_path / "written.xml")
    assert not (tmp_path / "written.xml").exists()


def test_wrong_files(puma: jc.CSLC, puma_k: Any, tmp_path: Path) -> None:
    k = np.asarray(puma_k)
    fit = Fit(k, 1e-4 * np.eye(len(k)), np.zeros((0, len(k))))
    parameters = jc.physical_parameters(puma, fit)
    with pytest.raises(jc.RobotError, match="was read from no file"):
        jc.write_robot(puma, parameters, tmp_path / "puma.toml")
    path = tmp_path / "arm.toml"
    path.write_text(TOML)
    network = jc.derive(jc.load_robot(path))
    with pytest.raises(jc.RobotError, match=r"expected a name ending in \.toml"):
        jc.write_robot(network, parameters, tmp_path / "arm.urdf")

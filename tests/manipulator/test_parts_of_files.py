"""Files as they come: grippers, joints that mimic, several arms, floating bases, exporters' slips.

A joint that is fixed is compared with the same file in which it is a fixed joint.
"""

from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import Manipulator
from tests.conftest import run
from tests.manipulator.test_hostile_files import ARM, BODY, joint, link, mjcf, notes, urdf


MIMIC = '<mimic joint="left" multiplier="-1"/>'
OFF_AXIS = '<origin xyz="0.3 0.1 0.2" rpy="0.1 0.2 0.3"/>'


def gripper(kind: str = "continuous", mimic: str = MIMIC) -> str:
    """A shoulder, and on its link a hand with two fingers, the right one mimicking the left."""
    return urdf(
        *ARM,
        link("palm", "0.5"),
        joint("wrist", "b", "palm", kind, OFF_AXIS),
        link("finger"),
        joint("left", "palm", "finger", kind, OFF_AXIS),
        link("thumb", "2"),
        joint("right", "palm", "thumb", kind, mimic if kind != "fixed" else ""),
    )


def names(robot: Manipulator) -> tuple[str, ...]:
    assert robot.source is not None
    return robot.source.joints


def are_the_same(first: Manipulator, second: Manipulator) -> None:
    assert first.joints == second.joints
    assert first.links is not None and second.links is not None
    for one, other in zip(first.links, second.links, strict=True):
        np.testing.assert_allclose(one.mass, other.mass)
        np.testing.assert_allclose(one.first_moment, other.first_moment, atol=1e-15)
        np.testing.assert_allclose(one.inertia_at_frame, other.inertia_at_frame, atol=1e-15)


@pytest.mark.parametrize("fix", ["palm", ("wrist", "left", "right"), ("wrist", "left"), "[!j]*"])
def test_a_gripper_that_is_fixed(tmp_path: Path, fix: str | tuple[str, ...]) -> None:
    """By its body, by its joints, by those that others mimic, or by a pattern."""
    path, fixed = tmp_path / "arm.urdf", tmp_path / "fixed.urdf"
    path.write_text(gripper())
    fixed.write_text(gripper("fixed"))
    robot = jc.load_robot(path, fix=fix if fix != "[!j]*" else ("[!j]*t", "palm"))
    assert names(robot) == ("j",)
    assert robot.source is not None and robot.source.carried[0] is not None
    are_the_same(robot, jc.load_robot(fixed))
    said = [note for note in notes(robot) if "joint 'right' follows one that is fixed" in note]
    assert len(said) == (fix == ("wrist", "left"))


def test_what_mimics_can_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(gripper())
    with pytest.raises(jc.RobotError, match=r"'right' mimics 'left'; .*--mimic couple.*--fix left"):
        jc.load_robot(path)
    assert names(jc.load_robot(path, fix="right")) == ("j", "wrist", "left")
    are_the_same(jc.load_robot(path, mimic="fix"), jc.load_robot(path, fix="left"))
    with pytest.raises(
        jc.RobotError, match=r"fix 'grip' matches no body and no joint; its joints are j,"
    ):
        jc.load_robot(path, fix="grip")
    path.write_text(gripper(mimic='<mimic joint="nobody"/>'))
    assert names(jc.load_robot(path, tip="palm")) == ("j", "wrist")


def test_the_command_fixes_and_has_several_tips(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(gripper())
    result = run("derive", path, "--fix", "left,right", "--lengths", "numeric")
    assert result.exit_code == 0 and "r: 2 joints" in result.output, result.output
    both = run("derive", path, "--tip", "finger", "--tip", "palm", "--fix", "wrist")
    assert both.exit_code == 0 and "r: 2 joints" in both.output, both.output
    path.write_text(urdf(link("w"), joint("f", "w", "a", "floating"), *ARM))
    floating = run("derive", path)
    assert floating.exit_code == 0, floating.output
    assert "note: " in floating.output
    assert "joint 'f' is floating: link 'a' is taken as fixed to the base" in floating.output
    refused = run("derive", "puma560", "--fix", "wrist")
    assert refused.exit_code == 2 and "mimic choose a part of a file" in refused.stderr


def test_two_arms_are_a_tree(tmp_path: Path) -> None:
    """The tree between the base and both tips, and nothing else of the file."""
    path = tmp_path / "arms.xml"
    hand = BODY.format("{0} hand", "{0} wrist", "hinge", "")
    arm = BODY.format("{0} arm", "{0} shoulder", "hinge", hand)
    head = BODY.format("head", "neck", "ball", "")
    parts = arm.format("left") + head + arm.format("right")
    path.write_text(mjcf(BODY.format("torso", "waist", "hinge", parts)))
    robot = jc.load_robot(path, tip=["left hand", "right arm"])
    assert names(robot) == ("waist", "left shoulder", "left wrist", "right shoulder")
    assert robot.parents == (-1, 0, 1, 0)
    assert names(jc.load_robot(path, fix="neck")) == (*names(robot), "right wrist")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_base_that_floats_is_taken_as_fixed(tmp_path: Path, kind: str) -> None:
    path, fixed = tmp_path / "arm.urdf", tmp_path / "fixed.urdf"
    for file, how in ((path, kind), (fixed, "fixed")):
        file.write_text(urdf(link("w"), joint("float", "w", "a", how, OFF_AXIS), *ARM))
    robot = jc.load_robot(path)
    (note,) = notes(robot)
    assert f"joint 'float' is {kind}" in note
    are_the_same(robot, jc.load_robot(fixed))
    free = tmp_path / "free.xml"
    arm = '<body name="arm"><joint name="j"/><geom size="0.1"/></body>'
    free.write_text(
        mjcf(f'<body name="torso"><freejoint name="root"/><geom size="0.1"/>{arm}</body>')
    )
    robot = jc.load_robot(free)
    assert names(robot) == ("j",)
    assert notes(robot) == (f"{free}: body 'torso' floats; it is taken as fixed",)


def test_what_is_repeated_in_an_inertia_is_said(tmp_path: Path) -> None:
    """The first one counts, and lines of what comes after keep their numbers."""
    path, once = tmp_path / "arm.urdf", tmp_path / "once.urdf"
    inertia = '<inertial><origin xyz="0.1 0 0"/>\n{}<mass value="1"/>'
    twice = link("b").replace('<inertial><mass value="1"/>', inertia)
    path.write_text(urdf(ARM[0], twice.format('\n<origin xyz="9 9 9"/>\n'), ARM[2]))
    once.write_text(urdf(ARM[0], twice.format(""), ARM[2]))
    robot = jc.load_robot(path)
    assert notes(robot) == (
        f"{path}, line 3: <origin> is repeated in the inertial of link 'b'; the first one is taken",
    )
    are_the_same(robot, jc.load_robot(once))


def test_geometry_is_not_looked_at(tmp_path: Path) -> None:
    """Meshes of packages that are not there, and whatever else is in visual and collision."""
    path = tmp_path / "arm.urdf"
    mesh = '<geometry><mesh filename="package://x/y.dae"/></geometry>'
    looks = f"<visual><origin/><origin/>{mesh}</visual>"
    path.write_text(urdf(ARM[0].replace("<inertial>", f"{looks}<inertial>"), *ARM[1:]))
    assert not notes(jc.load_robot(path))

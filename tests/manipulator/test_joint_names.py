"""Joints are called what the robot's file calls them, from the file to tables of results."""

from pathlib import Path

import pytest

import jaxcslc as jc
from jaxcslc.report import DerivationReport


TWO_JOINTS = """
name = "arm"
[[joint]]
{first}
[[joint]]
{second}
a = 0.5
"""


def arm(folder: Path, first: str = "", second: str = "") -> jc.Manipulator:
    path = folder / "arm.toml"
    path.write_text(TWO_JOINTS.format(first=first, second=second))
    return jc.load_robot(path)


def test_names_of_the_file(tmp_path: Path) -> None:
    robot = arm(tmp_path, 'name = "shoulder"', 'name = "elbow"')
    assert robot.joint_names == ("shoulder", "elbow") and robot.has_joint_names
    network = jc.derive(robot, lengths="numeric")
    assert network.output_labels == network.output_names == ("shoulder", "elbow")
    assert "joints: 1 shoulder, 2 elbow" in str(DerivationReport.of(network))


def test_numbers_where_a_file_names_nothing(tmp_path: Path) -> None:
    robot = arm(tmp_path)
    assert robot.joint_names == ("joint 1", "joint 2") and not robot.has_joint_names
    network = jc.derive(robot, lengths="numeric")
    assert network.output_labels == ("1", "2")
    assert network.output_names == ("joint 1", "joint 2")
    assert "joints:" not in str(DerivationReport.of(network))
    assert arm(tmp_path, second='name = "elbow"').joint_names == ("joint 1", "elbow")


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("name = 3", "", "joint 1, name: expected a text, got 3"),
        ("", 'name = " "', "joint 2, name: expected a text, got ' '"),
        ('name = "a"', 'name = "a"', "joint 2, name: joint 1 is 'a' too"),
    ],
)
def test_wrong_names(tmp_path: Path, first: str, second: str, expected: str) -> None:
    with pytest.raises(jc.RobotError, match=expected):
        arm(tmp_path, first, second)

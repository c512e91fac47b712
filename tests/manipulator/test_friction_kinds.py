"""Kinds of friction and coupled joints, as arguments and in robot files."""

from pathlib import Path
from typing import Any

import pytest

import jaxcslc as jc
from jaxcslc.manipulator import Coupling


ROWS = [(0, 0, 0, 0), ("pi/2", 0.1, 0, 0), (0, 0.2, 0, 0)]
FILE = """
friction = ["viscous", "dry"]
coupled = [[1, 2], [2, 3, -1.5]]

[[joint]]

[[joint]]
alpha = "pi/2"
friction = ["viscous", "asymmetric_dry", "static"]
static_slope = 4

[[joint]]
a = 0.2
"""


def test_a_file_says_it_all(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(FILE)
    robot = jc.load_robot(path)
    assert robot.friction_per_joint[1] == ("viscous", "asymmetric_dry", "static")
    assert robot.friction_per_joint[2] == ("viscous", "dry")
    assert robot.friction_terms == ("viscous", "dry", "asymmetric_dry", "static")
    assert robot.coupled == (Coupling(1, 2), Coupling(2, 3, -1.5))
    assert robot.static_slopes == (10.0, 4.0, 10.0)
    network = jc.derive(robot, lengths="numeric")
    assert network.names[-14:] == (
        *("kv1", "kv2", "kv3", "kd1", "kd3", "kdp2", "kdn2", "ks2"),
        *("kcm1_2", "kcm2_3", "kcv1_2", "kcv2_3", "kcd1_2", "kcd2_3"),
    )
    assert network.static_slopes is not None
    assert network.static_slopes.tolist() == [10.0, 4.0, 10.0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[1, 2], [2, 3, -1.5]]", "[5, 6]", "coupled: expected a list of pairs of joints, got"),
        ("[2, 3, -1.5]", "[2, 4]", "coupled: there is no joint 4; expected 1 to 3"),
        ("[2, 3, -1.5]", "[2, 2]", "coupled: joint 2 is paired with itself"),
        ("[2, 3, -1.5]", "[2, 1]", "coupled: joints 2 and 1 are paired twice"),
        ("[2, 3, -1.5]", "[2, 3, 0]", "coupled: expected a ratio other than 0, got 0"),
        ("[2, 3, -1.5]", '["2", 3]', "coupled: expected pairs of joints, as in"),
        ("static_slope = 4", "static_slope = 0", "joint 2, static_slope: expected a number above"),
        (
            '"static"]',
            '"offset"]',
            "joint 2: friction terms offset and asymmetric_dry exclude each other:",
        ),
        ('"asymmetric_dry", "static"', '"dry"', "joint 2, static_slope: the joint has no static"),
        ('"asymmetric_dry", ', '"slip", ', "joint 2: unknown friction term 'slip'; expected some"),
        (
            '["viscous", "dry"]',
            '["viscous", "asymmetric_viscous"]',
            "friction terms viscous and asymmetric_viscous exclude each other: asymmetric_viscous",
        ),
        (
            '["viscous", "dry"]',
            '["asymmetric_dry", "dry"]',
            "friction terms dry and asymmetric_dry exclude each other: asymmetric_dry",
        ),
    ],
)
def test_mistakes(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert FILE.count(old) == 1
    path = tmp_path / "arm.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(jc.RobotError) as error:
        jc.load_robot(path)
    (line,) = str(error.value).splitlines()
    assert str(path) in line
    assert message in line


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda robot: robot.with_friction("dry", joint=4), "there is no joint 4; expected 1 to 3"),
        (lambda robot: robot.with_friction("grease"), "unknown friction term 'grease'"),
        (lambda robot: robot.with_coupling((1, 3)), "joints 1 and 3 are revolute and prismatic"),
        (lambda robot: robot.with_static_slopes([1.0]), "expected 3 entries of static_slopes"),
        (lambda robot: robot.with_static_slopes([1.0, -1.0, 1.0]), "joint 2, static_slope: expect"),
    ],
)
def test_refused(change: Any, message: str) -> None:
    robot = jc.Manipulator.from_modified_dh(ROWS, kinds="RRP", name="arm")
    with pytest.raises(jc.RobotError, match=f"robot 'arm'.*{message}"):
        change(robot)


def test_tx40_is_as_its_file_says() -> None:
    robot = jc.tx40()
    assert robot.kinds == "RRRRRR"
    assert robot.coupled == (Coupling(5, 6),)
    assert jc.derive(robot, lengths="numeric").size == 40 + 4 * 6 + 3
    assert robot.with_coupling().coupled == ()

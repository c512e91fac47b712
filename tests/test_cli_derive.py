"""The command `derive`: what it prints and writes, and the options it adds to a robot's file."""

import json
from pathlib import Path

from tests.conftest import run


def test_derive_prints_the_thesis_counts(tmp_path: Path) -> None:
    result = run("derive", "puma560", "-o", tmp_path / "tables")
    assert result.exit_code == 0, result.output
    assert "mass: 59 inputs, 114 links, 26 coefficients" in result.output
    assert "velocity: 86 inputs, 408 links, 19 coefficients" in result.output
    assert "gravity: 9 inputs, 13 links, 5 coefficients" in result.output
    assert "network order 28; per joint 22, 28, 22, 13, 11, 4" in result.output
    tables = json.loads((tmp_path / "tables" / "tables.json").read_text())
    assert len(tables["mass"]["links"]) == 114
    assert tables["velocity"]["inputs"][0] == "1"
    names = (tmp_path / "tables" / "coefficients.csv").read_text().splitlines()
    assert len(names) == 44
    assert names[0] == "name,group,unit,positive,expression"


def test_derive_reads_a_robot_file(tmp_path: Path) -> None:
    robot = tmp_path / "arm.toml"
    robot.write_text('[[joint]]\n[[joint]]\nalpha = "pi/2"\na = 0.3\n')
    result = run("derive", robot, "--lengths", "numeric")
    assert result.exit_code == 0, result.output
    assert "kB1" in result.output


URDF = (
    '<robot name="arm"><link name="floor"/><link name="bar"><inertial><mass value="2"/>'
    '<origin xyz="0.5 0 0"/><inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/>'
    '</inertial></link><link name="tip"/><joint name="hinge" type="continuous">'
    '<parent link="floor"/><child link="bar"/><axis xyz="0 1 0"/></joint>'
    '<joint name="wrist" type="continuous"><parent link="bar"/><child link="tip"/>'
    '<origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint></robot>'
)


def test_a_urdf_with_what_its_file_has_no_words_for(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    result = run("derive", path, "--friction", "viscous, static", "--coupled", "1,2")
    assert result.exit_code == 0, result.output
    for name in ("kv2", "ks1", "kcm1_2"):
        assert name in result.output
    assert "kd1" not in result.output
    part = run("derive", path, "--tip", "bar")
    assert "arm: 1 joint," in part.output
    for pair in ("one,two", "inf,2", "1.5,2", "1"):
        wrong = run("derive", path, "--coupled", pair)
        assert wrong.exit_code == 2
        assert f"--coupled: expected two joints, as in 5,6, or 5,6,-1, got '{pair}'" in wrong.stderr
    wrong = run("derive", path, "--coupled", "one,two")
    assert wrong.exit_code == 2


def test_a_long_chain_is_derived_without_its_tables(tmp_path: Path) -> None:
    """Counting the tables of ten parallel axes would take longer than everything else."""
    path = tmp_path / "long.toml"
    path.write_text('name = "long"\n' + "[[joint]]\na = 0.1\n" * 10)
    result = run("derive", path, "--lengths", "numeric", "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "no closed-form tables: for more than 9 joints" in result.output
    assert not (tmp_path / "out" / "tables.json").exists()


def test_numbers_that_no_machine_word_holds(tmp_path: Path) -> None:
    """TOML's integers have any length: those beyond all robots are named."""
    path = tmp_path / "arm.toml"
    path.write_text("[[joint]]\nviscous = 99999999999999999999999999\n[[joint]]\nviscous = 1\n")
    result = run("derive", path)
    assert result.exit_code == 2
    assert "joint 1, viscous: expected a finite number" in result.output

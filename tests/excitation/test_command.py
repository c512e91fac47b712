"""`jaxcslc excite`: what it writes, what it says of earlier recordings, wrong arguments."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._excite import _Before, _noise
from jaxcslc.excitation import Knowledge, Limits
from tests.conftest import run


ARM = """
name = "pendulum"
gravity = [0.0, -9.81, 0.0]
friction = ["viscous"]
lengths = {}
"""
LIMITS = """
[joints]
position = [-2.0, 2.0]
velocity = 3.0
torque = 30.0
"""
OPTIONS = ("--duration", "2", "--starts", "1", "--rate", "100", "--torque-noise", "0.1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pendulum's URDF, limits, and a recording of a lazy motion."""
    folder = tmp_path_factory.mktemp("excite")
    (folder / "arm.urdf").write_text(
        """<robot name="pendulum"><link name="base"/><link name="rod"><inertial>
        <origin xyz="0.3 0.1 0"/><mass value="2"/>
        <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/>
        <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="30"/></joint>
        </robot>"""
    )
    robot = jc.load_robot(folder / "arm.urdf")
    network = jc.derive(robot, lengths="numeric")
    t = np.arange(1000)[:, None] * 0.01
    q, qd, qdd = 0.3 * np.sin(t), 0.3 * np.cos(t), -0.3 * np.sin(t)
    k = np.asarray(network.coefficients_from(robot.links or (), viscous=[0.2], dry=[0.3]))
    torque = np.asarray(network.torque(jnp.asarray(k), q, qd, qdd))
    torque = torque + 0.1 * np.random.default_rng(0).normal(size=torque.shape)
    jc.save_recording(jc.Recording(t[:, 0], q, torque), folder / "lazy.csv")
    return folder


def test_writes_the_motion_in_five_forms(folder: Path) -> None:
    result = run("excite", folder / "arm.urdf", "-o", folder / "motion.csv", *OPTIONS)
    assert result.exit_code == 0, result.output
    assert "predicted standard errors: median" in result.output
    lines = (folder / "motion.csv").read_text().splitlines()
    assert lines[0] == "time,position_hinge,velocity_hinge,acceleration_hinge"
    table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
    assert table.shape == (201, 4)
    np.testing.assert_allclose(np.gradient(table[:, 1], 0.01)[1:-1], table[1:-1, 2], atol=0.02)
    assert "JointTrajectory" not in (folder / "motion.yaml").read_text()
    assert (folder / "motion.yaml").read_text().count("time_from_start") == 201
    assert "pendulum_motion[201][1]" in (folder / "motion.h").read_text()
    page = (folder / "motion.html").read_text()
    assert "Predicted errors" in page
    assert "Margins" in page
    marks = re.findall(r'\bid="([^"]+)"', re.sub(r"(?s)<script.*?</script>", "", page))
    assert len(marks) == len(set(marks))  # a link to one of two would find the first


def test_the_trajectory_is_yaml_and_json(folder: Path) -> None:
    yaml: Any = pytest.importorskip("ruamel.yaml")
    document = yaml.YAML(typ="safe").load((folder / "motion.yaml").read_text())
    assert document["joint_names"] == ["hinge"]
    assert document["points"][100]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert json.loads((folder / "motion.json").read_text()) == document


def test_offsets_that_the_model_has_are_no_noise() -> None:
    robot = jc.examples.planar_arm().with_friction("viscous", "asymmetric_dry", joint=2)
    network = jc.derive(robot, lengths="numeric")
    before = _Before(network, Knowledge.of_robot(network))
    limits = Limits.of(robot, {"position": [-1, 1], "velocity": 1, "torque": [30, 20]})
    assert _noise(before, limits, {}).offset == (0.3, 0.0)
    assert _noise(before, limits, {"torque": (0.5,)}).offset == (0.5, 0.0)
    assert _noise(before, limits, {"offset": (0.1, 0.1)}).offset == (0.1, 0.1)


def test_says_what_more_seconds_buy(folder: Path) -> None:
    arguments = ("excite", folder / "arm.urdf", "--after", folder / "lazy.csv")
    result = run(*arguments, "-o", folder / "next.csv", *OPTIONS, "--reach", "1")
    assert result.exit_code == 0, result.output
    assert "2 s more are predicted to bring" in result.output
    assert "standard error" in result.output
    assert "1 % (--target) takes about" in result.output
    done = run(*arguments, "-o", folder / "none.csv", *OPTIONS, "--reach", "100000")
    assert "nothing to record" in done.output
    assert not (folder / "none.csv").exists()


def test_percentages_are_those_that_identify_has(folder: Path) -> None:
    """Errors before the motion are the column of standard errors over values, not over sizes."""
    arm, results = folder / "arm.urdf", folder / "results"
    assert run("identify", arm, folder / "lazy.csv", "-o", results).exit_code == 0
    with (results / "coefficients.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    result = run("excite", arm, "--previous", results, "-o", folder / "next.csv", *OPTIONS)
    gains = re.findall(r"  (\w+): standard error (\S+) % of the value, then", result.output)
    assert len(gains) > 1
    for name, percent in gains:
        assert percent == f"{100 * float(rows[name]['relative_error']):.2g}", name


def test_a_motion_for_a_payload(folder: Path) -> None:
    """One joint feels two sums of its coefficients: they gain, the arm's do not count."""
    arguments = ("excite", folder / "arm.urdf", "--after", folder / "lazy.csv", *OPTIONS)
    result = run(*arguments, "-o", folder / "payload.csv", "--payload", "1.5")
    assert result.exit_code == 0, result.output
    assert "phx: not determined, then " in result.output
    assert "not determined by this motion: pIxx" in result.output
    assert "pIxx: interval" not in result.output  # to ±2e+05 %, say
    assert re.search(r"torque [\d.]+ % \(hinge\)", result.output)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--family", "waves"), "--family: expected splines"),
        (("--criterion", "best"), "--criterion: expected overall"),
        (("--start", "a"), "--start: expected numbers as in 0.1,0.2, got 'a'"),
        (("--start", "1,2"), "start: expected 1 positions"),
        (("--limits", "none.toml"), "none.toml: no such file of limits"),
        (("--for", "kd9"), "has no coefficient or group 'kd9'"),
        (("--payload", "-1"), "--payload: expected a number from 0 on, got '-1'"),
        (("--starts", "0"), "--starts: expected a whole number from 1 on, got '0'"),
        (("--duration", "0"), "--duration: expected a number above 0, got '0'"),
        (("-o", "motion.txt"), "expected a name that ends in .csv"),
    ],
)
def test_wrong_options_are_one_line(folder: Path, options: tuple[str, ...], message: str) -> None:
    output = ("-o", folder / "wrong.csv") if "-o" not in options else ()
    result = run("excite", folder / "arm.urdf", *OPTIONS, *output, *options)
    assert result.exit_code == 2
    assert message in result.stderr


def test_says_which_collisions_it_looked_for(folder: Path) -> None:
    """The pendulum hangs beside its base and reaches 0.3 m below it."""
    arguments = ("excite", folder / "arm.urdf", "-o", folder / "floor.csv", *OPTIONS)
    result = run(*arguments, "--no-floor")
    assert "collisions: there are no bodies to be kept apart" in result.output
    assert "collisions were not looked for with a floor;" in result.output
    assert "Collisions were not looked for with a floor;" in (folder / "floor.html").read_text()

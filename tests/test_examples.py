"""Examples: what `jaxcslc example` writes has the truth beside it, and the next commands work."""

import csv
import json
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._example import next_commands
from tests.conftest import run


def assert_truth_is_found(folder: Path) -> list[bool]:
    """Intervals of 95 % of `results` hold at least nine of ten true coefficients; return which."""
    truth = json.loads((folder / "truth.json").read_text())["coefficients"]
    with (folder / "results" / "coefficients.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["name"] in truth]
    inside = [float(row["low"]) <= truth[row["name"]] <= float(row["high"]) for row in rows]
    assert len(inside) > 30 and np.mean(inside) > 0.9
    return inside


@pytest.fixture(scope="module", params=jc.examples.ARMS)
def example(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path, str]:
    """An arm, the folder that `jaxcslc example` wrote, and what it printed."""
    folder = tmp_path_factory.mktemp("example")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        printed = run("example", request.param)
    assert printed.exit_code == 0, printed.output
    return request.param, folder / request.param, printed.output


def test_the_next_commands_run(
    example: tuple[str, Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And find the truth. Those of the Panda and the UR5 run with the README and the tutorial."""
    arm, folder, printed = example
    enter, *commands = next_commands(Path(arm), jc.examples.ARMS[arm].file)
    assert all(command in printed for command in (enter, *commands))
    if arm in ("panda", "ur5"):
        return
    monkeypatch.chdir(folder)
    for command in commands:
        if " excite " not in command:  # half a minute; its own tests run it
            result = run(*command.split()[1:])
            assert result.exit_code == 0, result.output
    assert_truth_is_found(folder)


def test_the_next_commands_find_the_servos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals hold nine of ten true parameters; MuJoCo and a C compiler read the files."""
    monkeypatch.chdir(tmp_path)
    printed = run("example", "so101")
    assert printed.exit_code == 0, printed.output
    enter, *commands = next_commands(Path("so101"), "so101.urdf")
    assert all(command in printed.output for command in (enter, *commands))
    monkeypatch.chdir(tmp_path / "so101")
    for command in commands[:2]:
        result = run(*command.split()[1:])
        assert result.exit_code == 0, result.output
    viewer, compiler = (command.split() for command in commands[2:])
    assert mujoco.MjModel.from_xml_path(viewer[-1].partition("=")[2]).nu == 6
    subprocess.run(compiler, check=True)
    truth = json.loads(Path("truth.json").read_text())["drives"]
    inside: list[bool] = []
    with Path("known_gains/parameters.csv").open() as file:
        for row in csv.DictReader(file):
            name, _, over = row["parameter"].partition("/")
            drive = truth[row["joint"]]
            true = drive.get(name, 0.0) / (drive["gain"] if over else 1.0)
            inside.append(float(row["low"]) <= true <= float(row["high"]))
    assert len(inside) > 30 and np.mean(inside) > 0.85
    known = json.loads(Path("known_gains/servo.json").read_text())["drives_for_simulation"]
    assert [x["gain"] for x in known.values()] == [x["gain"] for x in truth.values()]
    document = json.loads(Path("results/servo.json").read_text())
    assert document["position_error_mrad"][-1]["simulation"] < 2.0


def test_the_files_are_the_same_in_every_run(tmp_path: Path) -> None:
    first, second = (jc.examples.write_example("ur5", tmp_path / name) for name in "ab")
    assert first.train.read_bytes() == second.train.read_bytes()
    assert first.train.read_bytes() != first.validation.read_bytes()


def test_motion_is_within_the_limits_of_the_file(example: tuple[str, Path, str]) -> None:
    arm, folder, _ = example
    robot = jc.load_robot(folder / jc.examples.ARMS[arm].file)
    for name in ("train.csv", "validation.csv"):
        recording = jc.load_recording(folder / name, joints=robot.joint_count)
        speed = np.gradient(recording.position, recording.time, axis=0)
        for joint, limit in enumerate(robot.joint_limits):
            position = recording.position[:, joint]
            assert limit.low < position.min() and position.max() < limit.high
            assert np.abs(speed[:, joint]).max() < limit.speed
            assert np.abs(recording.torque[:, joint]).max() < limit.torque


def test_a_folder_with_files_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    result = run("example", "panda", "-o", tmp_path)
    assert result.exit_code == 2 and "as mine.txt; expected a new folder" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_an_unknown_arm_is_named() -> None:
    with pytest.raises(ValueError, match="there is no example 'kuka'; expected one of panda"):
        jc.examples.write_example("kuka", "nowhere")

"""`jaxcslc identify --drive servo`: from files to a report, a MuJoCo model and C code."""

import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import fixed_together, seen_from
from jaxcslc.servo import ServoDrive, load_servo_recordings, replay_in_mujoco, simulate
from tests.conftest import run
from tests.servo.conftest import ARM
from tests.servo.test_lerobot import write_data_set


DRIVES = [
    ServoDrive(8.0, 0.4, delay=0.04, armature=0.01, coulomb=0.08),
    ServoDrive(6.0, 0.3, delay=0.04, armature=0.008, coulomb=0.05),
]
STEP = 2.0 * np.pi / 4096  # of encoders [rad]
PERIOD = 1.0 / 30.0  # of LeRobot's data sets [s]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm's file, and a data set of 20 episodes of it in degrees, with 12-bit encoders."""
    folder = tmp_path_factory.mktemp("servos")
    (folder / "arm.urdf").write_text(ARM)
    robot = jc.load_robot(folder / "arm.urdf")
    rng = np.random.default_rng(0)
    commands: list[np.ndarray] = []
    positions: list[np.ndarray] = []
    time = np.arange(150) * PERIOD
    for _ in range(20):
        phase, pace = rng.uniform(0, 2 * np.pi, (2, 2)), rng.uniform(0.5, 3.0, (2, 2))
        waves = np.sin(pace[:, None] * time[:, None] + phase[:, None])  # (wave, time, joint)
        command = 0.8 * waves[0] + 0.4 * waves[1]
        position = simulate(robot, DRIVES, time, command, command[0])
        commands.append(np.degrees(command))
        positions.append(np.degrees(np.round(position / STEP) * STEP))
    write_data_set(folder / "set", commands, positions, names=["shoulder.pos", "elbow.pos"])
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> Path:
    result = run(
        *("identify", folder / "arm.urdf", folder / "set", "--drive", "servo"),
        *("--units", "degrees", "-o", folder / "results"),
    )
    assert result.exit_code == 0, result.output
    assert "20 episodes" not in result.output
    assert "position error [mrad RMS], open loop over 4 recordings (held out)" in result.output
    return folder / "results"


def test_a_data_set_of_twenty_episodes(results: Path) -> None:
    """Simulated positions of four held-out episodes are within encoder steps of those measured."""
    document = json.loads((results / "servo.json").read_text("utf-8"))
    assert len(document["training"]) == 16
    assert document["held_out"] == [f"set: episode {k}" for k in range(16, 20)]
    everything = document["position_error_mrad"][-1]
    assert everything["joint"] == "all"
    assert everything["simulation"] < 1e3 * STEP
    assert everything["MuJoCo"] < 2e3 * STEP
    assert everything["command"] > 20.0
    ratios = [
        d["gain"] / t.gain
        for d, t in zip(document["drives_for_simulation"].values(), DRIVES, strict=True)
    ]
    np.testing.assert_allclose(ratios, 1.0, atol=0.1)


def test_the_files(folder: Path, results: Path) -> None:
    """The errors of the report are those of its MuJoCo model; the page has charts and a link."""
    names = {path.name for path in results.iterdir()}
    assert {"index.html", "servo.json", "parameters.csv", "servos.xml", "arm.c", "arm.h"} <= names
    document = json.loads((results / "servo.json").read_text("utf-8"))
    recordings = load_servo_recordings(folder / "set", ("shoulder", "elbow"), units="degrees")
    squares = [
        (replay_in_mujoco(results / "servos.xml", recording) - recording.position) ** 2
        for recording in list(recordings.values())[16:]
    ]
    expected = 1e3 * np.sqrt(np.mean(np.concatenate(squares), axis=0))
    errors = [row["MuJoCo"] for row in document["position_error_mrad"][:2]]
    np.testing.assert_allclose(errors, expected)
    page = (results / "index.html").read_text("utf-8")
    assert 'href="servos.xml"' in page and "shoulder: difference [mrad]" in page
    model = mujoco.MjModel.from_xml_path(str(results / "servos.xml"))
    assert model.nu == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--estimator", "auto"], "--estimator: not with --drive servo"),
        (["--decimate", "2"], "--decimate: not with --drive servo"),
        (["--loaded", "FILE"], "--loaded and --mass: got one of them; expected both"),
        (["--known", "gain"], "--known: expected NAME=VALUE, as in gain=20, got 'gain'"),
        (["--table", "lower,1"], "--table: expected BODY,X,Y,Z or BODY,X,Y,Z,HEIGHT in m, as in"),
        (["--table", "hand,0,0,1"], "--table: 'hand' is no moved body; expected of upper, lower"),
        (["--centre", "1,2"], "--centre: expected X,Y,Z in m, as in 0,0,0.05, got '1,2'"),
    ],
)
def test_options_that_do_not_fit(folder: Path, options: list[str], message: str) -> None:
    result = run("identify", folder / "arm.urdf", folder / "set", "--drive", "servo", *options)
    assert result.exit_code == 2
    assert message in result.stderr


def test_logs_of_servos_are_named(folder: Path) -> None:
    """`check` and `identify` say which option a log without torques needs."""
    for command in ("check", "identify"):
        result = run(command, folder / "arm.urdf", folder / "set")
        assert result.exit_code == 2
        assert "no torque, but commanded positions: use --drive servo" in result.stderr
    result = run("identify", folder / "arm.urdf", folder / "set", "--units", "degrees")
    assert "--units: only with --drive servo" in result.stderr


def test_recordings_are_checked(folder: Path) -> None:
    """Of an arm on a fixed base nothing looks wrong; options of a payload are of `identify`."""
    line = ("check", folder / "arm.urdf", folder / "set", "--units", "degrees")
    result = run(*line, "--drive", "servo")
    assert result.exit_code == 0, result.output
    assert "set: episode 19: 150 samples in 4.967 s" in result.output
    assert result.output.rstrip().endswith("nothing looks wrong")
    assert "--units: only with --drive servo" in run(*line).stderr
    result = run(*line, "--drive", "servo", "--friction", "viscous")
    assert "--friction: not with --drive servo" in result.stderr


def test_a_payload_of_known_mass(folder: Path) -> None:
    """A recording with a payload: the same fit takes both."""
    robot = jc.load_robot(folder / "arm.urdf")
    body = jc.LinkParameters(0.2, np.array([0.15, 0.0, 0.0]), np.zeros((3, 3)))
    time = np.arange(600) * 0.02
    command = 0.7 * np.stack([np.sin(1.3 * time), np.sin(2.1 * time + 1.0)], axis=1)
    assert robot.links is not None and robot.source is not None
    seen = seen_from(body, robot.source.placements[-1])
    heavy = dataclasses.replace(
        robot, links=(robot.links[0], fixed_together([robot.links[1], seen]))
    )
    for name, arm in (("empty", robot), ("loaded", heavy)):
        position = simulate(arm, DRIVES, time, command, command[0])
        rounded = np.round(position / STEP) * STEP
        columns = {"time": time} | {
            f"{quantity}_{joint}": values[:, j]
            for quantity, values in (("command", command), ("position", rounded))
            for j, joint in enumerate(("shoulder", "elbow"))
        }
        table = np.stack(list(columns.values()), axis=1)
        header = ",".join(columns)
        np.savetxt(folder / f"{name}.csv", table, "%.6f", ",", header=header, comments="")
    result = run(
        *("identify", folder / "arm.urdf", folder / "empty.csv", "--drive", "servo"),
        *("--loaded", folder / "loaded.csv", "--mass", "0.2", "--centre", "0.15,0,0"),
        *("-o", folder / "weighed"),
    )
    assert result.exit_code == 0, result.output
    document = json.loads((folder / "weighed" / "servo.json").read_text("utf-8"))
    assert document["units"] == "torque"
    gains = {row["joint"]: row for row in document["parameters"] if row["parameter"] == "gain"}
    for joint, drive in zip(("shoulder", "elbow"), DRIVES, strict=True):
        assert gains[joint]["value"] == pytest.approx(drive.gain, rel=0.05)


def test_a_robot_file_states_known_gains(tmp_path: Path) -> None:
    """One value, or one per joint."""
    path = tmp_path / "legs.toml"
    joints = 2 * "[[joint]]\nkind = 'R'\na = 0.1\n"
    path.write_text("[drive]\ngain = 20\ndamping = [1.5, 2.0]\n" + joints)
    assert jc.load_robot(path).drive == {"gain": 20.0, "damping": (1.5, 2.0)}
    path.write_text("[drive]\ndamping = [1.5]\n" + joints)
    with pytest.raises(jc.RobotError, match=r"\[drive\], damping: expected 2 finite numbers"):
        jc.load_robot(path)

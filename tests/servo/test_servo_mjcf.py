"""MuJoCo models of servo arms: their replay of commands against other simulations."""

import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest

import jaxcslc as jc
from jaxcslc.cli._servo import ServoOptions
from jaxcslc.manipulator import RobotError
from jaxcslc.servo import (
    ServoDrive,
    ServoRecording,
    Table,
    replay_in_mujoco,
    simulate,
    write_servo_mjcf,
)


GRAVITY = 9.81
# MuJoCo takes steps of 1 ms by a method of first order: half a step at up to 5 rad/s; and those of
# the other simulation, where MuJoCo takes such too.
SIMULATION, FINE = 3e-3, 4e-4
STEP = 1e-4
TOUCH = 2e-4  # m, by which MuJoCo's contacts give way


def commands(joints: int) -> ServoRecording:
    """Steps and sines at 50 Hz for 3 s, from a pose that is held at first."""
    time = np.arange(150) * 0.02
    wave = 0.4 * np.sin(4.0 * time) + 0.3 * (time > 1.0) - 0.5 * (time > 2.0)
    command = np.stack([wave * (1.0 - 0.3 * j) for j in range(joints)], axis=1)
    return ServoRecording(time, command, command)


def simulated(path: Path, drives: list[ServoDrive], recording: ServoRecording) -> np.ndarray:
    """Readings by Pinocchio's dynamics, semi-implicit Euler, and friction that can stick.

    Sticking is decided joint by joint, which is exact for one joint.
    """
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    drive = {
        name: np.array([getattr(d, name) for d in drives])
        for name in ("gain", "damping", "offset", "armature", "coulomb", "viscous", "torque_limit")
    }
    q = recording.position[0] - drive["offset"]
    v = np.zeros(model.nv)
    readings = np.empty_like(recording.position)
    steps = round((recording.time[1] - recording.time[0]) / STEP)
    delays = [round(d.delay / STEP) for d in drives]
    for step in range(recording.samples * steps):
        if step % steps == 0:
            readings[step // steps] = q + drive["offset"]
        rows = [max(0, step - delay) // steps for delay in delays]
        command = recording.command[rows, np.arange(model.nv)]
        servo = drive["gain"] * (command - q - drive["offset"]) - drive["damping"] * v
        servo = np.clip(servo, -drive["torque_limit"], drive["torque_limit"])
        mass = pinocchio.crba(model, data, q) + np.diag(drive["armature"])
        mass = np.triu(mass) + np.triu(mass, 1).T
        free = servo - drive["viscous"] * v - pinocchio.nle(model, data, q, v)
        sticks = (v == 0.0) & (np.abs(free) <= drive["coulomb"])
        friction = np.where(v == 0.0, np.sign(free), np.sign(v)) * drive["coulomb"]
        change = STEP * np.linalg.solve(mass, free - friction)
        after = np.where(sticks, 0.0, v + change)
        v = np.where((v * after < 0.0) & (drive["coulomb"] > 0.0), 0.0, after)
        q = q + STEP * v
    return readings


def test_an_arm_without_coulomb_friction(arm: jc.Manipulator, tmp_path: Path) -> None:
    drives = [
        ServoDrive(20.0, 0.8, delay=0.04, armature=0.02, viscous=0.1, offset=0.2),
        ServoDrive(12.0, 0.3, delay=0.02, armature=0.01, offset=-0.1, torque_limit=1.5),
    ]
    written = write_servo_mjcf(arm, drives, tmp_path / "servos.xml")
    assert written.approximations == ()
    recording = commands(2)
    oracle = simulated(tmp_path / "arm.urdf", drives, recording)
    replayed = replay_in_mujoco(written.path, recording)
    np.testing.assert_allclose(replayed, oracle, atol=SIMULATION)
    fine = tmp_path / "fine.xml"
    text = written.path.read_text().replace('timestep="0.001"', f'timestep="{STEP}"')
    fine.write_text(re.sub(r'nsample="(\d+)"', r'nsample="\g<1>0"', text))
    np.testing.assert_allclose(replay_in_mujoco(fine, recording), oracle, atol=FINE)


def test_a_joint_that_sticks(arm_file: Path, tmp_path: Path) -> None:
    """Coulomb friction holds the joint: MuJoCo's constraint must not creep."""
    arm = jc.load_robot(arm_file, fix=["elbow"])
    drive = ServoDrive(10.0, 0.3, delay=0.03, armature=0.02, coulomb=0.4)
    written = write_servo_mjcf(arm, [drive], tmp_path / "servo.xml")
    recording = commands(1)
    rest = recording.command[0, 0] * np.ones((150, 1))
    moving, fixed = 'name="elbow" type="revolute"', 'name="elbow" type="fixed"'
    (tmp_path / "one.urdf").write_text(arm_file.read_text().replace(moving, fixed))
    for motion in (recording, ServoRecording(recording.time, rest, rest + 0.03)):
        oracle = simulated(tmp_path / "one.urdf", [drive], motion)
        replayed = replay_in_mujoco(written.path, motion)
        np.testing.assert_allclose(replayed, oracle, atol=SIMULATION)


def test_an_integral_removes_the_error_of_gravity(arm: jc.Manipulator, tmp_path: Path) -> None:
    """At rest the reading is the command, which proportional gain alone misses by gravity."""
    hold = np.full((400, 2), 0.3)
    recording = ServoRecording(np.arange(400) * 0.02, hold, hold)
    ends = []
    for integral in (0.0, 60.0):
        drive = ServoDrive(20.0, 1.5, integral=integral, armature=0.02)
        written = write_servo_mjcf(arm, [drive, drive], tmp_path / "servos.xml")
        ends.append(replay_in_mujoco(written.path, recording)[-1] - 0.3)
    # Of the upper arm's and the lower arm's centres, horizontally.
    upper = 0.1 * math.cos(0.3), 0.2 * math.cos(0.3) + 0.08 * math.cos(0.6) + 0.01 * math.sin(0.6)
    torque = GRAVITY * (0.3 * upper[0] + 0.2 * upper[1])
    assert ends[0][0] == pytest.approx(torque / 20.0, rel=0.1)
    np.testing.assert_allclose(ends[1], 0.0, atol=SIMULATION)


def test_ends_of_travel_are_readings(arm: jc.Manipulator, tmp_path: Path) -> None:
    drives = [ServoDrive(20.0, 1.0, armature=0.02, offset=0.1, high=0.5, low=-0.4)] * 2
    hold = np.full((200, 2), 0.9)
    recording = ServoRecording(np.arange(200) * 0.02, 0.0 * hold, hold)
    written = write_servo_mjcf(arm, drives, tmp_path / "servos.xml")
    replayed = replay_in_mujoco(written.path, recording)
    np.testing.assert_allclose(replayed[-1], 0.5, atol=2 * SIMULATION)
    wide = write_servo_mjcf(
        arm,
        drives,
        tmp_path / "wide.xml",
        recordings=[ServoRecording(recording.time, hold - 0.3, hold)],
    )
    np.testing.assert_allclose(replay_in_mujoco(wide.path, recording)[-1], 0.6, atol=2 * SIMULATION)


@pytest.mark.parametrize(
    "more", [{"dead_zone": 0.01}, {"static": 0.3, "stribeck": 0.3}, {"load_friction": 0.3}]
)
def test_frictionloss_and_damping_stand_for_what_mujoco_lacks(
    arm: jc.Manipulator, tmp_path: Path, more: dict[str, float]
) -> None:
    """With it, MuJoCo is nearer to a simulation that has all, under commands of other motion."""
    drive = ServoDrive(10.0, 0.5, armature=0.02, coulomb=0.1, delay=0.02, **more)
    recording = commands(2)
    time = recording.time
    other = ServoRecording(time, 0.0 * recording.command, 0.3 * np.sin(2.0 * recording.command))
    differences = []
    for recordings in ((), (recording,)):
        path = tmp_path / "servos.xml"
        written = write_servo_mjcf(arm, [drive, drive], path, recordings=recordings)
        goal = simulate(arm, [drive, drive], time, other.command, other.position[0])
        difference = replay_in_mujoco(path, other) - goal
        differences.append(np.sqrt(np.mean(difference**2)))
        assert len(written.approximations) == 1
    assert differences[1] < 0.9 * differences[0]


def test_the_program_of_the_page(
    arm: jc.Manipulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Plain MuJoCo, as docs/servo.md has it, replays the same."""
    page = (Path(__file__).parents[2] / "docs" / "servo.md").read_text("utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    drives = [ServoDrive(10.0, 0.5, delay=0.03), ServoDrive(8.0, 0.3, coulomb=0.1)]
    path = write_servo_mjcf(arm, drives, tmp_path / "results" / "servos.xml").path
    x = commands(2)
    monkeypatch.chdir(tmp_path)
    log = np.column_stack([x.time, x.command, x.position])
    np.savetxt("validation.csv", log, "%.17g", ",", header="names", comments="")
    names: dict[str, Any] = {}
    exec(compile(program, "docs/servo.md", "exec"), names)
    np.testing.assert_array_equal(names["readings"], replay_in_mujoco(path, x))


def test_the_table_of_the_page_is_that_of_the_example(tmp_path: Path) -> None:
    """`--table` of docs/servo.md: the tip of the SO-101's hand, by MuJoCo's kinematics."""
    page = (Path(__file__).parents[2] / "docs" / "servo.md").read_text("utf-8")
    (text,) = set(re.findall(r"--table (\S+) -o servos", page))
    example = jc.examples.write_example("so101", tmp_path).robot
    robot = jc.load_robot(example)
    table = ServoOptions(drive="servo", table=text).table_of(robot)
    assert table is not None
    model = mujoco.MjModel.from_xml_path(str(example))
    data = mujoco.MjData(model)
    data.qpos[:] = q = np.array([0.3, 0.4, -0.5, 0.6, 0.7, 0.2])
    mujoco.mj_kinematics(model, data)
    hand = data.body("gripper_link")
    tip = hand.xpos + hand.xmat.reshape(3, 3) @ [-0.0079, -0.0002, -0.0981]
    np.testing.assert_allclose(table.heights(robot, q[None]), tip[2], atol=1e-6)


def test_what_is_left_out_is_said(arm: jc.Manipulator, tmp_path: Path) -> None:
    drive = ServoDrive(10.0, 1.0, armature=0.02, static=0.05, play=0.01, speed_limit=5.0)
    written = write_servo_mjcf(arm, [drive, drive], tmp_path / "servos.xml")
    assert written.approximations == (
        "static friction: omitted (shoulder, elbow)",
        "play of the gear: omitted (shoulder, elbow)",
        "speed limit: omitted (shoulder, elbow)",
    )


def test_masses_and_geometry(arm: jc.Manipulator, tmp_path: Path) -> None:
    """Bodies are the file's; nothing collides, and rods weigh nothing."""
    written = write_servo_mjcf(arm, [ServoDrive(1.0)] * 2, tmp_path / "servos.xml")
    model = mujoco.MjModel.from_xml_path(str(written.path))
    np.testing.assert_allclose(model.body_mass, [0.0, 0.3, 0.2])
    assert model.ngeom > 0 and not model.geom_contype.any()
    assert [model.joint(i).name for i in range(2)] == ["shoulder", "elbow"]
    text = written.path.read_text()
    assert text.count("<position ") == 2 and "<general" not in text


def test_wrong_robots(arm: jc.Manipulator, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="1 drives; expected 2, one per joint"):
        write_servo_mjcf(arm, [ServoDrive(1.0)], tmp_path / "servos.xml")
    with pytest.raises(RobotError, match="expected one that was read from a URDF or MJCF file"):
        write_servo_mjcf(jc.puma560(), [ServoDrive(1.0)] * 6, tmp_path / "servos.xml")
    written = write_servo_mjcf(arm, [ServoDrive(1.0)] * 2, tmp_path / "servos.xml")
    with pytest.raises(RobotError, match="2 servos; the recording has 1 joints"):
        replay_in_mujoco(written.path, commands(1))


def test_a_table_is_in_the_model(arm: jc.Manipulator, tmp_path: Path) -> None:
    """A pressed hand rests at the table's height, by Pinocchio, and moves as in our simulation."""
    drives = [
        ServoDrive(20.0, 0.8, armature=0.02, offset=0.2),
        ServoDrive(12.0, 0.3, armature=0.01, offset=-0.1),
    ]
    time = np.arange(150) * 0.02
    command = np.minimum(time, 1.0)[:, None] * [0.9, 0.5] + [0.2, -0.1]
    recording = ServoRecording(time, command, command)
    assert arm.source is not None
    tip = arm.source.placements[1] @ [0.15, 0.0, 0.0, 1.0]
    x, y, z = (float(value) for value in tip[:3])
    table = Table(1, (x, y, z), -0.1)
    written = write_servo_mjcf(arm, drives, tmp_path / "servos.xml", table=table)
    replayed = replay_in_mujoco(written.path, recording)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data = model.createData()
    pinocchio.forwardKinematics(model, data, replayed[-1] - [0.2, -0.1])
    assert abs((data.oMi[2] * np.array([0.15, 0.0, 0.0]))[2] + 0.1) < TOUCH
    ours = simulate(arm, drives, time, command, command[0], table=table)
    np.testing.assert_allclose(replayed, ours, atol=SIMULATION)
    assert np.max(np.abs(ours - simulate(arm, drives, time, command, command[0]))) > 0.1

"""Recordings of servos from tables, SAGE's logs and bags of ROS: values, times, and errors."""

import gzip
import json
import re
import textwrap
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxcslc.recordings import ColumnMapping, RecordingError, load_recording
from jaxcslc.servo import load_servo_recording, load_servo_recordings


SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "so101"
ROWS = 12
TIME = np.arange(ROWS) * 0.02
COMMAND = np.stack([np.sin(TIME), np.cos(TIME)], axis=1)
POSITION = 0.9 * COMMAND

# Files hold six decimals of a radian or more.
WRITTEN = 1e-6


def write_table(path: Path, columns: dict[str, np.ndarray]) -> Path:
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9f")
    return path


def error(path: Path, *args: Any, **options: Any) -> str:
    with pytest.raises(RecordingError) as caught:
        load_servo_recordings(path, *args, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


class TestTables:
    @pytest.mark.parametrize(
        ("command", "position"),
        [
            ("goal_position_{}", "present_position_{}"),
            ("command_{}", "position_{}"),
            ("action[{}]", "observation.state[{}]"),
            ("target_{}", "q_{}"),
        ],
    )
    def test_known_names(self, tmp_path: Path, command: str, position: str) -> None:
        columns = {"time": TIME}
        columns |= {command.format(i + 1): COMMAND[:, i] for i in range(2)}
        columns |= {position.format(i + 1): POSITION[:, i] for i in range(2)}
        recording = load_servo_recording(write_table(tmp_path / "arm.csv", columns))
        np.testing.assert_allclose(recording.command, COMMAND, atol=WRITTEN)
        np.testing.assert_allclose(recording.position, POSITION, atol=WRITTEN)
        assert recording.velocity is None

    def test_ticks_by_a_mapping(self, tmp_path: Path) -> None:
        """A tick of a 12-bit encoder is 2 pi / 4096, and half a turn is zero."""
        ticks = np.round(COMMAND * 4096 / (2 * np.pi)) + 2048
        columns = {"t": TIME, "goal_position_a": ticks[:, 0], "goal_position_b": ticks[:, 1]}
        columns |= {"present_position_a": ticks[:, 0], "present_position_b": 4096 - ticks[:, 1]}
        path = write_table(tmp_path / "arm.csv", columns)
        assert "state the unit, such as deg or tick" in error(path)
        (tmp_path / "columns.toml").write_text(
            "[command]\nunit = 'tick'\nzero = 2048\n"
            "[position]\nunit = 'tick'\nzero = [2048, 2048]\nsign = [-1, 1]\n"
        )
        recording = load_servo_recording(path, ["b", "a"], tmp_path / "columns.toml")
        assert recording.joint_names == ("b", "a")
        np.testing.assert_allclose(recording.command, COMMAND[:, ::-1], atol=np.pi / 4096)
        np.testing.assert_array_equal(recording.command, recording.position)

    def test_columns_that_lack(self, tmp_path: Path) -> None:
        path = write_table(tmp_path / "a.csv", {"time": TIME, "position_1": TIME})
        assert "a.csv: no command: the file has no column of it; expected command_1" in error(path)
        columns = {"time": TIME, "goal_1": TIME, "goal_2": TIME, "position_1": TIME}
        path = write_table(tmp_path / "b.csv", columns)
        assert "b.csv: no position of joint '2'" in error(path)
        assert "no such file" in error(tmp_path / "c.csv")

    @pytest.mark.parametrize(
        "names",
        [("time", "goal_position_1", "present_position_1"), ("time", "command_a", "position_a")],
    )
    def test_files_without_torque_name_the_drive(
        self, tmp_path: Path, names: tuple[str, ...]
    ) -> None:
        path = write_table(tmp_path / "arm.csv", dict.fromkeys(names, TIME))
        with pytest.raises(RecordingError, match="no torque, but commanded positions: use --drive"):
            load_recording(path)


def test_mappings_of_the_page() -> None:
    """Those of docs/servo.md are as the reader takes them."""
    page = (Path(__file__).parents[2] / "docs" / "servo.md").read_text("utf-8")
    blocks = [textwrap.dedent(x) for x in re.findall(r"```toml\n(.*?)```", page, re.DOTALL)]
    names, registers = (ColumnMapping.of(tomllib.loads(block)) for block in blocks)
    assert names.file_joints is not None and names.file_joints[-1] == "Jaw"
    assert registers.quantities["command"].zeros == (2048.0,)
    assert registers.quantities["position"].factors == (1.0, -1.0, 1.0, 1.0, 1.0, 1.0)


def write_sage(
    folder: Path, control: np.ndarray, state: np.ndarray, *, names: Sequence[str] = ("a", "b")
) -> Path:
    """A log as SAGE writes it: times in us, lists in one quoted cell."""
    folder.mkdir()
    (folder / "joint_list.txt").write_text("\n".join(names) + "\n")
    with gzip.open(folder / "control.csv.gz", "wt") as file:
        file.write("type,timestamp,positions\n")
        for row in control:
            file.write(f'CONTROL,{float(row[0])!r},"{json.dumps(row[1:].tolist())}"\n')
    with (folder / "state_motor.csv").open("w") as file:
        file.write("type,timestamp,positions,velocities,torques\n")
        for row in state:
            values = json.dumps(row[1:].tolist())
            file.write(f'STATE_MOTOR,{float(row[0])!r},"{values}","{values}","{values}"\n')
    return folder


class TestSage:
    def test_a_command_holds_from_its_stamp(self, tmp_path: Path) -> None:
        """Each state has the last command sent before it; states before the first are dropped."""
        micro = 1e6
        sent = np.column_stack([TIME * micro + 5e3, COMMAND])
        read = np.column_stack([TIME * micro, POSITION])
        recording = load_servo_recording(write_sage(tmp_path / "motion", sent, read))
        np.testing.assert_allclose(recording.time - recording.time[0], TIME[:-1], atol=1e-9)
        np.testing.assert_array_equal(recording.command, COMMAND[:-1])
        np.testing.assert_array_equal(recording.position, POSITION[1:])
        assert recording.joint_names == ("a", "b")
        assert "1 rows before the first command are not used" in recording.notes
        assert recording.current is not None

    def test_joints_are_mapped_to_the_robots(self, tmp_path: Path) -> None:
        rows = np.column_stack([TIME * 1e6, COMMAND])
        folder = write_sage(tmp_path / "motion", rows, rows)
        assert "no joint shoulder" in error(folder, ["shoulder"])
        (tmp_path / "columns.toml").write_text("joints = {shoulder = 'b'}")
        recording = load_servo_recording(folder, ["shoulder"], tmp_path / "columns.toml")
        np.testing.assert_array_equal(recording.command[:, 0], COMMAND[:, 1])

    def test_wrong_cells_are_named(self, tmp_path: Path) -> None:
        rows = np.column_stack([TIME * 1e6, COMMAND])
        folder = write_sage(tmp_path / "motion", rows, rows, names=["a", "b", "c"])
        assert "row 1, column positions: " in error(folder)
        assert "expected 3 numbers in a list" in error(folder)
        (folder / "state_motor.csv").unlink()
        assert "no state_motor.csv" in error(folder)

    def test_the_so101(self) -> None:
        """The first rows of a recorded motion, as its files have them."""
        if not SHARED.is_dir():
            pytest.skip("the SO-101's recordings are not here")
        recording = load_servo_recording(SHARED / "multisine")
        assert recording.joint_names == (
            *("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw"),
        )
        assert recording.samples == 6000
        np.testing.assert_allclose(recording.command[0, :3], [0.039468, 0.039468, 0.539468])
        np.testing.assert_allclose(recording.position[0, 0], 0.03451456772742693)
        with pytest.raises(RecordingError, match="no torque, but commanded positions: use --drive"):
            load_recording(SHARED / "multisine")


NANO = 1_000_000_000
START = 1_700_000_000 * NANO


def write_bag(path: Path, kind: str, *, topic: str, second: str | None = None) -> Path:
    """A bag of states at 50 Hz, stamped, and of commands of one type every 0.06 s.

    Messages arrive 1 ms after their stamps. A trajectory goes to its point within 0.04 s.
    """
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    names = ["a", "b"]

    def stamp(instant: int) -> Any:
        return types["builtin_interfaces/msg/Time"](*divmod(instant, NANO))

    def state(instant: int, row: np.ndarray) -> Any:
        header = types["std_msgs/msg/Header"](stamp=stamp(instant), frame_id="")
        nothing = np.zeros(0)
        return types["sensor_msgs/msg/JointState"](header, names, row, nothing, nothing)

    def command(instant: int, row: np.ndarray) -> Any:
        if kind == "std_msgs/msg/Float64MultiArray":
            layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
            return types[kind](layout, row)
        if kind == "sensor_msgs/msg/JointState":
            return state(instant, row)
        nothing = np.zeros(0)
        since = types["builtin_interfaces/msg/Duration"](0, NANO // 25)
        point = types["trajectory_msgs/msg/JointTrajectoryPoint"](
            row[::-1].copy(), nothing, nothing, nothing, since
        )
        header = types["std_msgs/msg/Header"](stamp=stamp(instant), frame_id="")
        return types[kind](header, names[::-1], [point])

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:

        def connection(name: str, message_type: str) -> Any:
            return writer.add_connection(name, message_type, typestore=store)

        states = connection("/joint_states", "sensor_msgs/msg/JointState")
        commands = [connection(name, kind) for name in (topic, second) if name is not None]
        for row, time in enumerate(TIME):
            instant = START + round(time * NANO)
            message = state(instant, POSITION[row])
            data = store.serialize_cdr(message, "sensor_msgs/msg/JointState")
            writer.write(states, instant + NANO // 1000, data)
            if row % 3 == 1:
                for to in commands:
                    data = store.serialize_cdr(command(instant, COMMAND[row]), kind)
                    writer.write(to, instant + NANO // 1000, data)
    return path


class TestBags:
    """A command holds, or is interpolated, from the message's time on."""

    @pytest.mark.parametrize(
        ("kind", "topic"),
        [
            ("std_msgs/msg/Float64MultiArray", "/position_controller/commands"),
            ("sensor_msgs/msg/JointState", "/joint_commands"),
        ],
    )
    def test_held_commands(self, tmp_path: Path, kind: str, topic: str) -> None:
        recording = load_servo_recording(write_bag(tmp_path / "bag", kind, topic=topic), ["a", "b"])
        assert recording.joint_names == ("a", "b")
        np.testing.assert_allclose(recording.position, POSITION[1:])
        latest = [row - (row - 1) % 3 for row in range(1, ROWS)]
        np.testing.assert_allclose(recording.command, COMMAND[latest])
        assert any("before the first command" in note for note in recording.notes)

    def test_a_trajectory_is_interpolated(self, tmp_path: Path) -> None:
        """The command goes to the point within two samples, from where it was; names reversed."""
        path = write_bag(
            tmp_path / "bag",
            "trajectory_msgs/msg/JointTrajectory",
            topic="/arm_controller/joint_trajectory",
        )
        recording = load_servo_recording(path, ["a", "b"])
        expected, current = [], POSITION[1]
        for row in range(1, ROWS):
            goal, step = COMMAND[row - (row - 1) % 3], (row - 1) % 3
            expected.append(current + (goal - current) * step / 2)
            current = goal if step == 2 else current
        np.testing.assert_allclose(recording.command, expected, atol=1e-9)

    def test_topics_are_chosen(self, tmp_path: Path) -> None:
        kind = "std_msgs/msg/Float64MultiArray"
        path = write_bag(tmp_path / "bag", kind, topic="/one/commands", second="/two/commands")
        assert "2 topics of commands; expected one" in error(path, ["a", "b"])
        (tmp_path / "columns.toml").write_text("command_topic = '/two/commands'")
        recording = load_servo_recording(path, ["a", "b"], tmp_path / "columns.toml")
        assert recording.samples == ROWS - 1
        (tmp_path / "columns.toml").write_text("command_topic = '/three'")
        assert "no topics of commands of topic '/three'" in error(
            path, ["a", "b"], tmp_path / "columns.toml"
        )

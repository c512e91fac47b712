"""Data sets of LeRobot, versions 2.1 and 3.0: episodes, units and calibration."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxcslc.recordings import RecordingError, load_recording
from jaxcslc.servo import load_servo_recordings


MOTORS = ("shoulder_pan", "elbow_flex", "gripper")
FPS = 30
# LeRobot stores float32.
SINGLE = 1e-5
CALIBRATION = {
    "shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": -11, "range_min": 1000},
    "elbow_flex": {"id": 2, "drive_mode": 1, "homing_offset": 40, "range_min": 800},
    "gripper": {"id": 3, "drive_mode": 0, "homing_offset": 7, "range_min": 2000},
}
RANGE_MAX = {"shoulder_pan": 3000, "elbow_flex": 3200, "gripper": 3400}


def calibration(folder: Path) -> Path:
    motors = {name: {**motor, "range_max": RANGE_MAX[name]} for name, motor in CALIBRATION.items()}
    path = folder / "arm.json"
    path.write_text(json.dumps(motors))
    return path


def angles(episodes: int, frames: int = 40) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Commands and positions of each episode [rad]; the gripper's are in its range."""
    time = np.arange(frames) / FPS
    commands = [
        np.stack([np.sin(time + k), 0.5 * np.cos(2 * time + k), 1.0 + 0.5 * np.sin(time)], axis=1)
        for k in range(episodes)
    ]
    return commands, [0.95 * command for command in commands]


def ticks(angle: np.ndarray) -> np.ndarray:
    """Encoder ticks: zero is the middle of the range, of the gripper its lower end."""
    low = np.array([CALIBRATION[m]["range_min"] for m in MOTORS], float)
    middle = (low + [RANGE_MAX[m] for m in MOTORS]) / 2.0
    middle[2] = low[2]
    return angle * 4096 / (2 * np.pi) + middle


def normalised(angle: np.ndarray) -> np.ndarray:
    """As `MotorsBus._normalize` of LeRobot computes it from ticks."""
    low = np.array([CALIBRATION[m]["range_min"] for m in MOTORS], float)
    high = np.array([RANGE_MAX[m] for m in MOTORS], float)
    values = (ticks(angle) - low) / (high - low) * 200.0 - 100.0
    values[:, 1] *= -1.0  # drive_mode
    values[:, 2] = ((ticks(angle) - low) / (high - low) * 100.0)[:, 2]
    return values


def degrees(angle: np.ndarray) -> np.ndarray:
    """Joints in degrees, the gripper in percent of its range."""
    return np.column_stack([np.degrees(angle[:, :2]), normalised(angle)[:, 2]])


def write_data_set(
    folder: Path,
    commands: list[np.ndarray],
    positions: list[np.ndarray],
    *,
    version: str = "v3.0",
    names: Any = tuple(f"{motor}.pos" for motor in MOTORS),
    **info: Any,
) -> Path:
    """A data set with one file per episode (2.1) or two files of all episodes (3.0)."""
    (folder / "meta").mkdir(parents=True)
    width = commands[0].shape[1]
    feature = {"dtype": "float32", "shape": [width], "names": names}
    document = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "fps": FPS,
        "total_episodes": len(commands),
        "features": {"action": feature, "observation.state": feature},
        **info,
    }
    (folder / "meta" / "info.json").write_text(json.dumps(document))
    tables: list[pa.Table] = []
    index = 0
    for episode, (command, position) in enumerate(zip(commands, positions, strict=True)):
        frames = len(command)
        lists = pa.list_(pa.float32(), width) if version == "v3.0" else pa.list_(pa.float32())
        columns = {
            "action": pa.array(command.tolist(), lists),
            "observation.state": pa.array(position.tolist(), lists),
            "timestamp": pa.array(np.arange(frames) / FPS, pa.float32()),
            "frame_index": pa.array(np.arange(frames)),
            "episode_index": pa.array(np.full(frames, episode)),
            "index": pa.array(index + np.arange(frames)),
            "task_index": pa.array(np.zeros(frames, int)),
        }
        index += frames
        tables.append(pa.table(columns))
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    if version == "v3.0":
        half = max(1, len(tables) // 2)
        for number, part in enumerate(filter(None, (tables[:half], tables[half:]))):
            pq.write_table(pa.concat_tables(part), chunk / f"file-{number:03d}.parquet")
    else:
        for episode, table in enumerate(tables):
            pq.write_table(table, chunk / f"episode_{episode:06d}.parquet")
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_twenty_episodes(tmp_path: Path, version: str) -> None:
    """Every episode is a recording that starts at 0 s."""
    commands, positions = angles(20)
    data_set = write_data_set(tmp_path / "set", commands, positions, version=version)
    recordings = load_servo_recordings(data_set, MOTORS)
    assert list(recordings) == [f"episode {k}" for k in range(20)]
    for recording, command, position in zip(recordings.values(), commands, positions, strict=True):
        assert recording.joint_names == MOTORS
        np.testing.assert_allclose(recording.time, np.arange(40) / FPS, atol=SINGLE)
        np.testing.assert_allclose(recording.command, command, atol=SINGLE)
        np.testing.assert_allclose(recording.position, position, atol=SINGLE)


@pytest.mark.parametrize(("units", "convert"), [("normalised", normalised), ("degrees", degrees)])
def test_units_with_the_calibration_file(tmp_path: Path, units: Any, convert: Any) -> None:
    commands, positions = angles(2)
    data_set = write_data_set(
        tmp_path / "set", *(list(map(convert, v)) for v in (commands, positions))
    )
    recordings = load_servo_recordings(
        data_set, MOTORS, units=units, calibration=calibration(tmp_path)
    )
    for recording, command in zip(recordings.values(), commands, strict=True):
        np.testing.assert_allclose(recording.command, command, atol=SINGLE)
        assert any(units in note for note in recording.notes)


def test_drive_modes_of_dynamixel_servos(tmp_path: Path) -> None:
    """LeRobot does not reverse their positions: the servos do."""
    commands, _ = angles(1)
    values = [normalised(command) for command in commands]
    values[0][:, 1] *= -1.0  # not reversed
    data_set = write_data_set(tmp_path / "set", values, values, robot_type="koch_follower")
    recordings = load_servo_recordings(
        data_set, MOTORS, units="normalised", calibration=calibration(tmp_path)
    )
    np.testing.assert_allclose(recordings["episode 0"].command, commands[0], atol=SINGLE)


def test_units_that_values_do_not_show(tmp_path: Path) -> None:
    commands, positions = angles(1)
    far = [np.degrees(3.0 * command) for command in commands]
    beyond = write_data_set(tmp_path / "beyond", far, far)
    recordings = load_servo_recordings(beyond)
    np.testing.assert_allclose(
        recordings["episode 0"].command, 3.0 * commands[0][:, :2], atol=SINGLE
    )
    assert any("gripper is in percent" in note for note in recordings["episode 0"].notes)
    within = write_data_set(
        tmp_path / "within", *(list(map(degrees, v)) for v in (commands, positions))
    )
    with pytest.raises(RecordingError, match="degrees, or -100 to 100 of the range"):
        load_servo_recordings(within)
    with pytest.raises(RecordingError, match="expected --calibration FILE"):
        load_servo_recordings(within, units="normalised")
    with pytest.raises(RecordingError, match="no joint gripper"):
        load_servo_recordings(within, MOTORS, units="degrees")


def test_units_and_signs_by_a_mapping(tmp_path: Path) -> None:
    commands, positions = angles(1)
    data_set = write_data_set(
        tmp_path / "set", *(list(map(np.degrees, v)) for v in (commands, positions))
    )
    (tmp_path / "columns.toml").write_text(
        "joints = {elbow = 'elbow_flex'}\n"
        "[position]\nunit = 'deg'\nsign = -1\n[command]\nunit = 'deg'\nsign = -1\n"
    )
    recording = load_servo_recordings(data_set, ["elbow"], tmp_path / "columns.toml")["episode 0"]
    np.testing.assert_allclose(recording.command[:, 0], -commands[0][:, 1], atol=SINGLE)


@pytest.mark.parametrize(
    "names",
    [
        pytest.param({"motors": [f"main_{motor}" for motor in MOTORS]}, id="version 2.0"),
        pytest.param(None, id="none"),
        pytest.param(["x.vel", "elbow_flex.pos", "y.vel"], id="a mobile base"),
    ],
)
def test_names_of_motors(tmp_path: Path, names: Any) -> None:
    commands, positions = angles(1)
    recording = load_servo_recordings(
        write_data_set(tmp_path / "set", commands, positions, names=names)
    )["episode 0"]
    if names is None:
        assert recording.joint_names is None and recording.joints == 3
    elif isinstance(names, dict):
        assert recording.joint_names == MOTORS
    else:
        assert recording.joint_names == ("elbow_flex",)
        assert "values of the data set that are not read: x.vel, y.vel" in recording.notes


class TestErrors:
    """One line: file, place, and what was expected."""

    def message(self, path: Path, **options: Any) -> str:
        with pytest.raises(RecordingError) as caught:
            load_servo_recordings(path, **options)
        text = str(caught.value)
        assert "\n" not in text and text.startswith(str(path.parents[0]))
        return text

    def test_of_files(self, tmp_path: Path) -> None:
        data_set = write_data_set(tmp_path / "set", *angles(2), total_episodes=5)
        assert (
            "2 of 5 episodes are in the folder"
            in load_servo_recordings(data_set)["episode 0"].notes
        )
        (file, _) = sorted((data_set / "data" / "chunk-000").iterdir())
        assert f"is a part of a LeRobot data set; expected its folder, {data_set}" in self.message(
            file
        )
        with pytest.raises(RecordingError, match="no torque, but commanded positions: use --drive"):
            load_recording(data_set)
        file.write_bytes(file.read_bytes()[:-20])
        assert "is no readable Parquet file" in self.message(data_set)
        (data_set / "meta" / "info.json").write_text("{")
        assert "info.json: is no readable JSON file" in self.message(data_set)
        (data_set / "meta" / "info.json").write_text("{}")
        assert "info.json: no features; expected action, observation.state" in self.message(
            data_set
        )

    def test_of_features(self, tmp_path: Path) -> None:
        data_set = write_data_set(
            tmp_path / "set", *angles(1), features={"action": {"shape": [3], "names": None}}
        )
        assert "no feature 'observation.state'; the data set has action" in self.message(data_set)
        wrong = {"names": None, "shape": "x"}
        features = {"action": wrong, "observation.state": wrong}
        data_set = write_data_set(tmp_path / "wrong", *angles(1), features=features)
        assert "action has shape 'x'; expected a list with the number" in self.message(data_set)

    def test_of_lists(self, tmp_path: Path) -> None:
        data_set = write_data_set(tmp_path / "set", *angles(1), version="v2.1")
        (file,) = sorted((data_set / "data" / "chunk-000").iterdir())
        table = pq.read_table(file)
        rows = table.column("action").to_pylist()
        rows[6] = rows[6][:2]
        column = pa.array(rows, pa.list_(pa.float32()))
        pq.write_table(
            table.set_column(table.schema.get_field_index("action"), "action", column), file
        )
        assert "row 7, column action: 2 values; expected 3, as in the first row" in self.message(
            data_set
        )

    def test_of_calibrations(self, tmp_path: Path) -> None:
        data_set = write_data_set(tmp_path / "set", *angles(1))
        path = tmp_path / "arm.json"
        options: dict[str, Any] = {"units": "normalised", "calibration": path}
        path.write_text('{"shoulder_pan": {"drive_mode": 0, "range_min": 5}}')
        assert "arm.json: shoulder_pan: 'range_max'; expected numbers drive_mode" in self.message(
            data_set, **options
        )
        path.write_text("{}")
        assert "arm.json: no motor 'shoulder_pan'" in self.message(data_set, **options)

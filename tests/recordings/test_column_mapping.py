"""Files of column names, units and torque constants."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxcslc.recordings import ColumnMapping, RecordingError, load_recording


MAPPING = """
joints = ["shoulder", "elbow"]
[time]
columns = "stamp"
unit = "epoch"
[position]
columns = "p_{joint}"
unit = "deg"
sign = [1, -1]
[velocity]
columns = ["v0", "v1"]
unit = "rpm"
[torque]
columns = "i{index}"
unit = "mA"
constant = [0.05, 0.1]
gear = 100
"""
ROWS = "".join(f"{1.7e9 + i / 8};{90 + i};{i};6;{12 * i};{i + 500};2000;ok\n" for i in range(8))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text("stamp;p_shoulder;p_elbow;v0;v1;i0;i1;state\n" + ROWS)
    return path


@pytest.mark.parametrize("turned", [False, True])
def test_a_mapping_says_everything(log: Path, tmp_path: Path, turned: bool) -> None:
    path = tmp_path / "mapping.toml"
    path.write_text(MAPPING)
    joints = ("elbow", "shoulder") if turned else ("shoulder", "elbow")
    read = load_recording(log, joints=joints, columns=path)
    order = [1, 0] if turned else [0, 1]
    i = np.arange(8)
    assert read.joint_names == joints
    np.testing.assert_array_equal(read.time, i / 8)
    degrees = np.stack([90 + i, -i], 1)[:, order]
    np.testing.assert_allclose(read.position, np.deg2rad(degrees), rtol=1e-15)
    turns = np.stack([6 + 0 * i, 12 * i], 1)[:, order] / 60
    assert read.velocity is not None
    np.testing.assert_allclose(read.velocity, 2 * np.pi * turns, rtol=1e-15)
    torque = np.stack([(i + 500) * 0.05, 2000 * 0.1 + 0 * i], 1)[:, order] / 10
    np.testing.assert_allclose(read.torque, torque, rtol=1e-15)


def test_what_it_leaves_out_is_as_in_the_format(tmp_path: Path) -> None:
    """Only the unit of time of a file in the package's layout, and a sign."""
    path = tmp_path / "log.csv"
    path.write_text(
        "time,position_1,torque_1\n" + "".join(f"{20 * i},{i},{2 * i}\n" for i in range(6))
    )
    mapping = ColumnMapping.of({"time": {"unit": "ms"}, "torque": {"sign": -1}})
    read = load_recording(path, columns=mapping)
    np.testing.assert_allclose(read.time, 0.02 * np.arange(6), rtol=1e-15)
    assert read.position[:, 0].tolist() == list(range(6))
    assert read.torque[:, 0].tolist() == [-2.0 * i for i in range(6)]


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        (
            {"angle": {}},
            "columns: unknown key 'angle'; expected acceleration, command, command_topic",
        ),
        ({"time": {"sign": -1}}, r"columns, \[time\]: unknown key 'sign'; expected columns, unit"),
        ({"time": {"columns": ["a", "b"]}}, r"\[time\], columns: expected one column"),
        ({"position": "q"}, r"columns, \[position\]: expected a table, got 'q'"),
        ({"position": {"unit": "N"}}, r"\[position\], unit: expected rad, mrad.*, got 'N'"),
        ({"torque": {"unit": "V"}}, r"\[torque\], unit: expected N m.*; A or mA, got 'V'"),
        ({"torque": {"constant": 0}}, "constant: expected finite numbers other than 0, got 0"),
        ({"torque": {"gear": [1, True]}}, "gear: expected finite numbers other than 0"),
        ({"torque": {"gear": [1, 2], "sign": [1, 1, 1]}}, "gear: expected 3 numbers, got 2"),
        ({"joints": ["a", "a"]}, "joints: expected texts that differ"),
        ({"joints": []}, "joints: expected a list of texts"),
        ({"topic": 3}, "columns, topic: expected a text, got 3"),
    ],
)
def test_wrong_entries(document: dict[str, Any], expected: str) -> None:
    with pytest.raises(RecordingError, match=expected):
        ColumnMapping.of(document)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"torque": {"columns": "i{index}", "unit": "A"}}, "A is a current; expected constant = "),
        ({"torque": {"columns": "j{index}"}}, "no column 'j0' of columns; the file has stamp"),
        ({"torque": {"columns": ["i0"]}}, "1 columns of torque; expected 2, one for each joint"),
        ({"torque": {"columns": ["i0", "i0"]}}, "texts that differ"),
        ({"torque": {"columns": ["i0", "v0"]}, "velocity": {"columns": ["v0", "v1"]}}, "more than"),
        ({"torque": {"unit": "N m"}}, "expected columns = ...: the file's format has none"),
        ({"position": {"columns": "p_{joint}"}, "joints": None}, "no column 'p_1' of columns"),
        ({"torque": {"columns": "i{index}", "sign": [1, 1, 1]}}, "3 numbers of sign, constant"),
        ({"torque": {"columns": "i{index}", "unit": ["N m"] * 3}}, "3 units; expected 2"),
        ({"time": {}}, "no column 'time' of columns"),
    ],
)
def test_wrong_mappings_of_a_file(log: Path, changes: dict[str, Any], expected: str) -> None:
    document: dict[str, Any] = {
        "joints": ["shoulder", "elbow"],
        "time": {"columns": "stamp"},
        "position": {"columns": ["p_shoulder", "p_elbow"]},
        "torque": {"columns": ["i0", "i1"]},
        **changes,
    }
    document = {key: value for key, value in document.items() if value is not None}
    with pytest.raises(RecordingError, match=expected):
        load_recording(log, columns=ColumnMapping.of(document))


@pytest.mark.parametrize("turned", [False, True])
def test_joints_of_the_robot_name_columns(log: Path, tmp_path: Path, turned: bool) -> None:
    """`{joint}` is a name of the robot's file where the log has such columns, or else a number."""
    document: dict[str, Any] = {
        "time": {"columns": "stamp"},
        "position": {"columns": "p_{joint}"},
        "torque": {"columns": "t_{joint}"},
    }
    mapping = ColumnMapping.of(document)
    names = ("elbow", "shoulder") if turned else ("shoulder", "elbow")
    rows = "".join(f"{i},{i},{2 * i},{3 * i},{4 * i}\n" for i in range(6))
    log.write_text("stamp,p_shoulder,p_elbow,t_shoulder,t_elbow\n" + rows)
    by_name = load_recording(log, joints=names, columns=mapping)
    order = [1, 0] if turned else [0, 1]
    assert by_name.joint_names == names
    assert by_name.torque[1].tolist() == [[3, 4][i] for i in order]
    log.write_text("stamp,p_1,p_2,t_1,t_2\n" + rows)
    assert load_recording(log, joints=names, columns=mapping).torque[1].tolist() == [3, 4]
    assert load_recording(log, joints=names, columns=mapping).joint_names == names
    assert load_recording(log, joints=2, columns=mapping).position[1].tolist() == [1, 2]
    log.write_text("stamp,p_shoulder,t_shoulder\n" + "".join(f"{i},{i},{i}\n" for i in range(6)))
    with pytest.raises(RecordingError, match="no joint elbow; the recording has shoulder"):
        load_recording(log, joints=names, columns=mapping)


def test_wrong_files(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "mapping.toml"
    with pytest.raises(RecordingError, match=r"mapping\.toml: no such file"):
        load_recording(log, columns=path)
    path.write_text("[time")
    with pytest.raises(RecordingError, match=r"mapping\.toml: not valid TOML"):
        load_recording(log, columns=path)
    path.write_bytes(b"\xff")
    with pytest.raises(RecordingError, match=r"mapping\.toml: cannot be read"):
        load_recording(log, columns=path)

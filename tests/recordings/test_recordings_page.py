"""Every example of docs/recordings.md runs as it stands, in an empty folder."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from jaxcslc.recordings import ColumnMapping


PAGE = (Path(__file__).parents[2] / "docs" / "recordings.md").read_text("utf-8")


def write_logs() -> None:
    """Write the logs that examples of the page read: of ROS 2, Universal Robots and Franka."""
    ros = get_typestore(Stores.ROS2_HUMBLE)
    kinds = ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    joint_state, header, stamp = (ros.types[name] for name in kinds)
    with rosbag2.Writer("motion", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/joint_states", joint_state.__msgtype__, typestore=ros)
        for i in range(6):
            message = joint_state(
                header=header(stamp=stamp(sec=1_700_000_000, nanosec=2_000_000 * i), frame_id=""),
                name=["gripper", "elbow", "shoulder"],
                position=np.array([0.0, 0.1 * i, 0.2 * i]),
                velocity=np.zeros(0),
                effort=np.array([0.0, 1.0, 2.0]),
            )
            bag.write(topic, 2_000_000 * i, ros.serialize_cdr(message, joint_state.__msgtype__))
    names = [f"{name}_{i}" for name in ("actual_q", "target_moment") for i in range(6)]
    rows = [[0.002 * row, *(0.1 * row + i for i in range(12))] for row in range(6)]
    np.savetxt("ur.csv", rows, header=" ".join(["timestamp", *names]), comments="")
    stems = ("state.q", "state.dq", "state.tau_J")
    names = ["time", "success_rate", *(f"{stem}[{i}]" for stem in stems for i in range(7))]
    rows = [[5000 + i, 1, *[0.001 * i] * 21] for i in range(6)]
    np.savetxt("log.csv", rows, delimiter=",", header=", ".join(names), comments="")


def test_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    printed: list[str] = []
    for i, example in enumerate(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)):
        folder = tmp_path / str(i)
        folder.mkdir()
        monkeypatch.chdir(folder)
        write_logs()
        exec(compile(example, "docs/recordings.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    bag, universal, franka, table, mapped, arrays, named = printed
    assert named == "('shoulder', 'elbow') [1.571 0.   ]\n"
    assert table == "0 64\n64 36\n"
    assert mapped == "[0. 1. 2. 3. 4. 5.]\n"
    assert arrays == "('shoulder', 'elbow')\n"
    assert "which the controller computes from its own model" in universal
    assert franka == "[0.    0.001 0.002 0.003 0.004 0.005]\n"
    assert "[2. 1.] ('joints that are not read: gripper',)" in bag


def test_toml() -> None:
    mappings = [
        ColumnMapping.of(tomllib.loads(example))
        for example in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    ]
    assert [mapping.quantities["torque"].units for mapping in mappings] == [("A",), ("A",)]

"""One motion, written as the software of several robots writes it."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest

from jaxcslc.recordings import Recording


NANO = 1_000_000_000
START = 1_700_000_000 * NANO  # of a bag: nanoseconds since 1970


@pytest.fixture(scope="session")
def motion() -> Recording:
    """Six joints of Pinocchio's sample manipulator, 0.4 s, with its inverse dynamics."""
    model = pinocchio.buildSampleModelManipulator()
    data = model.createData()
    names = tuple(model.names)[1 : model.nv + 1]
    time = np.arange(50) * 0.008
    frequency = 1.0 + 0.3 * np.arange(model.nv)
    q = 0.7 * np.sin(np.outer(time, frequency) + frequency)
    qd = 0.7 * frequency * np.cos(np.outer(time, frequency) + frequency)
    qdd = -(frequency**2) * q
    torque = [pinocchio.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)]
    return Recording(time, q, np.array(torque), qd, joint_names=names)


def write_rows(
    path: Path,
    columns: dict[str, np.ndarray],
    *,
    delimiter: str = ",",
    header: Callable[[list[str]], str] | None = None,
) -> Path:
    """A table of columns as Python's `csv` writes it; `header` makes the first line of it."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        if header is None:
            writer.writerow(list(columns))
        else:
            file.write(header(list(columns)) + "\n")
        writer.writerows(np.stack(list(columns.values()), 1).tolist())
    return path


def numbered(stem: str, values: np.ndarray, form: str = "{}_{}") -> dict[str, np.ndarray]:
    """Columns `stem_0`, `stem_1` and on."""
    return {form.format(stem, i): column for i, column in enumerate(values.T)}


def write_bag(
    path: Path,
    recording: Recording,
    *,
    version: str = "sqlite3",
    topic: str = "/joint_states",
    names: Sequence[str] | None = None,
    gripper: bool = False,
    effort: bool = True,
    stamps: bool = True,
    repeat: int = 0,
    other_topic: bool = False,
) -> Path:
    """A bag of ROS 1 (`"bag"`) or 2 (`"sqlite3"`, `"mcap"`) that rosbags writes.

    Joints change their order from message to message; with `gripper`, one comes first; with
    `other_topic`, all of it goes to `/other` too.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    ros1 = version == "bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    state, header, time = (
        types.types[name]
        for name in (
            *("sensor_msgs/msg/JointState", "std_msgs/msg/Header"),
            "builtin_interfaces/msg/Time",
        )
    )
    writer: Any = (
        rosbag1.Writer(path)
        if ros1
        else rosbag2.Writer(
            path, version=9, storage_plugin=getattr(rosbag2.StoragePlugin, version.upper())
        )
    )
    labels = list(names or recording.joint_names or ())
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    with writer:
        connections = [
            writer.add_connection(name, state.__msgtype__, typestore=types)
            for name in (topic, *["/other"] * other_topic)
        ]
        rows = [*range(recording.samples), *[recording.samples - 1] * repeat]
        for row in rows:
            order = np.roll(np.arange(recording.joints), row % 3)
            extra = np.zeros(int(gripper))
            stamp = START + round(float(recording.time[row]) * NANO)
            shown = divmod(stamp, NANO) if stamps else (0, 0)
            fields = {"seq": row} if ros1 else {}
            message = state(
                header=header(stamp=time(*shown), frame_id="", **fields),
                name=["gripper"] * gripper + [labels[i] for i in order],
                position=np.concatenate([extra, recording.position[row, order]]),
                velocity=np.zeros(0),
                effort=np.concatenate([extra, recording.torque[row, order]])
                if effort
                else np.zeros(0),
            )
            for connection in connections:
                writer.write(connection, stamp + 1000, serialize(message, state.__msgtype__))
    return path

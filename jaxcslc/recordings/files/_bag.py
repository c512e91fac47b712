"""Joint states in bags of ROS 1 and 2, and in MCAP files."""

import contextlib
import dataclasses
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc._environment import require

from .._recording import RecordingError
from ._layout import Header, one_line, to_fix


_STATE = "sensor_msgs/msg/JointState"
_NANO = 1_000_000_000


@dataclasses.dataclass
class JointStates:
    """The joint states of one topic that are of the same joints, message by message.

    - `names`: of the joints, in the order of the first message.
    - `stamps`, `received`: times of the messages' headers, and of their arrival [ns].
    - `values`: for each message its positions, velocities and efforts, in the order of `names`.
    """

    topic: str
    names: tuple[str, ...]
    stamps: list[int] = dataclasses.field(default_factory=list)
    received: list[int] = dataclasses.field(default_factory=list)
    values: list[tuple[np.ndarray, ...]] = dataclasses.field(default_factory=list)

    def append(self, message: Any, received: int) -> None:
        """Add a message, whose joints may be in another order."""
        names = tuple(message.name)
        arrays = (message.position, message.velocity, message.effort)
        if names != self.names:
            order = [names.index(name) for name in self.names]
            arrays = (array[order] if len(array) == len(names) else array for array in arrays)
        stamp = message.header.stamp
        self.stamps.append(stamp.sec * _NANO + stamp.nanosec)
        self.received.append(received)
        self.values.append(tuple(arrays))

    def columns(self, path: Path) -> tuple[Header, dict[str, np.ndarray]]:
        """Return columns `time [ns]`, `position_NAME`, `velocity_NAME`, `effort_NAME`."""
        notes: list[str] = []
        time = np.array(self.stamps, np.int64)
        if not np.any(time):
            time = np.array(self.received, np.int64)
            notes.append(f"messages of {self.topic} have no stamps: times are those of arrival")
        kinds = ("position", "velocity", "effort")
        arrays: dict[str, np.ndarray] = {}
        for kind, values in zip(kinds, zip(*self.values, strict=True), strict=True):
            sizes = [len(value) for value in values]
            wrong = next((i for i, size in enumerate(sizes) if size != sizes[0]), None)
            if wrong is None and sizes[0] not in (0, len(self.names)):
                wrong = 0
            if wrong is not None:
                raise RecordingError(
                    f"{path}: message {wrong + 1} of {self.topic} has {sizes[wrong]} values of"
                    f" {kind}; expected {len(self.names)}, one a joint, as in the others"
                )
            if not sizes[0]:
                continue
            array = np.stack(values)
            if np.isnan(array).all():
                notes.append(f"{kind} of {self.topic} is not a number throughout: not read")
                continue
            arrays[kind] = array
        again = np.zeros(time.size, bool)
        again[1:] = np.diff(time) == 0
        for array in arrays.values():
            again[1:] &= np.all(array[1:] == array[:-1], axis=1)
        if again.any():
            notes.append(f"{again.sum()} messages that repeat the one before are left out")
        columns = {"time [ns]": time[~again]}
        for kind, array in arrays.items():
            columns |= {f"{kind}_{name}": array[~again, i] for i, name in enumerate(self.names)}
        hint = "" if "effort" in arrays else f"messages of {self.topic} have no effort"
        return Header(list(columns), self.names, tuple(notes), hint), columns


def read_bag(
    path: Path, joints: Sequence[str] | None, topic: str | None
) -> tuple[Header, dict[str, np.ndarray]]:
    """Read the joint states of a bag of ROS 1 or 2, or of an MCAP file.

    - `path`: a `.bag`, `.mcap` or `.db3` file, or the folder of a ROS 2 bag.
    - `joints`: that the messages are to have, among others; None for any.
    - `topic`: of the messages; by default the only one that has them.

    **Raises** `RecordingError` for what is no bag, no message of these joints, and several topics
    that have them; `MissingExtraError` without rosbags (the extra `bags`).
    """
    groups = joint_states(path, joints, topic)
    if len(groups) > 1:
        raise RecordingError(
            f"{path}: joint states of several: {_listed(groups)}; expected one: set topic = ... in"
            " a file of --columns"
        )
    return groups[0].columns(path)


def joint_states(path: Path, joints: Sequence[str] | None, topic: str | None) -> list[JointStates]:
    """Return the joint states of a bag that have these joints, by topic; see `read_bag`."""
    with _opened(path) as reader:
        connections = [c for c in reader.connections if c.msgtype == _STATE]
        if not connections:
            kinds = sorted({(c.topic, c.msgtype) for c in reader.connections})
            topics = [f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in kinds]
            raise RecordingError(
                f"{path}: no sensor_msgs/JointState; the bag has {', '.join(topics) or 'no topics'}"
            )
        if topic is not None:
            topics = sorted({c.topic for c in connections})
            connections = [c for c in connections if c.topic == topic]
            if not connections:
                raise RecordingError(
                    f"{path}: no joint states of topic {topic!r}; expected {' or '.join(topics)}"
                )
        groups: dict[tuple[str, tuple[str, ...]], JointStates] = {}
        for connection, received, data in reader.messages(connections):
            message = reader.deserialize(data, connection.msgtype)
            names = tuple(message.name)
            key = (connection.topic, tuple(sorted(names)))
            if key not in groups:
                if len(set(names)) != len(names):
                    raise RecordingError(f"{path}: {connection.topic} names a joint twice: {names}")
                groups[key] = JointStates(connection.topic, names)
            groups[key].append(message, received)
    wanted = [g for g in groups.values() if g.names and set(joints or ()) <= set(g.names)]
    if not wanted:
        have = _listed(groups.values()) if groups else "no message"
        # Of the topic with the most of them.
        lacking = [[name for name in joints or () if name not in g.names] for g in groups.values()]
        missing = min(lacking, key=len, default=list(joints or ()))
        named = f" of {', '.join(missing)}" if joints is not None else ""
        raise RecordingError(
            f"{path}: no joint states{named}; the bag has {have}; expected the names of the robot's"
            " file, or joints = {robot's name = 'recording's name'} in a file of --columns"
            + to_fix(missing, joints or ())
        )
    return wanted


@contextlib.contextmanager
def _opened(path: Path) -> Generator[Any]:
    """Open a bag with the message types of common ROS versions where it has none.

    Errors within are of one line.
    """
    reader = require("rosbags.highlevel", "bags").AnyReader
    types = require("rosbags.typesys", "bags")
    store = types.Stores.ROS1_NOETIC if path.suffix == ".bag" else types.Stores.ROS2_HUMBLE
    try:
        with reader([path], default_typestore=types.get_typestore(store)) as opened:
            yield opened
    except (RecordingError, PermissionError):
        raise
    except Exception as error:  # decompression, SQLite, YAML and rosbags have errors of their own
        reason = one_line(error) or type(error).__name__
        raise RecordingError(f"{path}: is no readable bag: {reason}") from error


def _listed(groups: Iterable[JointStates]) -> str:
    return "; ".join(
        f"{group.topic} ({len(group.values)} messages of {', '.join(group.names) or 'no joints'})"
        for group in groups
    )

"""Joint states and commanded positions in bags of ROS 1 and 2, and in MCAP files."""

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
_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
_ARRAY = "std_msgs/msg/Float64MultiArray"
_COMMAND_WORDS = ("command", "cmd", "goal", "target", "desired", "reference")
_NANO = 1_000_000_000  # nanoseconds in a second


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
            notes.append(f"{again.sum()} messages that repeat the one before are skipped")
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


def read_commanded_bag(
    path: Path, joints: Sequence[str] | None, topic: str | None, command_topic: str | None
) -> tuple[Header, dict[str, np.ndarray]]:
    """Read joint states of a bag with the commands that held at their times.

    **Arguments**

    - `path`, `joints`: as for `read_bag`.
    - `topic`: of the joint states; by default the only one, except those of commands.
    - `command_topic`: of messages of `JointTrajectory`, `Float64MultiArray` or `JointState`; by
      default the only one.

    **Returns** columns `time [ns]`, `position_NAME`, `command_NAME` and, where messages have them,
    `velocity_NAME` and, of efforts, `current_NAME`. States before the first command are skipped.

    **Raises** `RecordingError`: as `read_bag`, and for commands that are missing, ambiguous or of
    other joints.
    """
    groups = joint_states(path, joints, topic)
    if topic is None:
        groups = [g for g in groups if not _is_command(g.topic) and g.topic != command_topic]
    if len(groups) != 1:
        raise RecordingError(
            f"{path}: joint states of {_listed(groups) or 'commands only'}; expected one topic of"
            " measured states: set topic = ... in a file of --columns"
        )
    states = groups[0]
    header, columns = states.columns(path)
    commands = _commands(path, tuple(joints or states.names), states.names, command_topic)
    time = columns["time [ns]"]
    if not commands.stamped and any(states.stamps):
        # Commands have times of arrival only: states are put on that clock.
        lag = np.median(np.array(states.received) - np.array(states.stamps))
        time = time + int(lag)
    started = time >= commands.times[0]
    if not started.any():
        raise RecordingError(
            f"{path}: no joint state follows the first command of {commands.topic}"
        )
    notes = list(header.notes)
    if not started.all():
        notes.append(f"{(~started).sum()} joint states before the first command are skipped")
    positions = np.stack([columns[f"position_{name}"] for name in commands.names], axis=1)
    values = commands.sampled(time[started], positions[started])
    kinds = {"position": "position", "velocity": "velocity", "effort": "current"}
    table = {"time [ns]": time[started]} | {
        f"{kinds[kind]}_{name}": columns[f"{kind}_{name}"][started]
        for kind in kinds
        for name in commands.names
        if f"{kind}_{name}" in columns
    }
    table |= {f"command_{name}": values[:, i] for i, name in enumerate(commands.names)}
    notes += commands.notes
    return Header(list(table), commands.names, tuple(notes), header.hint), table


@dataclasses.dataclass
class _Commands:
    """Commanded positions of one topic.

    - `names`: of the joints, in the order of the values.
    - `stamped`: whether times are stamps of the messages, and not those of their arrival.
    - `times`: when each message begins to hold [ns].
    - `points`: for each message, times [ns], shape (points,), and positions, (points, joints).
    """

    topic: str
    names: tuple[str, ...]
    stamped: bool
    times: list[int]
    points: list[tuple[np.ndarray, np.ndarray]]
    notes: tuple[str, ...] = ()

    def sampled(self, time: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Return the commands at times of states [ns], none before the first message.

        A message holds until the next one. Between the points of a trajectory, positions are
        interpolated linearly, from where the command was (or the arm, at first) when it began.
        """
        values = np.empty((time.size, len(self.names)))
        current = position[0]
        bounds = np.searchsorted(time, [*self.times, np.iinfo(np.int64).max])
        for k, (start, (instants, points)) in enumerate(zip(self.times, self.points, strict=True)):
            later = instants > start
            if not later.all():
                current = points[~later][-1]
            # Seconds from the start: nanoseconds since 1970 have more digits than float64.
            knots = np.concatenate([[0.0], (instants[later] - start) / _NANO])
            heights = np.vstack([current, points[later]])
            rows = slice(bounds[k], bounds[k + 1])
            seconds = (time[rows] - start) / _NANO
            end = (self.times[k + 1] - start) / _NANO if k + 1 < len(self.times) else np.inf
            for joint in range(len(self.names)):
                values[rows, joint] = np.interp(seconds, knots, heights[:, joint])
            current = np.array(
                [np.interp(min(end, knots[-1]), knots, height) for height in heights.T]
            )
        return values


def _is_command(topic: str) -> bool:
    return any(word in topic.lower() for word in _COMMAND_WORDS)


def _commands(
    path: Path, joints: tuple[str, ...], measured: tuple[str, ...], topic: str | None
) -> _Commands:
    """Read the commands of `joints`; `measured` are those of the states, in their order."""

    def commands(connection: Any) -> bool:
        if topic is not None:
            return connection.topic == topic
        kind = connection.msgtype
        return kind == _TRAJECTORY or (kind in (_ARRAY, _STATE) and _is_command(connection.topic))

    with _opened(path) as reader:
        connections = [c for c in reader.connections if commands(c)]
        topics = sorted({c.topic for c in connections})
        if len(topics) != 1 or connections[0].msgtype not in (_TRAJECTORY, _ARRAY, _STATE):
            had = {(c.topic, c.msgtype.replace("/msg/", "/")) for c in reader.connections}
            listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(had))
            named = "" if topic is None else f" of topic {topic!r}"
            raise RecordingError(
                f"{path}: {len(topics) or 'no'} topics of commands{named}; expected one of"
                " JointTrajectory, Float64MultiArray or JointState: set command_topic = ... in a"
                f" file of --columns; the bag has {listed}"
            )
        messages = [
            (reader.deserialize(data, c.msgtype), received)
            for c, received, data in reader.messages(connections)
        ]
    if not messages:
        raise RecordingError(f"{path}: no message of {topics[0]}; expected commanded positions")
    stamps = [_stamp(message) for message, _ in messages]
    stamped = all(stamps)
    times = stamps if stamped else [received for _, received in messages]
    notes: tuple[str, ...] = ()
    if not stamped:
        notes = (f"commands of {topics[0]} have no stamps: times are those of arrival",)
    if connections[0].msgtype == _ARRAY:
        size = len(messages[0][0].data)
        names = joints if size == len(joints) else measured
        notes += (f"commands of {topics[0]} are taken in the order {', '.join(names)}",)
    else:
        names = joints
    points: list[tuple[np.ndarray, np.ndarray]] = []
    for number, ((message, _), start) in enumerate(zip(messages, times, strict=True), start=1):
        try:
            instants, positions = _points(message, names)
        except ValueError as error:
            raise RecordingError(
                f"{path}: message {number} of {topics[0]}: {error}; expected {', '.join(names)}"
            ) from error
        points.append((instants + start, positions))
    order = np.argsort(times, kind="stable")
    return _Commands(
        topics[0], names, stamped, [times[i] for i in order], [points[i] for i in order], notes
    )


def _stamp(message: Any) -> int:
    """Return the stamp of a message [ns]; 0 if it has none."""
    header = getattr(message, "header", None)
    return 0 if header is None else header.stamp.sec * _NANO + header.stamp.nanosec


def _points(message: Any, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return times since a message's start [ns], and positions of joints at them.

    **Raises** `ValueError` for other joints, or other numbers of positions.
    """
    if not hasattr(message, "points"):  # an array, or a joint state
        given = tuple(getattr(message, "name", names))
        instants, rows = (
            [0],
            [np.asarray(getattr(message, "data", getattr(message, "position", ())))],
        )
    else:
        given = tuple(message.joint_names)
        since = [point.time_from_start for point in message.points]
        instants = [time.sec * _NANO + time.nanosec for time in since]
        rows = [np.asarray(point.positions) for point in message.points]
        if not rows:
            raise ValueError("has no points")
    if missing := [name for name in names if name not in given]:
        raise ValueError(f"no command of {', '.join(missing)}")
    if wrong := [len(row) for row in rows if len(row) != len(given)]:
        raise ValueError(f"{wrong[0]} positions of {len(given)} joints")
    order = [given.index(name) for name in names]
    return np.array(instants, np.int64), np.array(rows, float)[:, order]


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
        raise RecordingError(
            f"{path}: is no readable bag: {reason}; expected a complete bag of ROS 1 or ROS 2"
        ) from error


def _listed(groups: Iterable[JointStates]) -> str:
    return "; ".join(
        f"{group.topic} ({len(group.values)} messages of {', '.join(group.names) or 'no joints'})"
        for group in groups
    )

"""Bags of ROS 1 and 2 and MCAP files, written by rosbags: joint states by topic and name."""

from pathlib import Path

import numpy as np
import pytest

from jaxcslc.recordings import (
    ColumnMapping,
    Recording,
    RecordingError,
    load_recording,
    load_recordings,
)
from tests.recordings.conftest import write_bag


@pytest.mark.parametrize("version", ["bag", "sqlite3", "mcap"])
def test_every_version_holds_the_motion(motion: Recording, tmp_path: Path, version: str) -> None:
    """Joints in changing order, with a gripper; stamps in nanoseconds since 1970."""
    path = write_bag(tmp_path / f"motion.{version}", motion, version=version, gripper=True)
    storage = [] if version == "bag" else [*path.glob("*.db3"), *path.glob("*.mcap")]
    assert len(storage) == (version != "bag")
    for file in [path, *storage]:  # a folder, and the file in it
        read = load_recording(file, joints=motion.joint_names)
        np.testing.assert_allclose(read.time, motion.time, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(read.position, motion.position)
        np.testing.assert_array_equal(read.torque, motion.torque)
        assert read.velocity is None
        assert read.notes == ("joints that are not read: gripper",)


def test_joints_that_are_taken_as_fixed(motion: Recording, tmp_path: Path) -> None:
    """How far they move; and of a bag that lacks joints of the robot, which could be fixed."""
    path = write_bag(tmp_path / "bag", motion)
    assert motion.joint_names is not None
    names = list(motion.joint_names)
    read = load_recording(path, joints=names[:-1], fixed=(names[-1], "nowhere"))
    ((name, extent),) = read.fixed_motion
    assert name == names[-1] and extent == np.ptp(motion.position[:, -1])
    assert read.rows(slice(0, 10)).fixed_motion == read.fixed_motion
    assert load_recording(path, joints=names[:-1]).fixed_motion == ()
    fingers = ("finger_1", "finger_2")
    with pytest.raises(RecordingError, match=r"need no columns: --fix finger_1,finger_2$"):
        load_recording(path, joints=[*names, *fingers])


def test_repeated_messages_and_missing_stamps_are_said(motion: Recording, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", motion, stamps=False, repeat=2)
    read = load_recording(path)
    assert read.samples == motion.samples
    assert read.joint_names == motion.joint_names
    np.testing.assert_allclose(read.time, motion.time, rtol=0, atol=1e-12)
    assert read.notes == (
        "messages of /joint_states have no stamps: times are those of arrival",
        "2 messages that repeat the one before are skipped",
    )


def test_a_mapping_changes_what_a_bag_does_not_say(motion: Recording, tmp_path: Path) -> None:
    """Efforts that are currents, and joints of other names."""
    path = write_bag(tmp_path / "bag", motion, gripper=True)
    names = motion.joint_names or ()
    constants = [0.1 + 0.01 * i for i in range(len(names))]
    document = {
        "joints": {f"robot_{name}": name for name in names[::-1]},
        "torque": {"unit": "A", "constant": constants, "gear": 100},
    }
    read = load_recording(
        path, joints=[f"robot_{name}" for name in names[::-1]], columns=ColumnMapping.of(document)
    )
    expected = motion.torque[:, ::-1] * (100 * np.array(constants))
    np.testing.assert_allclose(read.torque, expected, rtol=1e-14)


def test_several_topics(motion: Recording, tmp_path: Path) -> None:
    """One has to be named, or all are read."""
    path = write_bag(tmp_path / "bag", motion, version="mcap", other_topic=True)
    several = r"joint states of several: /joint_states \(50 .*; /other \(50 .*: set topic = "
    with pytest.raises(RecordingError, match=several):
        load_recording(path)
    one = load_recording(path, columns=ColumnMapping.of({"topic": "/other"}))
    every = load_recordings(path, joints=motion.joint_names)
    assert tuple(every) == ("/joint_states", "/other")
    for recording in (one, *every.values()):
        np.testing.assert_array_equal(recording.torque, motion.torque)


class TestWhatIsMissing:
    def message(self, path: Path, **options: object) -> str:
        with pytest.raises(RecordingError) as caught:
            load_recording(path, **options)  # pyright: ignore[reportArgumentType]
        text = str(caught.value)
        assert text.startswith(f"{path}: ") and "\n" not in text
        return text.removeprefix(f"{path}: ")

    def test_effort(self, motion: Recording, tmp_path: Path) -> None:
        path = write_bag(tmp_path / "bag", motion, effort=False)
        assert self.message(path) == "no torque: messages of /joint_states have no effort"

    def test_joints(self, motion: Recording, tmp_path: Path) -> None:
        path = write_bag(tmp_path / "bag", motion)
        text = self.message(path, joints=["shoulder"])
        assert text.startswith("no joint states of shoulder; the bag has /joint_states (50 mess")
        mapping = ColumnMapping.of({"topic": "/other"})
        text = self.message(path, columns=mapping)
        assert text == "no joint states of topic '/other'; expected /joint_states"

    def test_joint_states(self, tmp_path: Path) -> None:
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore

        types = get_typestore(Stores.ROS2_HUMBLE)
        text = types.types["std_msgs/msg/String"]
        path = tmp_path / "bag"
        plugin = rosbag2.StoragePlugin.MCAP
        with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/chatter", text.__msgtype__, typestore=types)
            writer.write(connection, 0, types.serialize_cdr(text(data="hello"), text.__msgtype__))
        assert self.message(path) == (
            "no sensor_msgs/JointState; the bag has /chatter (std_msgs/String)"
        )

    @pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
    def test_a_bag(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"broken{suffix}"
        path.write_bytes(b"\x89MCAP0\r\n and nothing that follows")
        assert self.message(path).startswith("is no readable bag: ")

    def test_a_damaged_end(self, motion: Recording, tmp_path: Path) -> None:
        whole = write_bag(tmp_path / "whole.bag", motion, version="bag").read_bytes()
        path = tmp_path / "half.bag"
        path.write_bytes(whole[: len(whole) // 2])
        assert self.message(path).startswith("is no readable bag: ")

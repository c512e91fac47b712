"""Tables that other software wrote: layouts of robots' logs, units, comments, time stamps."""

import decimal
import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxcslc.recordings import Recording, RecordingError, load_recording, resample, save_recording
from tests.recordings.conftest import numbered, write_rows


# Conversions to other units and back round twice.
ROUNDING = 1e-14


def assert_same(recording: Recording, other: Recording, *, time: float = 1e-12) -> None:
    """Equal to rounding, time counted from the first sample."""
    start = other.time - other.time[0]
    np.testing.assert_allclose(recording.time, start, rtol=0, atol=time)
    np.testing.assert_allclose(recording.position, other.position, rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(recording.torque, other.torque, rtol=ROUNDING, atol=ROUNDING)


def joints_of(recording: Recording, count: int) -> Recording:
    """So many joints, numbered: the first again where there are not as many."""
    assert recording.velocity is not None
    columns = np.arange(count) % recording.joints
    arrays = (recording.position, recording.torque, recording.velocity)
    return Recording(recording.time, *(array[:, columns] for array in arrays))


class TestUniversalRobots:
    """Layout of `CSVWriter` in the RTDE client library: vectors are numbered from 0."""

    def columns(self, motion: Recording, torque: str) -> dict[str, np.ndarray]:
        assert motion.velocity is not None
        return {
            "timestamp": motion.time + 4711.25,
            **numbered("target_q", motion.position + 1.0),
            **numbered("actual_q", motion.position),
            **numbered("actual_qd", motion.velocity),
            **numbered(torque, motion.torque),
            "robot_mode": np.full(motion.samples, 7),
        }

    @pytest.mark.parametrize("delimiter", [" ", ","])
    def test_measured_torque(self, motion: Recording, tmp_path: Path, delimiter: str) -> None:
        columns = self.columns(motion, "actual_current_as_torque")
        path = write_rows(tmp_path / "ur.csv", columns, delimiter=delimiter)
        read = load_recording(path, joints=[f"joint {i}" for i in range(1, 7)])
        assert_same(read, motion)
        np.testing.assert_array_equal(read.velocity, motion.velocity)
        assert not read.notes

    def test_the_controllers_model_is_named(self, motion: Recording, tmp_path: Path) -> None:
        path = write_rows(tmp_path / "ur.csv", self.columns(motion, "target_moment"))
        read = load_recording(path)
        assert_same(read, motion)
        assert "torques are target_moment, which the controller computes" in read.notes[0]

    def test_currents_need_constants(self, motion: Recording, tmp_path: Path) -> None:
        path = write_rows(tmp_path / "ur.csv", self.columns(motion, "actual_current"))
        with pytest.raises(RecordingError, match=r"no torque: the file has motor currents \(act"):
            load_recording(path)


def test_torques_of_logs_are_measured_and_those_of_own_columns_demanded(tmp_path: Path) -> None:
    time, x = 0.01 * np.arange(8), np.zeros((8, 1))
    save_recording(Recording(time, x, x, torque_measured=True), tmp_path / "own.csv")
    assert not load_recording(tmp_path / "own.csv").torque_measured
    lines = ["t,q_elbow,tau_elbow", *(f"{0.01 * row:g},0,0" for row in range(8))]
    (tmp_path / "named.csv").write_text("\n".join(lines), encoding="utf-8")
    read = load_recording(tmp_path / "named.csv")
    assert read.torque_measured
    assert read.rows(slice(1, 7)).torque_measured
    assert resample(read, 0.005, drop_stale=False).torque_measured


def test_libfranka(motion: Recording, tmp_path: Path) -> None:
    """Layout of `franka::logToCSV`: milliseconds, spaces after some commas, commands at the end."""
    motion = joints_of(motion, 7)
    assert motion.velocity is not None
    form = "{}[{}]"
    columns = {
        "time": 1000 * (motion.time + 12.0),
        "success_rate": np.ones(motion.samples),
        **numbered("state.q", motion.position, form),
        **numbered("state.q_d", motion.position + 1, form),
        **numbered("state.dq", motion.velocity, form),
        **numbered("state.tau_J", motion.torque, form),
        **numbered("cmd.tau_J_d", motion.torque + 5, form),
    }
    path = write_rows(tmp_path / "log.csv", columns, header=", ".join)
    read = load_recording(path, joints=7)
    assert_same(read, motion, time=1e-11)
    np.testing.assert_array_equal(read.velocity, motion.velocity)


def test_logs_that_lack_a_column(tmp_path: Path) -> None:
    names = ["time", *(f"{stem}[{i}]" for stem in ("state.q", "state.tau_J") for i in range(7))]
    path = tmp_path / "log.csv"
    path.write_text(",".join(name for name in names if name != "state.tau_J[3]") + "\n")
    with pytest.raises(RecordingError, match=r"no column 'state.tau_J\[3\]'; the file has time"):
        load_recording(path)
    path.write_text(",".join(names[:8]) + "\n")
    with pytest.raises(RecordingError, match=r"no torque: the log has no column state.tau_J\[6\]"):
        load_recording(path)


class TestNamedColumns:
    def test_units_and_names(self, motion: Recording, tmp_path: Path) -> None:
        names = motion.joint_names or ()
        lines = ["# recorded on the bench", "", "t [us]"]
        lines[2] += "".join(f", q_{name} [deg]" for name in names)
        lines[2] += "".join(f", tau_{name} [mN m]" for name in names) + ", mode"
        table = [1e6 * (motion.time + 3), *np.rad2deg(motion.position.T), *(1e3 * motion.torque.T)]
        rows = [", ".join(map(repr, row)) + ", ready" for row in np.stack(table, 1).tolist()]
        rows.insert(20, "# the arm was pushed here")
        path = tmp_path / "bench.csv"
        path.write_text("\n".join([*lines, *rows]))
        read = load_recording(path, joints=names)
        assert_same(read, motion, time=1e-11)
        assert read.joint_names == names
        assert read.notes == ("columns that are not read: mode",)

        rows[30] = rows[30].replace(",", ", x", 1)
        path.write_text("\n".join([*lines, *rows]))
        line = r"row 30 \(line 34\), column q_\S+ \[deg\]: ' x.*'; expected a number"
        with pytest.raises(RecordingError, match=line):
            load_recording(path)

    def test_order_is_that_of_the_robot(self, motion: Recording, tmp_path: Path) -> None:
        names = motion.joint_names
        assert names is not None
        path = tmp_path / "motion.csv"
        save_recording(motion, path)
        assert path.read_text().startswith(f"time,position_{names[0]},")
        turned = load_recording(path, joints=names[::-1])
        assert turned.joint_names == names[::-1]
        np.testing.assert_array_equal(turned.position, motion.position[:, ::-1])
        np.testing.assert_array_equal(turned.torque, motion.torque[:, ::-1])
        fewer = load_recording(path, joints=names[:2])
        np.testing.assert_array_equal(fewer.torque, motion.torque[:, :2])
        assert fewer.notes == (f"joints that are not read: {', '.join(names[2:])}",)

    @pytest.mark.parametrize(
        ("joints", "expected"),
        [
            (("a", "tool"), "no joint tool; the recording has a, b; expected the names of the"),
            (("joint 1", "joint 2"), "joints a, b, but the robot's joints have no names"),
            (3, r"2 position columns \(a, b\); expected 3, one for each joint"),
        ],
    )
    def test_joints_that_do_not_match(
        self, tmp_path: Path, joints: tuple[str, ...] | int, expected: str
    ) -> None:
        path = tmp_path / "named.csv"
        path.write_text("time,position_a,position_b,torque_a,torque_b\n")
        with pytest.raises(RecordingError, match=expected):
            load_recording(path, joints=joints)

    def test_names_that_count_up_need_no_names_of_the_robot(self, tmp_path: Path) -> None:
        path = tmp_path / "named.csv"
        rows = "".join(f"{i},{i},{-i},0,{i}\n" for i in range(6))
        path.write_text("t,q_arm1_joint,q_arm2_joint,tau_arm1_joint,tau_arm2_joint\n" + rows)
        read = load_recording(path, joints=("joint 1", "joint 2"))
        assert read.position[1].tolist() == [1.0, -1.0]

    @pytest.mark.parametrize(
        ("header", "expected"),
        [
            ("t [h],q_a,tau_a", "column 't \\[h\\]': 'h' is no unit of time; expected s, ms, us"),
            ("t,q_a [N m],tau_a", "'N m' is no unit of position; expected rad, mrad, deg"),
            ("t,q_a,tau_a [A]", "no torque: the file has motor currents"),
            ("t,q_a,current_a", "no torque: the file has motor currents"),
            ("t,q_a,q_b,tau_a", "no torque of joint 'b'; the file has positions of a, b and"),
            ("t,time,q_a,tau_a", "columns of time: 't', 'time'; expected one"),
            ("q_a,tau_a", "columns of time: none; expected one"),
            ("t,q_a,tau_a,q_a", "column 'q_a' occurs more than once"),
            ("t,q_a,i_a", "no torque: .* expected torque_1 and on, or by joint as in torque_elbow"),
        ],
    )
    def test_wrong_headers(self, tmp_path: Path, header: str, expected: str) -> None:
        path = tmp_path / "named.csv"
        path.write_text(header + "\n")
        with pytest.raises(RecordingError, match=expected):
            load_recording(path)


class TestText:
    @pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", "   "])
    def test_savetxt(self, motion: Recording, tmp_path: Path, delimiter: str) -> None:
        """`numpy.savetxt` makes a comment of its header."""
        two = joints_of(motion, 2)
        names = ["time", "position_1", "position_2", "torque_1", "torque_2"]
        table = np.concatenate([two.time[:, None], two.position, two.torque], axis=1)
        path = tmp_path / "motion.csv"
        np.savetxt(path, table, delimiter=delimiter, header=delimiter.join(names))
        read = load_recording(path)
        np.testing.assert_array_equal(read.position, two.position)
        np.testing.assert_array_equal(read.torque, two.torque)

    def test_nanoseconds_since_1970_are_exact(self, tmp_path: Path) -> None:
        """In float64 they are multiples of 256 ns."""
        path = tmp_path / "epoch.csv"
        stamps = [1_700_000_000_000_000_000 + 1_000_003 * i for i in range(8)]
        path.write_text(
            "t [ns],q_a,tau_a\n" + "".join(f"{t}, {i}, 0\n" for i, t in enumerate(stamps))
        )
        expected = 1e-9 * 1_000_003 * np.arange(8)
        np.testing.assert_allclose(load_recording(path).time, expected, rtol=1e-15)


class TestParquet:
    def test_time_stamps_and_decimals(self, motion: Recording, tmp_path: Path) -> None:
        first = joints_of(motion, 1)
        digits = [decimal.Decimal(f"{value:.9f}") for value in first.position[:, 0]]
        for unit, ticks in (("ns", 10**9), ("us", 10**6), ("ms", 10**3)):
            stamps = 1_700_000_000 * ticks + np.round(first.time * ticks).astype(np.int64)
            table = {
                "time": pa.array(stamps, pa.timestamp(unit, tz="UTC")),
                "position_1": pa.array(digits),
                "torque_1": first.torque[:, 0].astype(np.float32),
            }
            path = tmp_path / f"{unit}.parquet"
            pq.write_table(pa.table(table), path)
            read = load_recording(path)
            np.testing.assert_allclose(read.time, first.time, rtol=0, atol=1e-12)
            np.testing.assert_allclose(read.position[:, 0], [float(d) for d in digits], rtol=1e-15)

    def test_time_stamps_elsewhere(self, tmp_path: Path) -> None:
        stamps = pa.array(np.arange(6), pa.timestamp("ns"))
        numbers = np.arange(6.0)
        path = tmp_path / "stamps.parquet"
        pq.write_table(pa.table({"time": numbers, "position_1": stamps, "torque_1": numbers}), path)
        with pytest.raises(RecordingError, match="column position_1 holds timestamp"):
            load_recording(path)


class TestNumpy:
    def test_arrays(self, motion: Recording, tmp_path: Path) -> None:
        path = tmp_path / "motion.npz"
        names = motion.joint_names or ()
        assert motion.velocity is not None
        np.savez_compressed(
            path,
            time=motion.time,
            position=motion.position,
            effort=motion.torque,
            qd=motion.velocity,
            joint_names=np.array(names),
        )
        read = load_recording(path, joints=names[::-1])
        np.testing.assert_array_equal(read.torque, motion.torque[:, ::-1])
        assert read.velocity is not None
        np.testing.assert_array_equal(read.velocity, motion.velocity[:, ::-1])

    def test_one_joint_and_another_suffix(self, tmp_path: Path) -> None:
        path = tmp_path / "motion.dat"
        with path.open("wb") as file:
            np.savez(file, t=np.arange(6), q=np.arange(6.0), tau=np.ones(6))
        assert load_recording(path).position[:, 0].tolist() == list(range(6))

    def test_wrong_files(self, tmp_path: Path) -> None:
        path = tmp_path / "motion.npz"
        np.savez(path, t=np.arange(6), q=np.zeros((6, 2)), tau=np.zeros((5, 2)))
        with pytest.raises(RecordingError, match=r"arrays of different lengths: t 6, q\[0\] 6"):
            load_recording(path)
        np.savez(path, note=np.array("text"))
        with pytest.raises(RecordingError, match="has note; expected arrays time, position"):
            load_recording(path)
        path.write_bytes(b"PK\x03\x04 and no more")
        with pytest.raises(RecordingError, match=r"is no readable \.npz file"):
            load_recording(path)
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
        with pytest.raises(RecordingError, match=r"holds one array; expected an \.npz"):
            load_recording(path)

    def test_an_array_that_claims_more_than_the_file_holds(self, tmp_path: Path) -> None:
        """A header of 10¹⁵ numbers before a few bytes takes no memory."""
        header = io.BytesIO()
        claimed = {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
        np.lib.format.write_array_header_1_0(header, claimed)
        path = tmp_path / "motion.npz"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("time.npy", header.getvalue() + bytes(80))
        with pytest.raises(RecordingError, match=r"time\.npy claims 8e\+15 bytes, .* 208 at most"):
            load_recording(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_name_that_is_no_utf8(motion: Recording, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / os.fsdecode(b"log\xff" + suffix.encode())
    save_recording(motion, path)
    np.testing.assert_array_equal(load_recording(path).position, motion.position)

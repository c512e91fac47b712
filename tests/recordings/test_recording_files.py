"""Recording files: round trips, and one clear line for everything that can be wrong."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxcslc.recordings import (
    Recording,
    RecordingChunk,
    RecordingError,
    iterate_recording,
    load_recording,
    save_recording,
)


HEADER = "time,position_1,position_2,torque_1,torque_2"
ROWS = [f"{0.01 * row:.2f},{row},{-row},{row / 8},{row / 3!r}" for row in range(8)]


def random_recording(
    rng: np.random.Generator, samples: int = 100, joints: int = 3, motion: bool = True
) -> Recording:
    def values() -> np.ndarray:
        return rng.standard_normal((samples, joints)) * 10.0 ** rng.integers(-12, 12, joints)

    return Recording(
        np.cumsum(rng.uniform(1e-3, 3e-3, samples)),
        values(),
        values(),
        values() if motion else None,
        values() if motion else None,
    )


def same(one: Recording | RecordingChunk, other: Recording | RecordingChunk) -> bool:
    names = ("time", "position", "torque", "velocity", "acceleration")
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(a is b if a is None or b is None else np.array_equal(a, b) for a, b in pairs)


def written(folder: Path, *rows: str, header: str = HEADER, name: str = "train.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def message(path: Path, read: Callable[[Path], object] = load_recording) -> str:
    with pytest.raises(RecordingError) as caught:
        read(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def drain(path: Path) -> None:
    for _ in iterate_recording(path, 3):
        pass


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".CSV"])
@pytest.mark.parametrize("motion", [True, False])
def test_round_trip_is_exact(
    tmp_path: Path, rng: np.random.Generator, suffix: str, motion: bool
) -> None:
    recording = random_recording(rng, motion=motion)
    path = tmp_path / f"motion{suffix}"
    save_recording(recording, path)
    assert same(load_recording(path), recording)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_columns_come_in_any_order_and_any_number_of_lines(tmp_path: Path, suffix: str) -> None:
    if suffix == ".csv":
        path = tmp_path / "motion.csv"
        # A byte order mark, line ends of another system, an empty line, spaces about a number.
        text = "torque_1,time,position_1\r\n" + "\r\n".join(
            f"{row}, {row / 10} ,{-row}" for row in range(6)
        )
        path.write_bytes(b"\xef\xbb\xbf" + text.replace("\r\n3", "\r\n\r\n3").encode())
    else:
        path = tmp_path / "motion.parquet"
        rows = np.arange(6)
        pq.write_table(
            pa.table({"torque_1": rows, "time": rows / 10, "position_1": -rows.astype("float32")}),
            path,
        )
    recording = load_recording(path)
    assert recording.time.tolist() == [row / 10 for row in range(6)]
    assert recording.position[:, 0].tolist() == [-row for row in range(6)]
    assert recording.torque[:, 0].tolist() == list(range(6))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("chunk_rows", [1, 7, 50, 100, 1000])
def test_chunks_put_together_are_the_recording(
    tmp_path: Path, rng: np.random.Generator, suffix: str, chunk_rows: int
) -> None:
    recording = random_recording(rng)
    path = tmp_path / f"motion{suffix}"
    save_recording(recording, path)
    chunks = list(iterate_recording(path, chunk_rows))
    assert [chunk.first for chunk in chunks] == list(range(0, 100, chunk_rows))
    assert all(chunk.samples == chunk_rows for chunk in chunks[:-1])
    for name in ("time", "position", "torque", "velocity", "acceleration"):
        joined = np.concatenate([getattr(chunk, name) for chunk in chunks])
        assert np.array_equal(joined, getattr(recording, name))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_parts_are_written_as_one(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    recording = random_recording(rng)
    path = tmp_path / f"motion{suffix}"
    save_recording((recording.rows(slice(n, n + 20)) for n in range(0, 100, 20)), path)
    assert same(load_recording(path), recording)


def test_rows_beyond_one_read_are_numbered_through(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    samples = 30_000
    recording = random_recording(rng, samples, joints=6, motion=False)
    for suffix in (".csv", ".parquet"):
        path = tmp_path / f"long{suffix}"
        save_recording(recording, path)
        assert same(load_recording(path), recording)
    path = tmp_path / "long.csv"
    lines = path.read_text().splitlines()
    lines[25_001] = lines[25_000]
    path.write_text("\n".join(lines))
    for read in (load_recording, drain):
        assert message(path, read).startswith(
            "row 25001 (line 25002): repeats the row before it; expected a new sample"
        )


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        pytest.param(
            "time,position_1,position_2,position_4,torque_1,torque_2,torque_3,torque_4",
            "missing column position_3 before position_4; expected time, position_1..n",
            id="gap",
        ),
        pytest.param(
            "time,position_2,torque_2", "missing column position_1 before position_2", id="first"
        ),
        pytest.param("position_1,torque_1", "missing column time;", id="time"),
        pytest.param("time,position_1", "missing column torque_1 (no torque columns", id="torque"),
        pytest.param(
            "time,position_1,position_2,torque_1",
            "2 position columns but 1 torque columns",
            id="fewer torques",
        ),
        pytest.param(
            "time,position_1,torque_1,torque_2",
            "1 position columns but 2 torque columns",
            id="more torques",
        ),
        pytest.param(
            "time,position_1,position_2,torque_1,torque_2,velocity_1",
            "2 position columns but 1 velocity columns",
            id="velocities",
        ),
        pytest.param(
            "time,position_1,torque_1,current_1,current_2",
            "unknown column current_1, current_2;",
            id="extra",
        ),
        pytest.param("time,position_01,torque_1", "unknown column position_01", id="padded"),
        pytest.param("time,position_1,torque_1,", "unknown column ''", id="nameless"),
        pytest.param(
            "time,position_1,torque_1,torque_1", "column torque_1 occurs more than once", id="twice"
        ),
        pytest.param("a,b,c,d,e,f", "unknown column a, b, c, d and 2 more", id="another table"),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_wrong_columns(tmp_path: Path, header: str, expected: str, suffix: str) -> None:
    names = header.split(",")
    if suffix == ".csv":
        path = written(tmp_path, *[",".join("1" for _ in names)] * 6, header=header)
    else:
        path = tmp_path / "train.parquet"
        columns = [pa.array(np.arange(6.0)) for _ in names]
        pq.write_table(pa.Table.from_arrays(columns, names=names), path)
    for read in (load_recording, drain):
        assert expected in message(path, read)


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        pytest.param("fast", "'fast'; expected a number", id="word"),
        pytest.param('"0,5"', "'0,5'; expected a number with a decimal point", id="comma"),
        pytest.param(
            "", "an empty cell; expected a number; delete the row, or fill the cell", id="empty"
        ),
        pytest.param("NULL", "'NULL'; expected a number", id="null"),
        pytest.param("1_000", "'1_000'; expected a number", id="underscore"),
        pytest.param("0x10", "'0x10'; expected a number", id="hexadecimal"),
        pytest.param(
            "nan",
            "nan where a finite number was expected; leave such rows out, or interpolate",
            id="nan",
        ),
        pytest.param("-inf", "-inf where a finite number was expected", id="inf"),
    ],
)
@pytest.mark.parametrize("column", [0, 3])
def test_wrong_cells(tmp_path: Path, cell: str, expected: str, column: int) -> None:
    cells = ROWS[4].split(",")
    cells[column] = cell
    path = written(tmp_path, *ROWS[:4], ",".join(cells), *ROWS[5:])
    name = HEADER.split(",")[column]
    for read in (load_recording, drain):
        assert message(path, read) == f"row 5 (line 6), column {name}: {expected}"


@pytest.mark.parametrize(
    ("row", "cells"), [("0.04,1,2,3", 4), ("0.04,1,2,3,4,5", 6)], ids=["short", "long"]
)
def test_rows_of_a_wrong_length(tmp_path: Path, row: str, cells: int) -> None:
    path = written(tmp_path, *ROWS[:4], row, *ROWS[5:])
    assert message(path) == f"row 5 (line 6): {cells} cells; expected 5, one per column"


def test_time_that_does_not_increase(tmp_path: Path) -> None:
    swapped = written(tmp_path, *ROWS[:4], ROWS[5], ROWS[4], *ROWS[6:])
    assert message(swapped) == (
        "row 6 (line 7), column time: 0.04 s follows 0.05 s; expected time to increase strictly"
    )
    repeated = written(tmp_path, *ROWS[:4], ROWS[3], *ROWS[4:])
    assert message(repeated) == (
        "row 5 (line 6): repeats the row before it; expected a new sample in every row:"
        " delete repeated rows"
    )


def test_lines_are_counted_past_empty_ones(tmp_path: Path) -> None:
    path = written(tmp_path, *ROWS[:2], "", "", *ROWS[2:4], "oops,1,2,3,4")
    assert message(path).startswith("row 5 (line 8), column time: 'oops'")


@pytest.mark.parametrize("rows", [0, 1, 4])
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_too_few_rows(tmp_path: Path, rows: int, suffix: str) -> None:
    path = written(tmp_path, *ROWS[:rows])
    if suffix == ".parquet":
        columns = np.array([row.split(",") for row in ROWS[:rows]], dtype=float).reshape(rows, 5)
        path = tmp_path / "train.parquet"
        pq.write_table(pa.table(dict(zip(HEADER.split(","), columns.T, strict=True))), path)
    assert message(path) == f"{rows or 'no'} rows of samples; expected at least 5"
    if rows == 0:
        assert message(path, drain) == "no rows of samples; expected at least 1"
    else:
        drain(path)


def test_files_that_are_none(tmp_path: Path) -> None:
    assert message(tmp_path / "gone.csv") == "no such file"
    (tmp_path / "folder.csv").mkdir()
    assert message(tmp_path / "folder.csv").startswith("is a folder without the metadata.yaml of")
    for name in ("empty.csv", "empty.parquet"):
        (tmp_path / name).touch()
        assert "the file is empty" in message(tmp_path / name)
    assert "unknown file type '.txt'" in message(written(tmp_path, *ROWS, name="train.txt"))
    assert "unknown file type ''" in message(written(tmp_path, *ROWS, name="train"))


def test_files_that_are_not_what_they_say(tmp_path: Path, rng: np.random.Generator) -> None:
    text = written(tmp_path, *ROWS, name="text.parquet")
    assert message(text).startswith("is no readable Parquet file: ")

    whole = tmp_path / "whole.parquet"
    save_recording(random_recording(rng), whole)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(whole.read_bytes())
    assert re.match("is no CSV text in UTF-8|unknown column", message(binary))

    half = tmp_path / "half.parquet"
    half.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert message(half).startswith("is no readable Parquet file: ")

    damaged = tmp_path / "damaged.parquet"
    content = bytearray(whole.read_bytes())
    content[4:200] = bytes(196)
    damaged.write_bytes(content)
    assert message(damaged).startswith("is damaged after row 0: ")

    latin = tmp_path / "latin.csv"
    latin.write_bytes("\n".join([HEADER, *ROWS, "0.08,1,2,3,4°"]).encode("latin-1"))
    assert message(latin).startswith("is no CSV text in UTF-8: ")


def test_parquet_columns_of_text_and_missing_values(tmp_path: Path) -> None:
    path = tmp_path / "train.parquet"
    numbers = pa.array(np.arange(6.0))
    names = ["time", "position_1", "torque_1"]
    words = pa.array(["a"] * 6)
    pq.write_table(pa.Table.from_arrays([numbers, words, numbers], names=names), path)
    assert message(path) == "column position_1 holds string; expected numbers"
    holes = pa.array([0.0, 1.0, None, 3.0, 4.0, 5.0])
    pq.write_table(pa.Table.from_arrays([numbers, numbers, holes], names=names), path)
    assert message(path) == (
        "row 3, column torque_1: an empty cell; expected a number; delete the row, or fill the cell"
    )
    nans = pa.array([0.0, 1.0, 2.0, np.nan, 4.0, 5.0])
    pq.write_table(pa.Table.from_arrays([numbers, numbers, nans], names=names), path)
    where = "row 4, column torque_1: nan where a finite number was expected"
    assert message(path) == f"{where}; leave such rows out, or interpolate"


def test_another_number_of_joints(tmp_path: Path) -> None:
    path = written(tmp_path, *ROWS)
    assert load_recording(path, joints=2).joints == 2
    expected = "2 position columns; expected 7, one for each joint of the robot"
    assert message(path, lambda path: load_recording(path, joints=7)) == expected
    assert message(path, lambda path: iterate_recording(path, 5, joints=7)) == expected


def test_chunks_without_rows(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="chunks of 0 rows; expected 1 or more"):
        iterate_recording(written(tmp_path, *ROWS), 0)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "motion.csv"
    recording = random_recording(rng)
    save_recording(recording, path)
    with pytest.raises(RecordingError, match="parts of the recording differ in their columns"):
        save_recording([recording, random_recording(rng, motion=False)], path)
    with pytest.raises(RecordingError, match="no parts of a recording to write"):
        save_recording([], path)
    assert same(load_recording(path), recording)
    assert os.listdir(tmp_path) == ["motion.csv"]
    with pytest.raises(RecordingError, match=r"unknown file type '\.xlsx'; expected"):
        save_recording(recording, tmp_path / "motion.xlsx")
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        save_recording(recording, tmp_path / "nowhere" / "motion.csv")

"""Guesses of columns by their values, against motions of which each column is known."""

from pathlib import Path

import numpy as np
import pytest

from jaxcslc.recordings import (
    ColumnMapping,
    RecordingError,
    column_names_of,
    load_recording,
    mapping_by_values,
)


NAMES = ("shoulder", "elbow")
LIMITS = ((-3.0, 3.0), (-2.0, 2.0))
TIME = 0.004 * np.arange(1500.0)
POSITION = np.stack([np.sin(3.0 * TIME), 1.5 * np.cos(2.0 * TIME)], axis=1)
VELOCITY = np.stack([3.0 * np.cos(3.0 * TIME), -3.0 * np.sin(2.0 * TIME)], axis=1)
NOISE = np.random.default_rng(0).normal(size=POSITION.shape)
TORQUE = 5.0 * np.sin(POSITION) + 2.0 * np.sign(VELOCITY) + 0.05 * NOISE


def written(path: Path, header: str, *columns: np.ndarray, time: np.ndarray = TIME) -> Path:
    np.savetxt(path, np.column_stack([time, *columns]), delimiter=",", header=header, comments="")
    return path


@pytest.mark.parametrize("stems", [("j", "t"), ("a", "b"), ("x_", "y_")])
def test_short_names(stems: tuple[str, str], tmp_path: Path) -> None:
    first, second = ([f"{stem}{i}" for i in (1, 2)] for stem in stems)
    header = ",".join(["time", *first, *second])
    path = written(tmp_path / "log.csv", header, POSITION, TORQUE)
    mapping, assumed = mapping_by_values(path, NAMES, LIMITS)
    assert mapping == {
        "time": {"columns": "time"},
        "position": {"columns": first},
        "torque": {"columns": second},
    }
    assert "within the joints' limits in rad" in assumed
    # In another order, the other way round.
    header = ",".join(["time", *second, *first])
    path = written(tmp_path / "other.csv", header, TORQUE, POSITION)
    assert mapping_by_values(path, NAMES, LIMITS)[0] == mapping


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1.0), ("deg", 180.0 / np.pi)])
@pytest.mark.parametrize("ticks", [1.0, 1000.0])
def test_without_a_header(unit: str, factor: float, ticks: float, tmp_path: Path) -> None:
    quantities = factor * POSITION, TORQUE, factor * VELOCITY
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([ticks * TIME, *quantities]), delimiter=" ")
    assert column_names_of(path) == tuple(f"column {i}" for i in range(1, 8))
    mapping, _ = mapping_by_values(path, NAMES, LIMITS)
    columns = {name: table["columns"] for name, table in mapping.items()}
    assert columns == {
        "time": "column 1",
        "position": ["column 2", "column 3"],
        "torque": ["column 4", "column 5"],
        "velocity": ["column 6", "column 7"],
    }
    assert mapping["position"].get("unit", "rad") == unit
    with pytest.raises(RecordingError, match="has no header line; expected time, position_1"):
        load_recording(path)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ((POSITION, POSITION + 1e-4 * NOISE), "a1 to a2 and b1 to b2 are alike"),
        ((POSITION, TORQUE, 3.0 * TORQUE), "b1 to b2 and c1 to c2 may both be torques"),
        ((POSITION, VELOCITY), "one quantity and its slopes"),
        ((300.0 * POSITION, 400.0 * TORQUE), "no columns lie within the joints' limits"),
        ((POSITION, -0.5 * POSITION), "may both be positions"),
    ],
)
def test_values_that_do_not_tell(
    columns: tuple[np.ndarray, ...], message: str, tmp_path: Path
) -> None:
    header = ",".join(["time", *(f"{x}{i}" for x in "abc"[: len(columns)] for i in (1, 2))])
    path = written(tmp_path / "log.csv", header, *columns)
    with pytest.raises(RecordingError, match=message):
        mapping_by_values(path, NAMES, LIMITS)


def test_one_joint_without_a_header(tmp_path: Path) -> None:
    """The first of the columns is time: a joint's own are not left over."""
    path = tmp_path / "one.csv"
    np.savetxt(path, np.column_stack([TIME, POSITION[:, 0], TORQUE[:, 0]]))
    mapping, assumed = mapping_by_values(path, NAMES[:1], LIMITS[:1])
    assert {name: table["columns"] for name, table in mapping.items()} == {
        "time": "column 1",
        "position": ["column 2"],
        "torque": ["column 3"],
    }
    assert assumed.endswith("column 3 are what is left, taken as torques")


@pytest.mark.parametrize(("unit", "factor"), [("m", 1.0), ("mm", 1e3)])
def test_a_sliding_joint_has_a_unit_of_its_own(unit: str, factor: float, tmp_path: Path) -> None:
    """Lengths lie within their limits in degrees too, which they are not in."""
    scale = np.array([180.0 / np.pi, 0.2 * factor])
    path = written(tmp_path / "log.csv", "t,a1,a2,b1,b2", scale * POSITION, TORQUE)
    mapping, _ = mapping_by_values(path, NAMES, (LIMITS[0], (-0.4, 0.4)), [1])
    assert mapping["position"]["unit"] == ["deg", unit]
    found = load_recording(path, columns=ColumnMapping.of(mapping)).position
    np.testing.assert_allclose(found, [1.0, 0.2] * POSITION, rtol=1e-12)


def test_more_columns_than_joints(tmp_path: Path) -> None:
    """A gripper's column may be the first or the last: nobody knows."""
    header = "t,a1,a2,a3,b1,b2,b3"
    path = written(tmp_path / "log.csv", header, POSITION, TIME, TORQUE, TIME)
    with pytest.raises(RecordingError, match=r"elbow; a1 to a3 are 3; b1 to b3 are 3$"):
        mapping_by_values(path, NAMES, LIMITS)


def test_columns_that_are_no_samples(tmp_path: Path) -> None:
    header = "n,a1,a2,b1,b2"
    still = written(tmp_path / "still.csv", header, POSITION, TORQUE, time=0.0 * TIME)
    with pytest.raises(RecordingError, match=r"no column increases from row to row.*: n$"):
        mapping_by_values(still, NAMES, LIMITS)
    with pytest.raises(RecordingError, match="expected 3 columns of each"):
        mapping_by_values(still, ("a", "b", "c"), (*LIMITS, LIMITS[0]))


def test_first_lines_of_numbers(tmp_path: Path) -> None:
    """Numbers that count are names, as a table without names is written; others are samples."""
    path = tmp_path / "counted.csv"
    path.write_text("0,1,2\n" + "".join(f"{i / 10},{i},{2 * i}\n" for i in range(6)))
    assert column_names_of(path) == ("0", "1", "2")
    path.write_text("# t q tau\n0 1 2\n" + "".join(f"{i + 1} {i} {i}\n" for i in range(6)))
    assert column_names_of(path) == ("t", "q", "tau")
    assert load_recording(path).samples == 7


def test_torques_within_the_limits_are_no_positions(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Where positions are in encoder ticks, and joints carry little."""
    time = 0.01 * np.arange(1000.0)
    position = np.stack([np.sin(time), np.cos(1.3 * time)], axis=1)
    torque = 1.5 * position + 0.02 * rng.standard_normal(position.shape)
    columns = np.column_stack([time, np.round(650.0 * position), torque])
    path = tmp_path / "ticks.csv"
    np.savetxt(path, columns, delimiter=",", header="t,a1,a2,b1,b2", comments="")
    with pytest.raises(RecordingError, match="b1 to b2 lie within the joints' limits, and a1"):
        mapping_by_values(path, ["x", "y"], [(-3.0, 3.0)] * 2)

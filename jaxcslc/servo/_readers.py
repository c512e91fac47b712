"""Recordings of servos from files: tables, bags of ROS, data sets of LeRobot, and logs of SAGE."""

import csv
import gzip
import json
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..recordings import (
    ColumnMapping,
    CommandTable,
    RecordingError,
    commands_of,
    load_commands,
)
from ._lerobot import LEROBOT_INFO, lerobot_episodes
from ._recording import ServoRecording


# Beyond two turns, values are no radians: they are degrees or ticks of an encoder.
_LARGEST_ANGLE = 4.0 * math.pi

Units = Literal["radians", "degrees", "normalised"]
_Columns = ColumnMapping | str | os.PathLike[str]


def load_servo_recordings(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: _Columns | None = None,
    *,
    units: Units | None = None,
    calibration: str | os.PathLike[str] | None = None,
) -> dict[str, ServoRecording]:
    """Read commands and positions of servos from a file or a folder.

    Tables (CSV, Parquet, `.npz`) with columns such as `goal_position_1` and `present_position_1`;
    bags of ROS with joint states and a topic of commands; folders of LeRobot data sets; folders of
    SAGE's logs (`control.csv`, `state_motor.csv`). Formats and units are in `docs/servo.md`.

    **Arguments**

    - `path`: of the file or the folder.
    - `joints`: of the robot: how many, or their names (`robot.joint_names`), by which the
        recording's joints are put in order.
    - `columns`: names, units, signs and zeros of the columns, where the format does not say them:
        a mapping, or the path of its TOML file.
    - `units`: of a LeRobot data set, `"normalised"` being -100 to 100 of each joint's range. By
        default radians or degrees, where the values show which.
    - `calibration`: LeRobot's calibration file of the arm, for normalised units and for grippers.

    **Returns** the recordings, by episode for a data set, or else by the file's name.

    **Raises**

    - `RecordingError`: what cannot be read, in one line: file, place, and what was expected.

    >>> import pathlib, tempfile
    >>> from jaxcslc.servo import load_servo_recordings
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "arm.csv"
    ...     rows = "".join(f"{0.02 * row:.2f},{row},{row - 1}\\n" for row in range(6))
    ...     header = "time,goal_position_1 [deg],present_position_1 [deg]\\n"
    ...     _ = path.write_text(header + rows)
    ...     load_servo_recordings(path)["arm.csv"].command[:3, 0].round(4).tolist()
    [0.0, 0.0175, 0.0349]
    """
    path = Path(path)
    data_set = path if (path / LEROBOT_INFO).exists() else None
    if data_set is None and (units is not None or calibration is not None):
        raise RecordingError(
            f"{path}: units and calibration apply to LeRobot data sets only; expected a folder with"
            f" {LEROBOT_INFO}, or units in a file of --columns"
        )
    if data_set is not None:
        mapping = ColumnMapping.load(columns) if isinstance(columns, str | os.PathLike) else columns
        raw = mapping is not None and any(
            mapped.units
            for quantity, mapped in mapping.quantities.items()
            if quantity in ("position", "command")
        )
        episodes = lerobot_episodes(data_set, units, calibration, raw=raw)
        tables = {
            name: commands_of(f"{path}: {name}", arrays, notes, joints, mapping)
            for name, arrays, notes in episodes
        }
    elif _sage_file(path, "control") is not None:
        tables = {path.name: commands_of(str(path), *_sage_columns(path), joints, columns)}
    else:
        for parent in path.parents:
            if (parent / LEROBOT_INFO).exists():
                raise RecordingError(
                    f"{path}: is a part of a LeRobot data set; expected its folder, {parent}"
                )
        tables = {path.name: load_commands(path, joints, columns)}
    return {
        name: _recording(str(path) if len(tables) == 1 else f"{path}: {name}", table)
        for name, table in tables.items()
    }


def load_servo_recording(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: _Columns | None = None,
) -> ServoRecording:
    """Read commands and positions of servos from a file that holds one recording.

    **Arguments**, and errors: as for `load_servo_recordings`.

    **Returns** the recording.

    **Raises**

    - `RecordingError`: as `load_servo_recordings`, and for a data set of several episodes.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxcslc.servo import load_servo_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "arm.npz"
    ...     np.savez(path, time=np.arange(6.0), goal=np.zeros((6, 2)), position=np.eye(6, 2))
    ...     load_servo_recording(path).joints
    2
    """
    recordings = load_servo_recordings(path, joints, columns)
    if len(recordings) != 1:
        raise RecordingError(
            f"{path}: holds {len(recordings)} episodes; expected one: load_servo_recordings reads"
            " all"
        )
    return next(iter(recordings.values()))


def _recording(place: str, table: CommandTable) -> ServoRecording:
    """Return the recording of a table, if its positions can be angles in radians."""
    for quantity in ("position", "command"):
        values = table.quantities[quantity]
        assert values is not None
        largest = float(np.max(np.abs(values)))
        if largest > _LARGEST_ANGLE:
            raise RecordingError(
                f"{place}: {quantity} reaches {largest:.4g} rad; expected at most two turns: state"
                f" the unit, such as deg or tick, in [{quantity}] of a file of --columns"
            )
    quantities: dict[str, Any] = dict(table.quantities)
    return ServoRecording(
        table.time, **quantities, joint_names=table.joint_names, notes=table.notes
    )


def _sage_file(folder: Path, stem: str) -> Path | None:
    """Return a file of SAGE's log, which may be compressed."""
    names = (folder / f"{stem}.csv", folder / f"{stem}.csv.gz")
    return next((name for name in names if name.is_file()), None)


def _sage_columns(folder: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """Read a log of SAGE (isaac-sim2real/sage): columns in SI units, and notes.

    `control.csv` has times [us] and commanded positions [rad], `state_motor.csv` times, positions,
    velocities [rad/s] and present currents, and `joint_list.txt` the joints' names. A list stands
    in one quoted cell.
    """
    names_file, state_file = folder / "joint_list.txt", _sage_file(folder, "state_motor")
    if state_file is None:
        raise RecordingError(f"{folder}: no state_motor.csv; expected one next to control.csv")
    try:
        names = names_file.read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{names_file}: cannot be read: {error}; expected a joint's name per line"
        ) from error
    control_file = _sage_file(folder, "control")
    assert control_file is not None
    control = _sage_rows(control_file, ("timestamp", "positions"), len(names))
    state = _sage_rows(state_file, ("timestamp", "positions", "velocities", "torques"), len(names))
    sent = np.argsort(control["timestamp"][:, 0], kind="stable")
    stamps = control["timestamp"][sent, 0]
    # A command holds from its time stamp to the next.
    latest = np.searchsorted(stamps, state["timestamp"][:, 0], side="right") - 1
    known = latest >= 0
    if not known.any():
        raise RecordingError(f"{state_file}: no row follows the first command of {control_file}")
    notes = ["currents are the torques column of state_motor.csv: unsigned, in the servo's unit"]
    if not known.all():
        notes.append(f"{(~known).sum()} rows before the first command are not used")
    quantities = {
        "position": state["positions"][known],
        "command": control["positions"][sent][latest[known]],
        "velocity": state["velocities"][known],
        "current": state["torques"][known],
    }
    columns = {"time": state["timestamp"][known, 0] * 1e-6}
    for quantity, values in quantities.items():
        columns |= {f"{quantity}_{name}": v for name, v in zip(names, values.T, strict=True)}
    return columns, notes


def _sage_rows(
    path: Path, names: Sequence[str], joints: int
) -> dict[str, Float[np.ndarray, "rows _"]]:
    """Read columns of numbers, or of lists of as many numbers as there are joints."""

    def rows() -> Iterator[list[list[float]]]:
        opened = gzip.open if path.suffix == ".gz" else open
        with opened(path, "rt", encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            missing = [name for name in names if name not in (reader.fieldnames or ())]
            if missing:
                raise RecordingError(
                    f"{path}: no column {missing[0]!r}; expected {', '.join(names)}"
                )
            for number, row in enumerate(reader, start=1):
                cells: list[list[float]] = []
                for name in names:
                    count = 1 if name == "timestamp" else joints
                    try:
                        value = json.loads(row[name])
                        numbers = [
                            float(v)
                            for v in (value if count != 1 or isinstance(value, list) else [value])
                        ]
                    except (TypeError, ValueError):
                        numbers = []
                    if len(numbers) != count:
                        raise RecordingError(
                            f"{path}: row {number}, column {name}: {row[name]!r}; expected"
                            f" {count} number{'' if count == 1 else 's in a list, one per joint'}"
                        )
                    cells.append(numbers)
                yield cells

    try:
        table = list(rows())
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    if not table:
        raise RecordingError(f"{path}: no rows; expected {', '.join(names)}")
    return {name: np.array([row[i] for row in table]) for i, name in enumerate(names)}

"""Entry of the readers: load, save and iterate over recordings of any supported type."""

import dataclasses
import itertools
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxcslc._scratch import unfinished

from .._recording import MINIMUM_SAMPLES, Recording, RecordingError, as_columns
from ._bag import joint_states, read_commanded_bag
from ._column_mapping import ColumnMapping
from ._known_layouts import SERVO_RECORDING, TORQUE_RECORDING, RecordingKind
from ._layout import QUANTITIES, ColumnLayout, Header, LayoutColumn, Table, beginning, is_numbered


# Names of joints that a CSV header can hold, and that are read back as such.
_COLUMN_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")


class RecordingChunk(eqx.Module):
    """Successive rows of a recording file that is too long for memory.

    **Attributes**

    - `first`: the number of the chunk's first row in the file, counted from 0.
    - `time`, `position`, `torque`, `velocity`, `acceleration`: as of a `Recording`.

    >>> import numpy as np
    >>> from jaxcslc.recordings import RecordingChunk
    >>> one = np.zeros((1, 2))
    >>> RecordingChunk(0, np.zeros(1), one, one, None, None).samples
    1
    """

    first: int
    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    torque: Float[np.ndarray, "samples joints"]
    velocity: Float[np.ndarray, "samples joints"] | None
    acceleration: Float[np.ndarray, "samples joints"] | None

    @property
    def samples(self) -> int:
        """Number of rows in the chunk."""
        return self.position.shape[0]


def load_recording(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
    *,
    fixed: Sequence[str] = (),
    following: Sequence[tuple[str, str, float, float]] = (),
) -> Recording:
    """Read a recording from a file.

    CSV, Parquet and NumPy's `.npz`; logs of Universal Robots (RTDE) and of libfranka. Which columns
    are what follows from their names, or from `columns`; see `docs/recordings.md`.

    **Arguments**

    - `path`: of the file, whose type is told by its suffix or its first bytes.
    - `joints`: of the robot, where the recording is to be of a certain one: how many, or their
        names (`robot.joint_names`), by which the recording's joints are put in order.
    - `columns`: names and units of the columns, where the format does not say them: a mapping, or
        the path of its TOML file.
    - `fixed`: joints that the robot's description takes as fixed
        (`robot.source.fixed_joints`). Where the recording has them, its `fixed_motion` says how far
        they move.
    - `following`: joints that the robot's description has follow others: name, the other's name,
        multiplier and offset. Where the recording has both, its `following_error` says how far the
        joint is off that law.

    **Returns** the recording, in SI units. `joint_names` are those of `joints` or, without them,
    the file's, where it names joints; `notes` say what was decided in reading it.

    **Raises** `RecordingError`: a file that is missing, unreadable or empty; missing, unknown or
    duplicate columns; cells that are no finite numbers; time that does not increase; repeated rows;
    too few samples; another number of joints, or joints of other names; motor currents without
    torque constants. The message is one line and names the file, the column and the row (data rows
    from 1 and, in CSV files, the line).

    >>> import pathlib, tempfile
    >>> from jaxcslc.recordings import load_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "still.csv"
    ...     rows = "".join(f"{0.01 * row:.2f},0.5,{row}\\n" for row in range(6))
    ...     _ = path.write_text("time,position_1,torque_1\\n" + rows)
    ...     load_recording(path).torque[:, 0].tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    """
    path = Path(path)
    layout, pieces = _opened(path, joints, columns)
    table = whole(path, pieces)
    return Recording(
        table["time"],
        **layout.split(table),  # pyright: ignore[reportArgumentType]
        joint_names=layout.joint_names,
        notes=layout.notes,
        torque_measured=layout.torque_measured,
        fixed_motion=_motion_of(path, columns, fixed),
        following_error=_following_error(path, columns, following),
    )


def _motion_of(
    path: Path, columns: ColumnMapping | str | os.PathLike[str] | None, names: Sequence[str]
) -> list[tuple[str, float]]:
    """Return how far those of the joints move that the file has."""
    pieces = list(_positions_of(path, columns, names))
    return [
        (name, float(np.ptp(np.concatenate([piece[name] for piece in pieces]))))
        for name in (pieces[0] if pieces else ())
    ]


def _following_error(
    path: Path,
    columns: ColumnMapping | str | os.PathLike[str] | None,
    following: Sequence[tuple[str, str, float, float]],
) -> list[tuple[str, float]]:
    """Return how far those joints are off their laws that the file has, with their leaders."""
    names = dict.fromkeys(name for law in following for name in law[:2])
    largest: dict[str, float] = {}
    for piece in _positions_of(path, columns, list(names)):
        for name, leader, multiplier, offset in following:
            if name in piece and leader in piece:
                error = np.max(np.abs(piece[name] - multiplier * piece[leader] - offset))
                largest[name] = max(float(error), largest.get(name, 0.0))
    return list(largest.items())


def _positions_of(
    path: Path, columns: ColumnMapping | str | os.PathLike[str] | None, names: Sequence[str]
) -> Iterator[Table]:
    """Yield positions of those joints that a file has, piece by piece, up to what cannot be read.

    The file is read again, for what is wrong with columns that nobody needs must not keep those
    that are needed from being read.
    """
    if not names:
        return
    try:
        layout, pieces = _opened(path, None, columns)
        recorded = [name for name in names if name in (layout.joint_names or ())]
        if not recorded:
            return
        positions = layout.for_joints(str(path), recorded).quantities["position"]
        for piece in pieces:
            values = (piece[column.name] for column in positions)
            yield dict(zip(recorded, values, strict=True))
    except RecordingError:
        return


def load_recordings(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> dict[str, Recording]:
    """Read all recordings of a file: of a bag those of every topic of joint states.

    **Arguments**

    - `path`, `joints`, `columns`: as for `load_recording`.

    **Returns** the recordings by topic; of a file that holds one, by the file's name.

    **Raises** `RecordingError`: as `load_recording`.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxcslc.recordings import load_recordings
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "one.npz"
    ...     np.savez(path, t=np.arange(6.0), q=np.zeros((6, 2)), tau=np.eye(6, 2))
    ...     tuple(load_recordings(path))
    ('one.npz',)
    """
    from ._tables import is_bag  # loads Arrow, which others need not wait for

    path, mapping = Path(path), mapping_of(columns) or ColumnMapping()
    if not is_bag(path):
        return {path.name: load_recording(path, joints, mapping)}
    states = joint_states(path, file_joints(mapping, joints), mapping.topic)
    return {
        topic: load_recording(path, joints, dataclasses.replace(mapping, topic=topic))
        for topic in sorted({of_topic.topic for of_topic in states})
    }


def iterate_recording(
    path: str | os.PathLike[str],
    chunk_rows: int,
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> Iterator[RecordingChunk]:
    """Read a recording of any length, a chunk at a time.

    Memory does not grow with the file, as long as a Parquet file's row groups are not as large as
    itself (this package writes small ones).

    **Arguments**

    - `path`: as for `load_recording`.
    - `chunk_rows`: of every chunk but the last, which may be shorter.
    - `joints`, `columns`: as for `load_recording`.

    **Returns** an iterator over the chunks, in order. The file's columns are checked before it
    returns.

    **Raises**

    - `ValueError`: chunks of less than one row.
    - `RecordingError`: as `load_recording`, except for its least number of samples: any row will
        do. Faults of rows and cells are raised by the iterator when it comes to them.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxcslc.recordings import iterate_recording, Recording, save_recording
    >>> time = np.arange(10) * 0.01
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "long.parquet"
    ...     save_recording(Recording(time, time[:, None], time[:, None]), path)
    ...     [(chunk.first, chunk.samples) for chunk in iterate_recording(path, 4)]
    [(0, 4), (4, 4), (8, 2)]
    """
    if chunk_rows < 1:
        raise ValueError(f"chunks of {chunk_rows} rows; expected 1 or more")
    path = Path(path)
    layout, pieces = _opened(path, joints, columns)

    def chunks() -> Iterator[RecordingChunk]:
        waiting: list[Table] = []
        rows = first = 0
        for piece in itertools.chain(pieces, [None]):
            if piece is not None:
                waiting.append(piece)
                rows += piece["time"].size
            if not rows or (piece is not None and rows < chunk_rows):
                continue
            table = _joined(waiting)
            start = 0
            while rows - start >= (chunk_rows if piece is not None else 1):
                part = {name: v[start : start + chunk_rows] for name, v in table.items()}
                yield RecordingChunk(first, part["time"], **layout.split(part))  # pyright: ignore[reportArgumentType]
                start += part["time"].size
                first += part["time"].size
            waiting = [{name: values[start:].copy() for name, values in table.items()}]
            rows -= start
        if first == 0:
            raise RecordingError(f"{path}: no rows of samples; expected at least 1")

    return chunks()


def column_names_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the columns that a file of samples has.

    **Raises** `RecordingError`: a file that cannot be opened, or a name that occurs twice.

    >>> import pathlib, tempfile
    >>> from jaxcslc.recordings import column_names_of
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "arm.csv"
    ...     _ = path.write_text("stamp,axis1_deg\\n0,0\\n")
    ...     column_names_of(path)
    ('stamp', 'axis1_deg')
    """
    from ._tables import open_table

    def layout_of(file: str, header: Header) -> ColumnLayout:
        first, *others = map(LayoutColumn, header.names)
        return ColumnLayout(first, {"others": tuple(others)})

    return tuple(open_table(Path(path), layout_of)[0].names)


def load_columns(
    path: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    time: str = "time",
    least: int = MINIMUM_SAMPLES,
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Read columns of any names from a file of samples.

    **Arguments**

    - `path`: of a `.csv`, `.parquet` or `.npz` file with a column `time` [s].
    - `names`: of the columns to read beside it, which may be in any order among others; all if
      omitted.
    - `time`: name of the column that increases from row to row.
    - `least`: number of rows that the file must have.

    **Returns** the columns by name, `time` first.

    **Raises** `RecordingError`: as `load_recording`; instead of its columns, one that is missing.

    >>> import pathlib, tempfile
    >>> from jaxcslc.recordings import load_columns
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.csv"
    ...     rows = "".join(f"{i},{2 * i},a\\n" for i in range(6))
    ...     _ = path.write_text("time,level,note\\n" + rows)
    ...     load_columns(path, ["level"])["level"].tolist()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    from ._tables import open_table

    def layout_of(file: str, header: Header) -> ColumnLayout:
        have = header.names
        wanted = dict.fromkeys([time, *(have if names is None else names)])
        for name in wanted:
            if have.count(name) != 1:
                problem = "missing column" if name not in have else "more than one column"
                raise RecordingError(f"{file}: {problem} {name!r}; the file has {beginning(have)}")
        others = tuple(LayoutColumn(name) for name in wanted if name != time)
        return ColumnLayout(LayoutColumn(time), {"columns": others}, relative=False)

    _, pieces = open_table(Path(path), layout_of)
    return whole(Path(path), pieces, least)


def whole(path: object, pieces: Iterator[Table], least: int = MINIMUM_SAMPLES) -> Table:
    """Put pieces of a file together, which must have enough rows for a recording."""
    tables = list(pieces)
    samples = sum(table["time"].size for table in tables)
    if samples < least:
        raise RecordingError(
            f"{path}: {samples or 'no'} rows of samples; expected at least {least}"
        )
    return _joined(tables)


def _joined(tables: Sequence[dict[str, np.ndarray]]) -> Table:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def save_recording(
    recording: Recording | Iterable[Recording | RecordingChunk], path: str | os.PathLike[str]
) -> None:
    """Write a recording to a CSV or Parquet file, from which it is read back bit for bit.

    Columns are `time`, `position_1` and so on, or `position_shoulder` where joints have names.

    The file appears when it is complete: until then, one of that name stays as it was.

    **Arguments**

    - `recording`: one, or successive parts of one that is too long for memory.
    - `path`: ends in `.csv` or `.parquet`; its folder exists.

    **Raises** `RecordingError`: another suffix, a folder that cannot be written to, parts that
    differ in their columns, or no parts.

    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from jaxcslc.recordings import load_recording, Recording, save_recording
    >>> time = np.linspace(0.0, 1.0, 7)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "motion.csv"
    ...     save_recording(Recording(time, np.sin(time)[:, None], time[:, None]), path)
    ...     bool((load_recording(path).position[:, 0] == np.sin(time)).all())
    True
    """
    from ._tables import write_tables

    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise RecordingError(
            f"{path}: unknown file type {path.suffix!r}; expected .csv or .parquet"
        )
    parts = [recording] if isinstance(recording, Recording) else recording
    try:
        with unfinished(path) as file:
            write_tables(map(_columns_of, parts), file, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror or error}") from error


def _opened(
    path: Path,
    joints: int | Sequence[str] | None,
    columns: ColumnMapping | str | os.PathLike[str] | None,
) -> tuple[ColumnLayout, Iterator[Table]]:
    """Open a file: its layout, and its rows piece by piece."""
    from ._tables import open_table  # loads Arrow, which others need not wait for

    mapping = mapping_of(columns)
    return open_table(
        path,
        _Layout(mapping, joints, TORQUE_RECORDING),
        delimiter=None if mapping is None else mapping.delimiter,
        topic=None if mapping is None else mapping.topic,
        joints=file_joints(mapping, joints),
    )


def mapping_of(
    columns: ColumnMapping | str | os.PathLike[str] | None,
) -> ColumnMapping | None:
    """Return a mapping, which may be in a file."""
    if columns is None or isinstance(columns, ColumnMapping):
        return columns
    return ColumnMapping.load(columns)


def file_joints(
    mapping: ColumnMapping | None, joints: int | Sequence[str] | None
) -> Sequence[str] | None:
    """Return the joints that a recording must have, as it calls them; None if they are numbered."""
    if mapping is not None and (mapping.file_joints or mapping.joints):
        return mapping.file_joints or mapping.joints
    return None if isinstance(joints, int | None) or is_numbered(joints) else joints


def _columns_of(part: Recording | RecordingChunk) -> Table:
    names = part.joint_names if isinstance(part, Recording) else None
    if names is not None and not all(map(_COLUMN_NAME.fullmatch, names)):
        names = None
    quantities = {quantity: getattr(part, quantity) for quantity in QUANTITIES}
    return as_columns(part.time, names, **quantities)


class CommandTable(NamedTuple):
    """Columns of a recording of servos, in SI units.

    - `time`: shape `(samples,)` [s].
    - `quantities`: `"position"`, `"command"`, `"velocity"`, `"current"`, each `(samples, joints)`,
      or None where the file has none.
    - `joint_names`: names in the order of the columns; None where joints are numbered.
    - `notes`: sentences about what was decided in reading the file.
    """

    time: Float[np.ndarray, " samples"]
    quantities: Mapping[str, Float[np.ndarray, "samples joints"] | None]
    joint_names: tuple[str, ...] | None
    notes: tuple[str, ...]


def load_commands(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> CommandTable:
    """Read commanded and measured positions from a table or a bag.

    - `path`: a CSV, Parquet or `.npz` file, or a bag of ROS with joint states and commands.
    - `joints`, `columns`: as for `load_recording`.

    **Raises** `RecordingError`: as `load_recording`.
    """
    from ._tables import is_bag, open_columns, open_table  # load Arrow: others need not wait

    path, mapping = Path(path), mapping_of(columns)
    layout_of = _Layout(mapping, joints, SERVO_RECORDING)
    if is_bag(path):
        mapping = mapping or ColumnMapping()
        wanted = file_joints(mapping, joints)
        header, arrays = read_commanded_bag(path, wanted, mapping.topic, mapping.command_topic)
        return _table(str(path), *open_columns(str(path), header, arrays, layout_of))
    delimiter = None if mapping is None else mapping.delimiter
    return _table(str(path), *open_table(path, layout_of, delimiter=delimiter))


def commands_of(
    place: str,
    arrays: Mapping[str, np.ndarray],
    notes: Sequence[str] = (),
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> CommandTable:
    """Return commanded and measured positions of columns that are in memory.

    - `place`: where they were read, for messages.
    - `arrays`: columns named as in a file, such as `time`, `position_elbow` and `command_elbow`.
    - `notes`: sentences about what was decided in reading them.
    - `joints`, `columns`: as for `load_recording`.

    **Raises** `RecordingError`: as `load_recording`.
    """
    from ._tables import open_columns

    header = Header(list(arrays), notes=tuple(notes))
    layout_of = _Layout(mapping_of(columns), joints, SERVO_RECORDING)
    return _table(place, *open_columns(place, header, dict(arrays), layout_of))


class _Layout(NamedTuple):
    """Choice of the columns of a file, by its names or by a mapping."""

    mapping: ColumnMapping | None
    joints: int | Sequence[str] | None
    kind: RecordingKind

    def __call__(self, file: str, header: Header) -> ColumnLayout:
        if self.mapping is not None:
            return self.mapping.layout(file, header, self.joints, self.kind)
        layout = self.kind.layout_by_format(file, header)
        return layout.checked(file, self.kind.required).for_joints(file, self.joints)


def _table(place: str, layout: ColumnLayout, pieces: Iterator[Table]) -> CommandTable:
    table = whole(place, pieces)
    quantities = layout.split(table, SERVO_RECORDING.quantities)
    return CommandTable(table["time"], quantities, layout.joint_names, layout.notes)

"""Tables of a recording file: its type, its columns in SI units, and checks of every row."""

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from jaxtyping import Float

from .._recording import MINIMUM_SAMPLES, Fault, RecordingError, first_fault
from ._bag import joint_states, read_bag
from ._binary_tables import read_npz, read_parquet, read_parquet_header, time_unit
from ._csv_table import line_of, one_line, read_csv, read_csv_header
from ._layout import Header


ROW_GROUP = 1 << 16
"""Rows of a Parquet row group: what its readers must be able to hold at a time."""

_SUFFIXES = {
    **{".csv": "csv", ".parquet": "parquet", ".npz": "npz"},
    **dict.fromkeys((".bag", ".mcap", ".db3"), "bag"),
}
_BEGINNINGS = {b"PAR1": "parquet", b"PK\x03\x04": "npz"}
_EXPECTED = ".csv, .parquet, .npz, .bag, .mcap, .db3"


@runtime_checkable
class TableColumns(Protocol):
    """Columns of a file to read, and their factors to SI units."""

    @property
    def names(self) -> list[str]: ...

    @property
    def time(self) -> str:
        """The column of time."""
        ...

    @property
    def factors(self) -> Mapping[str, float]:
        """SI units in one unit of a column; 1 for those that it does not name."""
        ...

    @property
    def relative(self) -> bool:
        """True if time counts from the first sample."""
        ...


C = TypeVar("C", bound=TableColumns)
Check = Callable[[str, Header], C]
Table = dict[str, Float[np.ndarray, " rows"]]
Pieces = Iterator[dict[str, np.ndarray]]


def open_table(
    path: Path,
    check: Check[C],
    *,
    delimiter: str | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
) -> tuple[C, Iterator[Table]]:
    """Open a recording file, and read it piece by piece.

    **Arguments**

    - `path`: of a file of a known type, by its suffix or, where it has another, its first bytes.
    - `check`: from the file's name and its header to the columns that are read, as `layout_of`;
      raises `RecordingError` for wrong ones.
    - `delimiter`: between the cells of a CSV file; by default what its header shows.
    - `topic`, `joints`: of a bag's joint states; by default those of the only topic that has any.

    **Returns**

    Its columns, and an iterator over its rows: one table of float64 columns in SI units after
    another, of whatever size they come in, `time` among them. Every row has been checked on its
    own and against the one before.

    **Raises**

    - `RecordingError`: at once for a file that cannot be opened or has wrong columns; from the
        iterator for a wrong cell or row.
    """
    try:
        kind = _kind_of(path)
        if path.stat().st_size == 0:
            raise RecordingError(
                f"{path}: the file is empty; expected a header and rows of samples"
            )
        if kind == "csv":
            return _open_csv(path, check, delimiter)
        if kind == "parquet":
            return _open_parquet(path, check)
        if kind == "bag":
            return _open_columns(path, check, *read_bag(path, joints, topic))
        return _open_columns(path, check, *read_npz(path))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {one_line(error)}") from error


def topics_of(path: Path, joints: Sequence[str] | None, topic: str | None) -> list[str] | None:
    """The topics of a bag's joint states; None for a file that is no bag.

    - `joints`, `topic`: as of `open_table`.

    **Raises** `RecordingError`: as `open_table`.
    """
    if _kind_of(path) != "bag":
        return None
    return sorted({states.topic for states in joint_states(path, joints, topic)})


def write_tables(tables: Iterable[Table], unfinished: Path, path: Path) -> None:
    """Write successive tables of columns into one file.

    **Arguments**

    - `tables`: of the same columns each.
    - `unfinished`: the file to write, `.csv` or `.parquet`.
    - `path`: what the file will be called, for messages.

    **Raises**

    - `RecordingError`: no tables, or tables that differ in their columns.
    """
    arrow = (pa.table({name: pa.array(v) for name, v in table.items()}) for table in tables)
    first = next(arrow, None)
    if first is None:
        raise RecordingError(f"{path}: no parts of a recording to write; expected one or more")
    with _writer(unfinished, first.schema) as writer:
        for table in chain([first], arrow):
            if table.schema != first.schema:
                raise RecordingError(
                    f"{path}: parts of the recording differ in their columns; expected "
                    f"{', '.join(first.schema.names)} in each"
                )
            if isinstance(writer, pq.ParquetWriter):
                writer.write_table(table, row_group_size=ROW_GROUP)
            else:
                writer.write_table(table)


def _writer(unfinished: Path, schema: pa.Schema) -> pq.ParquetWriter | pacsv.CSVWriter:
    if unfinished.suffix.lower() == ".parquet":
        # Measured values hardly ever repeat: a dictionary of them would only be dropped again.
        return pq.ParquetWriter(unfinished, schema, use_dictionary=False)
    return pacsv.CSVWriter(
        unfinished, schema, write_options=pacsv.WriteOptions(quoting_header="none")
    )


def _kind_of(path: Path) -> str:
    """The type of a recording file: the one place that chooses a reader."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if path.is_dir():
        if (path / "metadata.yaml").exists():
            return "bag"
        raise RecordingError(
            f"{path}: is a folder without the metadata.yaml of a ROS 2 bag; expected a file:"
            f" {_EXPECTED}"
        )
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind is None:
        with path.open("rb") as file:
            beginning = file.read(16)
        kind = next((k for start, k in _BEGINNINGS.items() if beginning.startswith(start)), None)
    if kind is None:
        raise RecordingError(f"{path}: unknown file type {path.suffix!r}; expected {_EXPECTED}")
    return kind


def _checked_header(path: Path, header: Header, check: Check[C]) -> C:
    columns = check(str(path), header)
    for name in columns.names:
        if name not in header.names:
            listed = ", ".join(header.names[:12]) + (", ..." if header.names[12:] else "")
            raise RecordingError(f"{path}: no column {name!r}; the file has {listed}")
        if header.names.count(name) > 1:
            raise RecordingError(f"{path}: column {name!r} occurs more than once")
    return columns


def _open_csv(path: Path, check: Check[C], delimiter: str | None) -> tuple[C, Iterator[Table]]:
    header = read_csv_header(path, delimiter)
    columns = _checked_header(path, Header(header.names), check)
    batches = read_csv(path, header, columns.names, time=columns.time)
    pieces = (_as_numpy(batch) for batch in batches)
    return columns, _checked(path, pieces, columns, line=lambda row: line_of(path, header, row))


def _open_parquet(path: Path, check: Check[C]) -> tuple[C, Iterator[Table]]:
    columns = _checked_header(path, Header(read_parquet_header(path)), check)
    batches = read_parquet(path, columns.names, time=columns.time)
    pieces = (_as_numpy(batch) for batch in batches)
    return columns, _checked(path, pieces, columns, seconds=time_unit(path, columns.time))


def _open_columns(
    path: Path, check: Check[C], header: Header, arrays: Mapping[str, np.ndarray]
) -> tuple[C, Iterator[Table]]:
    columns = _checked_header(path, header, check)
    piece = {name: arrays[name] for name in columns.names}
    sizes = {name: values.size for name, values in piece.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise RecordingError(f"{path}: arrays of different lengths: {listed}")
    return columns, _checked(path, iter([piece]), columns)


def _as_numpy(batch: pa.RecordBatch) -> dict[str, np.ndarray]:
    return {
        name: _array_of(column)
        for name, column in zip(batch.schema.names, batch.columns, strict=True)
    }


def _array_of(column: pa.Array) -> np.ndarray:
    """A column as NumPy has it: plain numbers without Arrow's own conversion, which imports pandas
    (0.3 s)."""
    plain = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
    if plain and not column.null_count:
        return np.from_dlpack(column)  # pyright: ignore[reportArgumentType]
    return column.to_numpy(zero_copy_only=False)


def _checked(
    path: Path,
    pieces: Pieces,
    columns: TableColumns,
    *,
    seconds: float | None = None,
    line: Callable[[int], int | None] | None = None,
) -> Iterator[Table]:
    """Pieces in SI units, every row checked.

    - `seconds`: in one tick of a column of time stamps, where the file says so itself.
    - `line`: on which a row stands, counted from 0.
    """
    before: dict[str, float] | None = None
    row = 0
    start = None
    factors = columns.factors
    for piece in pieces:
        rows = piece[columns.time].size
        if rows == 0:
            continue
        time = piece[columns.time]
        if columns.relative or seconds is not None:
            # Nanoseconds since 1970 have more digits than float64: subtracted as integers.
            start = time[0] if start is None else start
            with np.errstate(invalid="ignore"):  # infinite times are a fault that is named below
                time = time - start
        time = time * (factors.get(columns.time, 1.0) if seconds is None else seconds)
        table = {"time": np.asarray(time, np.float64)}
        table |= {
            name: np.asarray(values * factors.get(name, 1.0), np.float64)
            for name, values in piece.items()
            if name != columns.time
        }
        fault = first_fault(table, before)
        if fault is not None:
            raise _located(path, fault, row, columns.time, line)
        yield table
        before = {name: float(values[-1]) for name, values in table.items()}
        row += rows


def _located(
    path: Path,
    fault: Fault,
    before: int,
    time: str,
    line: Callable[[int], int | None] | None,
) -> RecordingError:
    assert fault.row is not None
    row = before + fault.row
    number = None if line is None else line(row)
    where = f"{path}: row {row + 1}" + ("" if number is None else f" (line {number})")
    name = time if fault.column == "time" else fault.column
    column = "" if fault.column is None else f", column {name}"
    return RecordingError(f"{where}{column}: {fault.problem}")


@dataclasses.dataclass(frozen=True)
class NamedColumns:
    """Columns of a file that are read by their names."""

    names: list[str]
    time: str = "time"
    relative: bool = False
    factors: Mapping[str, float] = dataclasses.field(default_factory=dict)


def load_columns(
    path: str | os.PathLike[str], names: Sequence[str] | None = None
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Read columns of any names from a file of samples.

    **Arguments**

    - `path`: of a `.csv`, `.parquet` or `.npz` file with a column `time` [s].
    - `names`: of the columns to read beside it, which may be in any order among others; all if
      omitted.

    **Returns**

    The columns by name, `time` first.

    **Raises**

    - `RecordingError`: as `load_recording`; in place of its columns, one that is missing.

    >>> import pathlib, tempfile
    >>> from jaxcslc.recordings import load_columns
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.csv"
    ...     rows = "".join(f"{i},{2 * i},a\\n" for i in range(6))
    ...     _ = path.write_text("time,level,note\\n" + rows)
    ...     load_columns(path, ["level"])["level"].tolist()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    pass  # loads Arrow, which others need not wait for

    def checked(file: str, columns: Header) -> NamedColumns:
        header = columns.names
        wanted = [name for name in header if name != "time"] if names is None else list(names)
        wanted = list(dict.fromkeys(["time", *wanted]))
        for name in wanted:
            if header.count(name) != 1:
                problem = "missing column" if name not in header else "more than one column"
                listed = ", ".join(header[:12]) + (", ..." if len(header) > 12 else "")
                raise RecordingError(f"{file}: {problem} {name!r}; the file has {listed}")
        return NamedColumns(wanted)

    path = Path(path)
    columns, pieces = open_table(path, checked)
    tables = list(pieces)
    samples = sum(table["time"].size for table in tables)
    if samples < MINIMUM_SAMPLES:
        raise RecordingError(
            f"{path}: {samples or 'no'} rows of samples; expected at least {MINIMUM_SAMPLES}"
        )
    return {name: np.concatenate([table[name] for table in tables]) for name in columns.names}

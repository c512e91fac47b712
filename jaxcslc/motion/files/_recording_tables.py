import csv
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from jaxtyping import Float

from .. import Fault, RecordingError, first_fault


READ_BYTES = 1 << 20
"""How much of a file is read at a time: enough for speed, little beside a chunk's arrays."""

ROW_GROUP = 1 << 16
"""Rows of a Parquet row group: what its readers must be able to hold at a time."""


@runtime_checkable
class TableColumns(Protocol):
    """Which columns of a file are read."""

    @property
    def names(self) -> list[str]: ...


C = TypeVar("C", bound=TableColumns)
Check = Callable[[str, Sequence[str]], C]


def open_table(
    path: Path, check: Check[C]
) -> tuple[C, Iterator[dict[str, Float[np.ndarray, " rows"]]]]:
    """Opens a recording file, and reads it piece by piece.

    **Arguments**

    - `path`: of a `.csv` or `.parquet` file.
    - `check`: from the file's name and its header to the columns that are read, as
      `checked_columns`; raises `RecordingError` for wrong ones.

    **Returns**

    Its columns, and an iterator over its rows: one table of float64 columns after another, of
    whatever size they come in. Every row has been checked on its own and against the one before.

    **Raises**

    - `RecordingError`: at once for a file that cannot be opened or has wrong columns; from the
        iterator for a wrong cell or row.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise RecordingError(
            f"{path}: unknown file type {path.suffix!r}; expected .csv or .parquet"
        )
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; expected a .csv or .parquet file")
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    try:
        if path.stat().st_size == 0:
            raise RecordingError(
                f"{path}: the file is empty; expected a header and rows of samples"
            )
        columns, pieces = (_open_csv if path.suffix.lower() == ".csv" else _open_parquet)(
            path, check
        )
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {_one_line(error)}") from error
    return columns, _checked(path, pieces)


def write_tables(
    tables: Iterable[dict[str, Float[np.ndarray, " rows"]]], unfinished: Path, path: Path
) -> None:
    """Writes successive tables of columns into one file.

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


def _open_csv(
    path: Path, check: Check[C]
) -> tuple[C, Iterator[dict[str, Float[np.ndarray, " rows"]]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header = next((row for row in csv.reader(file) if row), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: is no CSV text in UTF-8: {_one_line(error)}") from error
    columns = check(str(path), header)
    return columns, _read_csv(path, columns)


def _read_csv(path: Path, columns: TableColumns) -> Iterator[dict[str, Float[np.ndarray, " rows"]]]:
    options = pacsv.ConvertOptions(
        column_types={name: pa.float64() for name in columns.names}, null_values=[]
    )
    try:
        with pacsv.open_csv(
            path,
            # Reading ahead on other threads would hold blocks that no one has asked for.
            read_options=pacsv.ReadOptions(block_size=READ_BYTES, use_threads=False),
            convert_options=options,
        ) as reader:
            for batch in reader:
                yield _as_numpy(batch, columns)
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        # Arrow names the cell of some faults only, and not its line: look again, slowly.
        raise _faulty_cell(path, columns.names) or RecordingError(
            f"{path}: {_one_line(error)}"
        ) from error


def _faulty_cell(path: Path, columns: Sequence[str]) -> RecordingError | None:
    """Looks for the first cell of a CSV file that is no number, or row of a wrong length.

    - `columns`: that are to hold numbers.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            rows = (cells for cells in reader if cells)
            header = next(rows)
            for number, cells in enumerate(rows, start=1):
                where = f"{path}: row {number} (line {reader.line_num})"
                if len(cells) != len(header):
                    return RecordingError(
                        f"{where}: {len(cells)} cells; expected {len(header)}, one a column"
                    )
                for name, cell in zip(header, cells, strict=True):
                    if name in columns and not _is_number(cell):
                        shown = "an empty cell" if not cell.strip() else repr(cell)
                        return RecordingError(f"{where}, column {name}: {shown}; expected a number")
    except (UnicodeDecodeError, csv.Error) as error:
        return RecordingError(f"{path}: is no CSV text in UTF-8: {_one_line(error)}")
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _line_of(path: Path, row: int) -> int | None:
    """On which line of a CSV file a data row ends, counting rows from 0 and lines from 1."""
    if path.suffix.lower() != ".csv":
        return None
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        rows = (cells for cells in reader if cells)
        for number, _ in enumerate(rows, start=-1):
            if number == row:
                return reader.line_num
    return None


def _open_parquet(
    path: Path, check: Check[C]
) -> tuple[C, Iterator[dict[str, Float[np.ndarray, " rows"]]]]:
    try:
        with pq.ParquetFile(path) as file:
            schema = file.schema_arrow
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        if isinstance(error, PermissionError):
            raise
        raise RecordingError(f"{path}: is no readable Parquet file: {_one_line(error)}") from error
    columns = check(str(path), schema.names)
    for field in (schema.field(name) for name in columns.names):
        if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
            raise RecordingError(
                f"{path}: column {field.name} holds {field.type}; expected numbers"
            )
    return columns, _read_parquet(path, columns)


def _read_parquet(
    path: Path, columns: TableColumns
) -> Iterator[dict[str, Float[np.ndarray, " rows"]]]:
    row = 0
    try:
        # Buffered reading takes pages as they are needed; a row group may be the whole file.
        with pq.ParquetFile(path, buffer_size=READ_BYTES, pre_buffer=False) as file:
            for batch in file.iter_batches(batch_size=1 << 14, use_threads=False):
                for name in columns.names:
                    nulls = batch.column(name).is_null().to_numpy(zero_copy_only=False)
                    if nulls.any():
                        raise RecordingError(
                            f"{path}: row {row + int(np.argmax(nulls)) + 1}, column {name}: "
                            "an empty cell; expected a number"
                        )
                yield _as_numpy(batch, columns)
                row += batch.num_rows
    except (pa.ArrowInvalid, OSError) as error:
        raise RecordingError(f"{path}: is damaged after row {row}: {_one_line(error)}") from error


def _as_numpy(
    batch: pa.RecordBatch, columns: TableColumns
) -> dict[str, Float[np.ndarray, " rows"]]:
    return {
        name: batch.column(name).to_numpy(zero_copy_only=False).astype(np.float64, copy=False)
        for name in columns.names
    }


def _checked(
    path: Path, pieces: Iterator[dict[str, Float[np.ndarray, " rows"]]]
) -> Iterator[dict[str, Float[np.ndarray, " rows"]]]:
    before: dict[str, float] | None = None
    row = 0
    for piece in pieces:
        rows = piece["time"].size
        if rows == 0:
            continue
        fault = first_fault(piece, before)
        if fault is not None:
            raise _located(path, fault, row)
        yield piece
        before = {name: float(values[-1]) for name, values in piece.items()}
        row += rows


def _located(path: Path, fault: Fault, before: int) -> RecordingError:
    assert fault.row is not None
    row = before + fault.row
    line = _line_of(path, row)
    where = f"{path}: row {row + 1}" + ("" if line is None else f" (line {line})")
    column = "" if fault.column is None else f", column {fault.column}"
    return RecordingError(f"{where}{column}: {fault.problem}")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())

"""Tables of a recording file: its type, its columns in SI units, and checks of every row.

CSV, Parquet and NumPy's `.npz` are read here, bags of ROS in `_bag`. `open_table` is for all.
"""

import contextlib
import csv
import itertools
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from .._recording import RecordingError, first_fault
from ._bag import read_bag
from ._known_layouts import SERVO_HINT
from ._layout import ColumnLayout, Header, Table, beginning, one_line


ROW_GROUP = 1 << 16
"""Rows of a Parquet row group: what its readers must be able to hold at a time."""

_EMPTY = "an empty cell"
_READ_BYTES = 1 << 20  # of a file at a time: enough for speed, little next to a chunk's arrays
SERVO_FOLDERS = ("meta/info.json", "control.csv", "control.csv.gz")
"""Files that folders of servos' recordings have: data sets of LeRobot, and SAGE's logs."""

_DELIMITERS = (",", ";", "\t", " ")
_EXACT_DIGITS = np.finfo(np.float64).precision  # beyond, float64 rounds integers
_TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SUFFIXES = {
    **{".csv": "csv", ".parquet": "parquet", ".npz": "npz"},
    **dict.fromkeys((".bag", ".mcap", ".db3"), "bag"),
}
_BEGINNINGS = {b"PAR1": "parquet", b"PK\x03\x04": "npz"}
_EXPECTED = ".csv, .parquet, .npz, .bag, .mcap, .db3"
# What unpacking a damaged file raises; `RuntimeError` is of encrypted ones and unknown versions.
_DAMAGE = (EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error)

Columns = dict[str, np.ndarray]


class _File(NamedTuple):
    """A file that is open to be read.

    - `read`: from the columns wanted to their pieces, in the file's own units.
    - `tick`: seconds in one tick of a column of time stamps; None for one of numbers.
    - `line`: the line on which a row ends, counted from 1; None if the file has no lines.
    """

    header: Header
    read: Callable[[ColumnLayout], Iterator[Columns]]
    tick: Callable[[str], float | None] = lambda name: None
    line: Callable[[int], int | None] = lambda row: None


def open_table(
    path: Path,
    layout_of: Callable[[str, Header], ColumnLayout],
    *,
    delimiter: str | None = None,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
) -> tuple[ColumnLayout, Iterator[Table]]:
    """Open a recording file, and read it piece by piece.

    **Arguments**

    - `path`: of a file of a known type, by its suffix or, where it has another, its first bytes.
    - `layout_of`: from the file's name and its header to the columns that are read; raises
      `RecordingError` for wrong ones.
    - `delimiter`: between the cells of a CSV file; by default what its header shows.
    - `topic`, `joints`: of a bag's joint states; by default those of the only topic that has any.

    **Returns**

    Its layout, and an iterator over its rows: one table of float64 columns in SI units after
    another, of whatever size they come in, `time` among them. Every row has been checked on its
    own and against the one before.

    **Raises** `RecordingError`: at once for a file that cannot be opened or has wrong columns; from
    the iterator for a wrong cell or row.
    """
    try:
        kind = _kind_of(path)
        if path.stat().st_size == 0:
            raise RecordingError(
                f"{path}: the file is empty; expected a header and rows of samples"
            )
        if kind == "csv":
            file = _open_csv(path, delimiter)
        elif kind == "parquet":
            file = _open_parquet(path)
        elif kind == "bag":
            file = _open_arrays(path, *read_bag(path, joints, topic))
        else:
            file = _open_arrays(path, *_read_npz(path))
        return _laid_out(str(path), file, layout_of)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {one_line(error)}") from error


def open_columns(
    place: str,
    header: Header,
    columns: Columns,
    layout_of: Callable[[str, Header], ColumnLayout],
) -> tuple[ColumnLayout, Iterator[Table]]:
    """Open columns that are in memory; `place` names them in messages, else as `open_table`."""
    return _laid_out(place, _open_arrays(place, header, columns), layout_of)


def is_bag(path: Path) -> bool:
    """Return whether a file is a bag of ROS.

    **Raises** `RecordingError` for a file that is missing or of an unknown type.
    """
    return _kind_of(path) == "bag"


def _laid_out(
    place: str, file: _File, layout_of: Callable[[str, Header], ColumnLayout]
) -> tuple[ColumnLayout, Iterator[Table]]:
    """Return the layout of an open file, and its checked rows."""
    layout = layout_of(place, file.header)
    for name in layout.names:
        if name not in file.header.names:
            raise RecordingError(
                f"{place}: no column {name!r}; the file has {beginning(file.header.names)}"
            )
        if file.header.names.count(name) > 1:
            raise RecordingError(f"{place}: column {name!r} occurs more than once")
    return layout, _checked(place, file, layout, file.read(layout))


def write_tables(tables: Iterable[Table], unfinished: Path, path: Path) -> None:
    """Write successive tables of columns into one file.

    - `tables`: of the same columns each.
    - `unfinished`: the file to write, `.csv` or `.parquet`.
    - `path`: what the file will be called, for messages.

    **Raises** `RecordingError`: no tables, or tables that differ in their columns.
    """
    arrow = (pa.table({name: pa.array(v) for name, v in table.items()}) for table in tables)
    first = next(arrow, None)
    if first is None:
        raise RecordingError(f"{path}: no parts of a recording to write; expected one or more")
    # Arrow opens no path that is not UTF-8.
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(unfinished.open("wb"))
        if unfinished.suffix.lower() == ".parquet":
            # Measured values almost never repeat: a dictionary of them would only be dropped again.
            writer = pq.ParquetWriter(file, first.schema, use_dictionary=False)
        else:
            unquoted = pacsv.WriteOptions(quoting_header="none")
            writer = pacsv.CSVWriter(file, first.schema, write_options=unquoted)
        stack.enter_context(writer)
        for table in itertools.chain([first], arrow):
            if table.schema != first.schema:
                raise RecordingError(
                    f"{path}: parts of the recording differ in their columns; expected "
                    f"{', '.join(first.schema.names)} in each"
                )
            writer.write_table(table, ROW_GROUP)


def _kind_of(path: Path) -> str:
    """Return the type of a recording file: the one place that chooses a reader."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if path.is_dir():
        if (path / "metadata.yaml").exists():
            return "bag"
        if any((path / name).exists() for name in SERVO_FOLDERS):
            raise RecordingError(f"{path}: no torque, {SERVO_HINT}")
        raise RecordingError(
            f"{path}: is a folder without the metadata.yaml of a ROS 2 bag; expected a file:"
            f" {_EXPECTED}"
        )
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind is None:
        with path.open("rb") as file:
            start = file.read(max(map(len, _BEGINNINGS)))
        kind = next((k for bytes_, k in _BEGINNINGS.items() if start.startswith(bytes_)), None)
    if kind is None:
        raise RecordingError(f"{path}: unknown file type {path.suffix!r}; expected {_EXPECTED}")
    return kind


def _checked(
    place: str, file: _File, layout: ColumnLayout, pieces: Iterator[Columns]
) -> Iterator[Table]:
    """Return pieces in SI units, every row checked."""
    before: dict[str, float] | None = None
    row = 0
    start = None
    read, time_name = {column.name: column for column in layout.columns}, layout.time_column.name
    tick = file.tick(time_name)
    for piece in pieces:
        time = piece.pop(time_name)
        if time.size == 0:
            continue
        if layout.relative or tick is not None:
            # Nanoseconds since 1970 have more digits than float64: subtracted as integers.
            start = time[0] if start is None else start
            with np.errstate(invalid="ignore"):  # infinite times are a fault that is named below
                time = time - start
        seconds = np.asarray(time * (tick or read[time_name].factor), np.float64)
        values = {
            name: np.asarray((v - read[name].zero) * read[name].factor, np.float64)
            for name, v in piece.items()
        }
        table = {"time": seconds, **values}
        if fault := first_fault(table, before):
            number = file.line(row + fault.row)
            where = f"row {row + fault.row + 1}" + ("" if number is None else f" (line {number})")
            name = time_name if fault.column == "time" else fault.column
            column = "" if name is None else f", column {name}"
            raise RecordingError(f"{place}: {where}{column}: {fault.problem}")
        yield table
        before = {name: float(values[-1]) for name, values in table.items()}
        row += time.size


def _open_arrays(place: object, header: Header, arrays: Mapping[str, np.ndarray]) -> _File:
    """Open columns that are in memory."""

    def read(layout: ColumnLayout) -> Iterator[Columns]:
        sizes = {name: arrays[name].size for name in layout.names}
        if len(set(sizes.values())) > 1:
            listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordingError(f"{place}: arrays of different lengths: {listed}")
        return iter([{name: arrays[name] for name in layout.names}])

    return _File(header, read)


def _read_npz(path: Path) -> tuple[Header, Columns]:
    """Read the arrays of a NumPy `.npz` file as columns.

    An array of one axis is a column of its name; one of two axes, samples by joints, is the columns
    `name[0]`, `name[1]` and on. `joint_names`, an array of texts, names the joints.
    """
    try:
        with path.open("rb") as stream, contextlib.ExitStack() as stack:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise RecordingError(
                    f"{path}: holds one array; expected an .npz file of several: time, position,"
                    " torque"
                )
            stack.enter_context(contextlib.closing(file))
            _check_sizes(path)
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except (RecordingError, PermissionError):
        raise
    except (ValueError, OSError, *_DAMAGE) as error:
        raise RecordingError(f"{path}: is no readable .npz file: {one_line(error)}") from error
    columns: Columns = {}
    for name, values in arrays.items():
        if not np.issubdtype(values.dtype, np.number) or np.iscomplexobj(values):
            continue
        if values.ndim == 2 and values.shape[1] > 1:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(values.T)}
        elif values.ndim in (1, 2):
            columns[name] = values.reshape(len(values))
    if not columns:
        listed = ", ".join(arrays) or "no array"
        raise RecordingError(f"{path}: has {listed}; expected arrays time, position and torque")
    names = arrays.get("joint_names")
    return Header(list(columns), None if names is None else tuple(map(str, names.ravel()))), columns


# Bytes that one byte can stand for in a deflated file (zlib's documentation, 'Technical details').
_MOST_DEFLATED = 1032


def _check_sizes(path: Path) -> None:
    """Check that arrays are no larger than their members, before memory is taken for them.

    **Raises** `ValueError` for an array that claims more.
    """
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            with archive.open(member) as stream:
                claimed = _claimed_bytes(member.filename, stream)
            if claimed > min(member.file_size, _MOST_DEFLATED * member.compress_size):
                raise ValueError(
                    f"{member.filename} claims {claimed:.3g} bytes, its part of the file holds"
                    f" {member.file_size:.3g} at most"
                )


def _claimed_bytes(name: str, stream: Any) -> int:
    """Return the size that the header of an array says; 0 of what is no array."""
    if stream.read(len(np.lib.format.MAGIC_PREFIX)) != np.lib.format.MAGIC_PREFIX:
        return 0
    stream.seek(0)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    else:  # of fields whose names are no Latin-1
        raise ValueError(f"{name} has fields; expected an array of numbers")
    return math.prod(shape) * dtype.itemsize


def _array(column: pa.Array) -> np.ndarray:
    """Return a column as NumPy has it: plain numbers without Arrow's own conversion, which imports
    pandas (0.3 s)."""
    plain = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
    if plain and not column.null_count:
        return np.from_dlpack(column)  # pyright: ignore[reportArgumentType]
    return column.to_numpy(zero_copy_only=False)


class _Cell(NamedTuple):
    """Place of a number in a Parquet file.

    Its column, the type of its numbers and, in a column of lists, its place and their length.
    """

    column: str
    kind: pa.DataType
    place: int = 0
    length: int | None = None


def _open_parquet(path: Path) -> _File:
    """Open a Parquet file of numbers, decimals, time stamps, and lists of numbers.

    A column of lists, as in data sets of LeRobot, is the columns `name[0]`, `name[1]` and on.
    """
    try:
        with path.open("rb") as stream, pq.ParquetFile(stream) as file:
            listed = list(_parquet_cells(file))
            cells = dict(listed)
    except PermissionError:
        raise
    except (pa.ArrowException, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path}: is no readable Parquet file: {one_line(error)}") from error

    def tick(name: str) -> float | None:
        kind = cells[name].kind
        stamps = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
        return _TICKS[kind.unit] if stamps else None

    def read(layout: ColumnLayout) -> Iterator[Columns]:
        time = layout.time_column.name
        numbers = (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal)
        wanted: dict[str, _Cell] = {}
        for name in layout.names:
            kind = cells[name].kind
            if name == time and (pa.types.is_integer(kind) or tick(name) is not None):
                wanted[name] = cells[name]._replace(kind=pa.int64())
            elif any(number(kind) for number in numbers):
                wanted[name] = cells[name]._replace(kind=pa.float64())
            else:
                raise RecordingError(f"{path}: column {name} holds {kind}; expected numbers")
        return _parquet_pieces(path, wanted)

    return _File(Header([name for name, _ in listed]), read, tick)


def _parquet_cells(file: pq.ParquetFile) -> Iterator[tuple[str, _Cell]]:
    """Yield the names under which the numbers of a file are read, and their places."""
    schema = file.schema_arrow
    lists = [field.name for field in schema if _is_list(field.type)]
    first: dict[str, list[Any]] = {}
    if lists:
        batch = next(file.iter_batches(1, columns=lists), None)
        first = {} if batch is None else {name: batch.column(name)[0].as_py() for name in lists}
    for field in schema:
        if field.name in lists:
            length = len(first.get(field.name) or ())
            for index in range(length):
                yield (
                    f"{field.name}[{index}]",
                    _Cell(field.name, field.type.value_type, index, length),
                )
        else:
            yield field.name, _Cell(field.name, field.type)


def _is_list(kind: pa.DataType) -> bool:
    return any(
        test(kind)
        for test in (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    )


def _parquet_pieces(path: Path, cells: Mapping[str, _Cell]) -> Iterator[Columns]:
    row = 0
    columns = list(dict.fromkeys(cell.column for cell in cells.values()))
    try:
        # Buffered reading takes pages as they are needed; a row group may be the whole file.
        with (
            path.open("rb") as stream,
            pq.ParquetFile(stream, buffer_size=_READ_BYTES, pre_buffer=False) as file,
        ):
            batches = file.iter_batches(
                batch_size=ROW_GROUP // 4, columns=columns, use_threads=False
            )
            for batch in batches:
                _check_cells(path, row, batch, columns)
                yield {
                    name: _array(_numbers(path, row, cell, batch.column(cell.column)))
                    for name, cell in cells.items()
                }
                row += batch.num_rows
    except (pa.ArrowInvalid, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path}: is damaged after row {row}: {one_line(error)}") from error


def _check_cells(path: Path, row: int, batch: pa.RecordBatch, columns: Sequence[str]) -> None:
    """**Raises** `RecordingError` for an empty cell; `row` rows come before the batch."""
    for name in columns:
        nulls = batch.column(name).is_null().to_numpy(zero_copy_only=False)
        if nulls.any():
            raise RecordingError(
                f"{path}: row {row + int(np.argmax(nulls)) + 1}, column {name}: "
                f"{_EMPTY}; expected a number; delete the row, or fill the cell"
            )


def _numbers(path: Path, row: int, cell: _Cell, column: Any) -> pa.Array:
    """Return the numbers of some rows, of which `row` come before; lists have one length."""
    if cell.length is not None:
        lengths = pc.list_value_length(column).to_numpy(zero_copy_only=False)
        wrong = lengths != cell.length
        if wrong.any():
            at = int(np.argmax(wrong))
            raise RecordingError(
                f"{path}: row {row + at + 1}, column {cell.column}: {lengths[at]} values; expected"
                f" {cell.length}, as in the first row"
            )
        column = column.flatten()[cell.place :: cell.length]
    return column.cast(cell.kind, safe=False)


class _CsvHeader(NamedTuple):
    """Beginning of a CSV file.

    - `names`: of the columns, without spaces about them.
    - `lines`: before the first line of data; comments among them.
    - `first`: cells of the first row; empty if there is none.
    - `named`: whether the file has a header line.
    """

    names: list[str]
    delimiter: str = ","
    lines: int = 0
    first: Sequence[str] = ()
    named: bool = True


def _open_csv(path: Path, delimiter: str | None) -> _File:
    """Open a CSV file, all of whose columns that are read are numbers."""
    try:
        header = _csv_header(path, delimiter)
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: is no CSV text in UTF-8: {one_line(error)}") from error

    def line(row: int) -> int | None:
        return next((n for n, _ in itertools.islice(_csv_rows(path, header), row, None)), None)

    hint = "" if header.named else "the file has no header line"
    return _File(
        Header(header.names, hint=hint), lambda layout: _csv_pieces(path, header, layout), line=line
    )


def _csv_header(path: Path, delimiter: str | None) -> _CsvHeader:
    """Read names and delimiter from the first lines.

    Lines that begin with `#` are comments; the last before the first row is the header where that
    row is one of numbers, as `numpy.savetxt` writes it. Without one, columns are called `column 1`,
    `column 2` and so on.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        comment = ""
        lines = enumerate(file, start=1)
        for number, line in lines:
            if line.lstrip().startswith("#"):
                comment = line.strip().lstrip("#").strip()
            if not _is_data(line):
                continue
            cells, mark = _cells(line, delimiter)
            if all(_is_number(cell) for cell in cells):
                names, _ = _cells(comment, mark)
                if len(names) == len(cells):
                    return _CsvHeader(names, mark, number - 1, cells)
                if not _counts(cells):
                    names = [f"column {i}" for i in range(1, len(cells) + 1)]
                    return _CsvHeader(names, mark, number - 1, cells, named=False)
            first = next((text for _, text in lines if _is_data(text)), "")
            return _CsvHeader(cells, mark, number, _cells(first, mark)[0] if first else [])
    return _CsvHeader([])


def _csv_pieces(path: Path, header: _CsvHeader, layout: ColumnLayout) -> Iterator[Columns]:
    numbers = {name: str(header.names.index(name)) for name in layout.names}
    types = dict.fromkeys(numbers.values(), pa.float64())
    if len(header.first) == len(header.names):
        time = layout.time_column.name
        start = header.first[header.names.index(time)].strip()
        if start.isdigit() and len(start) > _EXACT_DIGITS:  # as nanoseconds since 1970
            types[numbers[time]] = pa.int64()
    read_options = pacsv.ReadOptions(
        block_size=2 * _READ_BYTES,
        use_threads=False,
        column_names=[str(i) for i in range(len(header.names))],
    )
    convert_options = pacsv.ConvertOptions(
        column_types=types, include_columns=list(types), null_values=[]
    )
    try:
        with path.open("rb") as file:
            for _ in range(header.lines):
                file.readline()
            while lines := file.read(_READ_BYTES) + file.readline():
                data = _data_of(lines, header.delimiter)
                if not data.strip():
                    continue
                rows = pacsv.read_csv(
                    pa.BufferReader(data),
                    read_options,
                    pacsv.ParseOptions(delimiter=header.delimiter),
                    convert_options,
                )
                columns = (_array(column.combine_chunks()) for column in rows.columns)
                yield dict(zip(numbers, columns, strict=True))
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        # Arrow names the cell of some faults only, and not its line: look again, slowly.
        raise _faulty_cell(path, header, layout.names) or RecordingError(
            f"{path}: {one_line(error)}"
        ) from error


def _data_of(lines: bytes, delimiter: str) -> bytes:
    """Return lines without comments, and with one space between cells where spaces part them."""
    if b"#" in lines:
        kept = lines.splitlines(keepends=True)
        lines = b"".join(line for line in kept if not line.lstrip().startswith(b"#"))
    if delimiter == " ":
        lines = re.sub(rb"[ ]*(\r?\n)[ ]*|(?<=[ ])[ ]+", rb"\1", lines).lstrip(b" ")
    return lines


def _faulty_cell(path: Path, header: _CsvHeader, names: Sequence[str]) -> RecordingError | None:
    """Look for the first row of a wrong length, or cell of the columns that is no number."""
    try:
        for number, (line, cells) in enumerate(_csv_rows(path, header), start=1):
            where = f"{path}: row {number} (line {line})"
            if len(cells) != len(header.names):
                return RecordingError(
                    f"{where}: {len(cells)} cells; expected {len(header.names)}, one per column"
                )
            for name, cell in zip(header.names, cells, strict=True):
                if name in names and not _is_number(cell):
                    point = " with a decimal point" if _is_number(cell.replace(",", ".")) else ""
                    shown, expected = (
                        (repr(cell), f"a number{point}")
                        if cell.strip()
                        else (_EMPTY, "a number; delete the row, or fill the cell")
                    )
                    return RecordingError(f"{where}, column {name}: {shown}; expected {expected}")
    except (UnicodeDecodeError, csv.Error) as error:
        return RecordingError(f"{path}: is no CSV text in UTF-8: {one_line(error)}")
    return None


def _csv_rows(path: Path, header: _CsvHeader) -> Iterator[tuple[int, list[str]]]:
    """Return the data rows of a file: the line that each ends on, and its cells."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        line = 0

        def data() -> Iterator[str]:
            nonlocal line
            for line, text in enumerate(file, start=1):
                if line > header.lines and _is_data(text):
                    yield " ".join(text.split()) if header.delimiter == " " else text

        for cells in csv.reader(data(), delimiter=header.delimiter):
            yield line, cells


def _cells(line: str, delimiter: str | None) -> tuple[list[str], str]:
    """Return the cells of a line, and what is between them: by default the first mark it has."""
    line = line.strip()
    mark = delimiter or next((mark for mark in _DELIMITERS if mark in line), ",")
    if mark == " ":
        line = " ".join(line.split())
    return [cell.strip() for row in csv.reader([line], delimiter=mark) for cell in row], mark


def _counts(cells: Sequence[str]) -> bool:
    """Return whether cells count up from 0 or 1, as names of columns without names do."""
    return any(cells == [str(start + i) for i in range(len(cells))] for start in (0, 1))


def _is_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell

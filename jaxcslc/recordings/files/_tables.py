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
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from jaxtyping import Float

from .._recording import RecordingError, first_fault
from ._bag import joint_states, read_bag
from ._layout import ColumnLayout, Header, beginning, one_line


ROW_GROUP = 1 << 16
"""Rows of a Parquet row group: what its readers must be able to hold at a time."""

_READ_BYTES = 1 << 20  # of a file at a time: enough for speed, little next to a chunk's arrays
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

Table = dict[str, Float[np.ndarray, " rows"]]
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
            file = _open_csv(path, delimiter)
        elif kind == "parquet":
            file = _open_parquet(path)
        elif kind == "bag":
            file = _open_arrays(path, *read_bag(path, joints, topic))
        else:
            file = _open_arrays(path, *_read_npz(path))
        layout = layout_of(str(path), file.header)
        for name in layout.names:
            if name not in file.header.names:
                raise RecordingError(
                    f"{path}: no column {name!r}; the file has {beginning(file.header.names)}"
                )
            if file.header.names.count(name) > 1:
                raise RecordingError(f"{path}: column {name!r} occurs more than once")
        return layout, _checked(path, file, layout, file.read(layout))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {one_line(error)}") from error


def topics_of(path: Path, joints: Sequence[str] | None, topic: str | None) -> list[str] | None:
    """Return the topics of a bag's joint states, or None for a file that is no bag.

    `joints` and `topic` are as for `open_table`, and so are errors.
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
    # Arrow opens no path that is not UTF-8.
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(unfinished.open("wb"))
        if unfinished.suffix.lower() == ".parquet":
            # Measured values hardly ever repeat: a dictionary of them would only be dropped again.
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
    path: Path, file: _File, layout: ColumnLayout, pieces: Iterator[Columns]
) -> Iterator[Table]:
    """Return pieces in SI units, every row checked."""
    before: dict[str, float] | None = None
    row = 0
    start = None
    factors, time_name = layout.factors, layout.time_column.name
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
        seconds = np.asarray(time * (tick or factors[time_name]), np.float64)
        values = {name: np.asarray(v * factors[name], np.float64) for name, v in piece.items()}
        table = {"time": seconds, **values}
        if fault := first_fault(table, before):
            number = file.line(row + fault.row)
            where = f"row {row + fault.row + 1}" + ("" if number is None else f" (line {number})")
            name = time_name if fault.column == "time" else fault.column
            column = "" if name is None else f", column {name}"
            raise RecordingError(f"{path}: {where}{column}: {fault.problem}")
        yield table
        before = {name: float(values[-1]) for name, values in table.items()}
        row += time.size


def _open_arrays(path: Path, header: Header, arrays: Mapping[str, np.ndarray]) -> _File:
    """Open columns that are in memory."""

    def read(layout: ColumnLayout) -> Iterator[Columns]:
        sizes = {name: arrays[name].size for name in layout.names}
        if len(set(sizes.values())) > 1:
            listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise RecordingError(f"{path}: arrays of different lengths: {listed}")
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


def _open_parquet(path: Path) -> _File:
    """Open a Parquet file of numbers, decimals and time stamps."""
    try:
        with path.open("rb") as stream, pq.ParquetFile(stream) as file:
            schema = file.schema_arrow
    except PermissionError:
        raise
    except (pa.ArrowException, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path}: is no readable Parquet file: {one_line(error)}") from error

    def tick(name: str) -> float | None:
        kind = schema.field(name).type
        stamps = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
        return _TICKS[kind.unit] if stamps else None

    def read(layout: ColumnLayout) -> Iterator[Columns]:
        time = layout.time_column.name
        numbers = (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal)
        types: dict[str, pa.DataType] = {}
        for name in layout.names:
            kind = schema.field(name).type
            if name == time and (pa.types.is_integer(kind) or tick(name) is not None):
                types[name] = pa.int64()
            elif any(number(kind) for number in numbers):
                types[name] = pa.float64()
            else:
                raise RecordingError(f"{path}: column {name} holds {kind}; expected numbers")
        return _parquet_pieces(path, types)

    return _File(Header(list(schema.names)), read, tick)


def _parquet_pieces(path: Path, types: dict[str, pa.DataType]) -> Iterator[Columns]:
    row = 0
    try:
        # Buffered reading takes pages as they are needed; a row group may be the whole file.
        with (
            path.open("rb") as stream,
            pq.ParquetFile(stream, buffer_size=_READ_BYTES, pre_buffer=False) as file,
        ):
            batches = file.iter_batches(
                batch_size=ROW_GROUP // 4, columns=list(types), use_threads=False
            )
            for batch in batches:
                for name in types:
                    nulls = batch.column(name).is_null().to_numpy(zero_copy_only=False)
                    if nulls.any():
                        raise RecordingError(
                            f"{path}: row {row + int(np.argmax(nulls)) + 1}, column {name}: "
                            "an empty cell; expected a number"
                        )
                yield {
                    name: _array(batch.column(name).cast(kind, safe=False))
                    for name, kind in types.items()
                }
                row += batch.num_rows
    except (pa.ArrowInvalid, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path}: is damaged after row {row}: {one_line(error)}") from error


class _CsvHeader(NamedTuple):
    """Beginning of a CSV file.

    - `names`: of the columns, without spaces about them.
    - `lines`: before the first line of data; comments among them.
    - `first`: cells of the first row; empty if there is none.
    """

    names: list[str]
    delimiter: str = ","
    lines: int = 0
    first: Sequence[str] = ()


def _open_csv(path: Path, delimiter: str | None) -> _File:
    """Open a CSV file, all of whose columns that are read are numbers."""
    try:
        header = _csv_header(path, delimiter)
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: is no CSV text in UTF-8: {one_line(error)}") from error

    def line(row: int) -> int | None:
        return next((n for n, _ in itertools.islice(_csv_rows(path, header), row, None)), None)

    return _File(Header(header.names), lambda layout: _csv_pieces(path, header, layout), line=line)


def _csv_header(path: Path, delimiter: str | None) -> _CsvHeader:
    """Read names and delimiter from the first lines.

    Lines that begin with `#` are comments; the last before the first row is the header where that
    row is one of numbers, as `numpy.savetxt` writes it.
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
                    f"{where}: {len(cells)} cells; expected {len(header.names)}, one a column"
                )
            for name, cell in zip(header.names, cells, strict=True):
                if name in names and not _is_number(cell):
                    shown = "an empty cell" if not cell.strip() else repr(cell)
                    point = " with a decimal point" if _is_number(cell.replace(",", ".")) else ""
                    return RecordingError(
                        f"{where}, column {name}: {shown}; expected a number{point}"
                    )
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


def _is_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell

"""Header and columns of CSV files, and the line and cell of a fault."""

import csv
import dataclasses
import io
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv

from .._recording import RecordingError


_LONGEST = 300


def one_line(error: Exception) -> str:
    """An error's message on one line, cut where it quotes a file's bytes at length."""
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


READ_BYTES = 1 << 20
"""Bytes of a file that are read at a time: enough for speed, little next to a chunk's arrays."""

_DELIMITERS = (",", ";", "\t", " ")
_LONG_INTEGER = 15  # digits: beyond, float64 rounds integers, as nanoseconds since 1970


@dataclasses.dataclass(frozen=True)
class CsvHeader:
    """Beginning of a CSV file: its names, its delimiter and its first row.

    **Attributes**

    - `names`: of the columns, without spaces about them.
    - `delimiter`: between cells.
    - `lines`: before the first line of data; comments among them.
    - `first`: cells of the first row; empty if there is none.
    """

    names: list[str]
    delimiter: str
    lines: int
    first: list[str]


def read_csv_header(path: Path, delimiter: str | None = None) -> CsvHeader:
    """Read names and delimiter from the first lines of a CSV file.

    Lines that begin with `#` are comments; the last before the first row is the header where that
    row is one of numbers, as `numpy.savetxt` writes it.

    **Raises** `RecordingError` for what is no text in UTF-8.
    """
    try:
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
                        return CsvHeader(names, mark, number - 1, cells)
                following = (text for _, text in lines if _is_data(text))
                first = next(following, "")
                return CsvHeader(cells, mark, number, _cells(first, mark)[0] if first else [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: is no CSV text in UTF-8: {one_line(error)}") from error
    return CsvHeader([], ",", 0, [])


def read_csv(
    path: Path, header: CsvHeader, names: Sequence[str], *, time: str
) -> Iterator[pa.RecordBatch]:
    """Read some columns of a CSV file, batch by batch.

    **Arguments**

    - `path`, `header`: of the file.
    - `names`: of the columns, all numbers.
    - `time`: the one of time, whose long integers are read exactly.

    **Raises** `RecordingError` for a cell that is no number or a row of another length.
    """
    numbers = {name: str(header.names.index(name)) for name in names}
    types = dict.fromkeys(numbers.values(), pa.float64())
    if header.first and len(header.first) == len(header.names):
        start = header.first[header.names.index(time)].strip()
        if start.isdigit() and len(start) > _LONG_INTEGER:
            types[numbers[time]] = pa.int64()
    try:
        with path.open("rb") as file:
            for _ in range(header.lines):
                file.readline()
            lines = io.BufferedReader(_DataLines(file, header.delimiter), READ_BYTES)
            if not lines.peek(1):
                return
            with pacsv.open_csv(
                lines,
                # Reading ahead on other threads would hold blocks that no one has asked for.
                read_options=pacsv.ReadOptions(
                    block_size=READ_BYTES,
                    use_threads=False,
                    column_names=[str(i) for i in range(len(header.names))],
                ),
                parse_options=pacsv.ParseOptions(delimiter=header.delimiter),
                convert_options=pacsv.ConvertOptions(
                    column_types=types, include_columns=list(types), null_values=[]
                ),
            ) as reader:
                for batch in reader:
                    yield pa.record_batch(batch.columns, names=list(names))
    except (pa.ArrowInvalid, UnicodeDecodeError) as error:
        # Arrow names the cell of some faults only, and not its line: look again, slowly.
        raise _faulty_cell(path, header, names) or RecordingError(
            f"{path}: {one_line(error)}"
        ) from error


def line_of(path: Path, header: CsvHeader, row: int) -> int | None:
    """Return the line on which a data row of a CSV file ends; None without such a row.

    Rows count from 0 and lines from 1.
    """
    rows = itertools.islice(_rows(path, header), row, None)
    return next((number for number, _ in rows), None)


class _DataLines(io.RawIOBase):
    """A file's lines of data: without comments, and one space between cells where spaces part them.

    - `file`: at its first line of data.
    - `delimiter`: between cells.
    """

    def __init__(self, file: io.BufferedReader, delimiter: str):
        self._file, self._delimiter = file, delimiter
        self._block = memoryview(b"")

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        while not self._block:
            block = self._file.read(READ_BYTES) + self._file.readline()
            if not block:
                return 0
            self._block = memoryview(self._data_of(block))
        size = min(len(buffer), len(self._block))
        buffer[:size] = self._block[:size]
        self._block = self._block[size:]
        return size

    def _data_of(self, block: bytes) -> bytes:
        if b"#" in block:
            lines = block.splitlines(keepends=True)
            block = b"".join(line for line in lines if not line.lstrip().startswith(b"#"))
        if self._delimiter == " ":
            block = re.sub(rb"[ ]*(\r?\n)[ ]*|(?<=[ ])[ ]+", rb"\1", block).lstrip(b" ")
        return block


def _faulty_cell(path: Path, header: CsvHeader, names: Sequence[str]) -> RecordingError | None:
    """Look for the first cell that is no number, or row of a wrong length.

    - `names`: of the columns that are to hold numbers.
    """
    try:
        for number, (line, cells) in enumerate(_rows(path, header), start=1):
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


def _rows(path: Path, header: CsvHeader) -> Iterator[tuple[int, list[str]]]:
    """The data rows of a file: the line that each ends on, and its cells."""
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
    """The cells of a line, and what is between them: by default the first mark that it has."""
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

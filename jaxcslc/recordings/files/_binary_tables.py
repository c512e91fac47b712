"""Columns of NumPy's `.npz` files and of Parquet files."""

import contextlib
import struct
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .._recording import RecordingError
from ._csv_table import READ_BYTES, one_line
from ._layout import Header


# What unpacking a damaged file raises; `RuntimeError` is of encrypted ones and unknown versions.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error)


def read_npz(path: Path) -> tuple[Header, dict[str, Any]]:
    """Read the arrays of a NumPy `.npz` file as columns.

    An array of one axis is a column of its name; one of two axes, samples by joints, is the columns
    `name[0]`, `name[1]` and on. `joint_names`, an array of texts, names the joints.

    **Returns** the header and the columns.

    **Raises** `RecordingError` for what is no such file, and arrays of different lengths.
    """
    try:
        with path.open("rb") as stream, contextlib.closing(_loaded(path, stream)) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except RecordingError:
        raise
    except (ValueError, OSError, EOFError, RuntimeError, *_DAMAGE) as error:
        if isinstance(error, PermissionError):
            raise
        raise RecordingError(f"{path}: is no readable .npz file: {one_line(error)}") from error
    joint_names: tuple[str, ...] | None = None
    columns: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        if name == "joint_names":
            joint_names = tuple(str(text) for text in values.ravel())
        elif not (np.issubdtype(values.dtype, np.number) and not np.iscomplexobj(values)):
            continue
        elif values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2 and values.shape[1] == 1:
            columns[name] = values[:, 0]
        elif values.ndim == 2:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(values.T)}
    if not columns:
        listed = ", ".join(arrays) or "no array"
        raise RecordingError(f"{path}: has {listed}; expected arrays time, position and torque")
    return Header(list(columns), joint_names), columns


def _loaded(path: Path, stream: IO[bytes]) -> Any:
    file = np.load(stream, allow_pickle=False)
    if not isinstance(file, np.lib.npyio.NpzFile):
        raise RecordingError(
            f"{path}: holds one array; expected an .npz file of several: time, position, torque"
        )
    return file


_TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read_parquet_header(path: Path) -> list[str]:
    """The names of a Parquet file's columns.

    **Raises** `RecordingError` for what is no Parquet file.
    """
    return list(_schema(path).names)


def time_unit(path: Path, time: str) -> float | None:
    """Seconds in one tick of a column of time stamps or durations; None for one of numbers."""
    kind = _schema(path).field(time).type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return _TICKS[kind.unit]
    return None


def read_parquet(path: Path, names: Sequence[str], *, time: str) -> Iterator[pa.RecordBatch]:
    """Read some columns of a Parquet file, batch by batch: numbers, decimals, time stamps.

    **Arguments**

    - `path`: of the file.
    - `names`: of the columns.
    - `time`: the one that may hold time stamps, which become integers.

    **Raises** `RecordingError` for columns of other types, empty cells and damage.
    """
    schema = _schema(path)
    types: dict[str, pa.DataType] = {}
    for name in names:
        kind = schema.field(name).type
        if name == time and (pa.types.is_timestamp(kind) or pa.types.is_duration(kind)):
            types[name] = pa.int64()
        elif pa.types.is_floating(kind) or pa.types.is_decimal(kind):
            types[name] = pa.float64()
        elif pa.types.is_integer(kind):
            types[name] = pa.int64() if name == time else pa.float64()
        else:
            raise RecordingError(f"{path}: column {name} holds {kind}; expected numbers")
    return _batches(path, types)


def _batches(path: Path, types: dict[str, pa.DataType]) -> Iterator[pa.RecordBatch]:
    row = 0
    names = list(types)
    try:
        # Buffered reading takes pages as they are needed; a row group may be the whole file.
        with pq.ParquetFile(path, buffer_size=READ_BYTES, pre_buffer=False) as file:
            for batch in file.iter_batches(batch_size=1 << 14, columns=names, use_threads=False):
                for name in names:
                    nulls = batch.column(name).is_null().to_numpy(zero_copy_only=False)
                    if nulls.any():
                        raise RecordingError(
                            f"{path}: row {row + int(np.argmax(nulls)) + 1}, column {name}: "
                            "an empty cell; expected a number"
                        )
                columns = [
                    batch.column(name).cast(kind, safe=False) for name, kind in types.items()
                ]
                yield pa.record_batch(columns, names=names)
                row += batch.num_rows
    except (pa.ArrowInvalid, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path}: is damaged after row {row}: {one_line(error)}") from error


def _schema(path: Path) -> pa.Schema:
    try:
        with pq.ParquetFile(path) as file:
            return file.schema_arrow
    except (pa.ArrowException, UnicodeDecodeError, OSError) as error:
        if isinstance(error, PermissionError):
            raise
        raise RecordingError(f"{path}: is no readable Parquet file: {one_line(error)}") from error

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .. import RecordingError
from ._csv_table import READ_BYTES
from ._errors import one_line


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
    """Reads some columns of a Parquet file, batch by batch: numbers, decimals, time stamps.

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

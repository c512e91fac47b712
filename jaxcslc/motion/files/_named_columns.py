import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from .. import MINIMUM_SAMPLES, RecordingError
from ._layout import Header


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
    """Reads columns of any names from a file of samples.

    **Arguments**

    - `path`: of a `.csv`, `.parquet` or `.npz` file with a column `time` [s].
    - `names`: of the columns to read beside it, which may be in any order among others; all if
      omitted.

    **Returns**

    The columns by name, `time` first.

    **Raises**

    - `RecordingError`: as `load_recording`; in place of its columns, one that is missing.

    >>> import pathlib, tempfile
    >>> from jaxcslc.motion import load_columns
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.csv"
    ...     rows = "".join(f"{i},{2 * i},a\\n" for i in range(6))
    ...     _ = path.write_text("time,level,note\\n" + rows)
    ...     load_columns(path, ["level"])["level"].tolist()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    from ._recording_tables import open_table  # loads Arrow, which others need not wait for

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

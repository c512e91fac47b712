"""Recording of a system: named columns, sampled in time."""

import dataclasses
import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..recordings import MINIMUM_SAMPLES, RecordingError, check_samples, load_columns


if TYPE_CHECKING:
    from ._system import System


@dataclasses.dataclass(frozen=True, eq=False)
class SystemRecording:
    """Named columns of measurements, sampled in time.

    **Attributes**

    - `time`: instants of the samples, (samples,) [s], strictly increasing.
    - `columns`: by name, each (samples,), in SI units.

    Both are float64.

    **Raises** `RecordingError` for columns that differ in length, fewer than five samples, values
    that are not finite, or time that does not increase.

    >>> import numpy as np
    >>> from jaxcslc.systems import SystemRecording
    >>> time = np.arange(10) * 0.01
    >>> SystemRecording(time, {"level": np.sqrt(time)}).samples
    10
    """

    time: Float[np.ndarray, " samples"]
    columns: Mapping[str, Float[np.ndarray, " _"]]

    def __post_init__(self) -> None:
        time = np.asarray(self.time, float)
        columns = {name: np.asarray(values, float) for name, values in self.columns.items()}
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "columns", MappingProxyType(columns))
        for name, values in columns.items():
            if values.shape != time.shape:
                raise RecordingError(
                    f"column {name!r} has shape {values.shape}; expected that of time, {time.shape}"
                )
        if len(time) < MINIMUM_SAMPLES:
            raise RecordingError(f"{len(time)} samples; expected at least {MINIMUM_SAMPLES}")
        check_samples({**columns, "time": time})

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def interval(self) -> float:
        """Median interval between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def column(self, name: str) -> Float[np.ndarray, " samples"]:
        """A column, or time.

        **Raises** `RecordingError` if there is none of that name.
        """
        if name == "time":
            return self.time
        if name not in self.columns:
            raise RecordingError(
                f"missing column {name!r}; the recording has {', '.join(('time', *self.columns))}"
            )
        return self.columns[name]


def load_system_recording(
    path: str | os.PathLike[str], system: "System | None" = None
) -> SystemRecording:
    """Reads a recording of named columns.

    **Arguments**

    - `path`: of a `.csv` or `.parquet` file with a column `time` [s].
    - `system`: whose columns are read; all are if omitted.

    **Returns** the recording.

    **Raises** `RecordingError` as `jaxcslc.recordings.load_columns`, also for a missing column.

    >>> import pathlib, tempfile
    >>> from jaxcslc.systems import load_system_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.csv"
    ...     _ = path.write_text("time,level\\n" + "".join(f"{i},{2 * i}\\n" for i in range(6)))
    ...     sorted(load_system_recording(path).columns)
    ['level']
    """
    names = None if system is None else system.column_names
    columns = load_columns(path, names)
    return SystemRecording(columns.pop("time"), columns)

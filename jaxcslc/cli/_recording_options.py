"""Options of commands that say what to do with a recording once it is read."""

import contextlib
import dataclasses
from collections.abc import Generator
from pathlib import Path
from typing import Annotated

import typer

from ..checks import without_outliers
from ..manipulator import Manipulator
from ..recordings import Recording, fresh_rows, restore_clock, without_stale_rows
from ._common import ColumnsOption, recording_of


@dataclasses.dataclass(frozen=True)
class RecordingOptions:
    """Treatment of a recording once it is read, in this order.

    **Attributes**

    - `columns`: a file with a mapping of its columns.
    - `between`: as text, start and end [s from its start].
    - `drop_stale`, `every`, `period`, `despike`: as the options of the command say.
    """

    columns: ColumnsOption = None
    between: Annotated[
        str | None,
        typer.Option(
            metavar="START,END", help="Only this stretch of the recordings [s from their start]."
        ),
    ] = None
    every: Annotated[
        int | None, typer.Option(min=1, help="Only every so many rows: those with new positions.")
    ] = None
    period: Annotated[
        float | None,
        typer.Option(help="Restore the times of samples of an even clock of this period [s]."),
    ] = None
    drop_stale: Annotated[
        bool, typer.Option("--drop-stale", help="Leave out rows that repeat the row before.")
    ] = False
    despike: Annotated[
        bool,
        typer.Option(
            "--despike", help="Replace single outliers by the median of the seven samples around."
        ),
    ] = False

    def read(self, path: Path, robot: Manipulator, measured: bool | None = None) -> Recording:
        """Read a recording, its joints in the robot's order.

        - `measured`: whether torques are measurements; None for what the format says.

        **Raises**

        - `ValueError`: in one line, for a file that cannot be read, and for options that leave too
          little of it.
        """
        recording = recording_of(path, robot, self.columns)
        if measured is not None:
            recording = dataclasses.replace(recording, torque_measured=measured)
        if self.between is not None:
            start, end = _two_numbers(self.between)
            with _of_option(path, recording, f"--between {self.between}"):
                recording = recording.between(start, end)
        if self.drop_stale:
            with _of_option(path, recording, "--drop-stale"):
                recording = without_stale_rows(recording)
        if self.every is not None:
            with _of_option(path, recording, f"--every {self.every}"):
                recording = fresh_rows(recording, self.every)
        if self.period is not None:
            with _of_option(path, recording, f"--period {self.period:g}"):
                recording = restore_clock(recording, self.period)
        return without_outliers(recording) if self.despike else recording


@contextlib.contextmanager
def _of_option(path: Path, recording: Recording, option: str) -> Generator[None]:
    """Names the option and what it was of in what it raises.

    - `recording`: before it.
    """
    try:
        yield
    except ValueError as error:
        spent = float(recording.time[-1] - recording.time[0])
        raise ValueError(
            f"{path}, {option} of {recording.samples} samples in {spent:.4g} s: {error}"
        ) from error


def _two_numbers(text: str) -> tuple[float, float]:
    try:
        start, end = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--between: expected START,END in s, as in 0,8.5, got {text!r}") from None
    return start, end

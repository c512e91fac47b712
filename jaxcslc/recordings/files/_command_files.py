"""Columns of commanded and measured positions: files of arms of position servos."""

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ._column_mapping import ColumnMapping
from ._known_layouts import SERVO_RECORDING
from ._layout import ColumnLayout, Header
from ._recording_files import Table, file_joints, mapping_of, whole


class CommandTable(NamedTuple):
    """Columns of a recording of servos, in SI units.

    - `time`: shape `(samples,)` [s].
    - `quantities`: `"position"`, `"command"`, `"velocity"`, `"current"`, each `(samples, joints)`,
      or None where the file has none.
    - `joint_names`: names in the order of the columns; None where joints are numbered.
    - `notes`: sentences about what was decided in reading the file.
    """

    time: Float[np.ndarray, " samples"]
    quantities: Mapping[str, Float[np.ndarray, "samples joints"] | None]
    joint_names: tuple[str, ...] | None
    notes: tuple[str, ...]


def load_commands(
    path: str | os.PathLike[str],
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> CommandTable:
    """Read commanded and measured positions from a table or a bag.

    **Arguments**

    - `path`: a CSV, Parquet or `.npz` file, or a bag of ROS with joint states and commands.
    - `joints`, `columns`: as for `load_recording`.

    **Raises** `RecordingError`: as `load_recording`.
    """
    from ._bag import read_commanded_bag
    from ._tables import is_bag, open_columns, open_table  # load Arrow: others need not wait

    path, mapping = Path(path), mapping_of(columns)
    layout_of = _Layout(mapping, joints)
    if is_bag(path):
        mapping = mapping or ColumnMapping()
        wanted = file_joints(mapping, joints)
        header, arrays = read_commanded_bag(path, wanted, mapping.topic, mapping.command_topic)
        return _table(str(path), *open_columns(str(path), header, arrays, layout_of))
    delimiter = None if mapping is None else mapping.delimiter
    return _table(str(path), *open_table(path, layout_of, delimiter=delimiter))


def commands_of(
    place: str,
    arrays: Mapping[str, np.ndarray],
    notes: Sequence[str] = (),
    joints: int | Sequence[str] | None = None,
    columns: ColumnMapping | str | os.PathLike[str] | None = None,
) -> CommandTable:
    """Return commanded and measured positions of columns that are in memory.

    **Arguments**

    - `place`: where they were read, for messages.
    - `arrays`: columns named as in a file, such as `time`, `position_elbow` and `command_elbow`.
    - `notes`: sentences about what was decided in reading them.
    - `joints`, `columns`: as for `load_recording`.

    **Raises** `RecordingError`: as `load_recording`.
    """
    from ._tables import open_columns

    header = Header(list(arrays), notes=tuple(notes))
    layout_of = _Layout(mapping_of(columns), joints)
    return _table(place, *open_columns(place, header, dict(arrays), layout_of))


class _Layout(NamedTuple):
    """Choice of the columns of a file, by its names or by a mapping."""

    mapping: ColumnMapping | None
    joints: int | Sequence[str] | None

    def __call__(self, file: str, header: Header) -> ColumnLayout:
        kind = SERVO_RECORDING
        if self.mapping is not None:
            return self.mapping.layout(file, header, self.joints, kind)
        layout = kind.layout_by_format(file, header)
        return layout.checked(file, kind.required).for_joints(file, self.joints)


def _table(place: str, layout: ColumnLayout, pieces: Iterator[Table]) -> CommandTable:
    table = whole(place, pieces)
    quantities = layout.split(table, SERVO_RECORDING.quantities)
    return CommandTable(table["time"], quantities, layout.joint_names, layout.notes)

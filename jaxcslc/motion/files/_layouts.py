import dataclasses
from collections.abc import Sequence

from .. import RecordingError
from ._column_mapping import ColumnMapping
from ._layout import Header, Layout, is_numbered
from ._libfranka import is_libfranka, libfranka_layout
from ._named_header import is_named_header, named_layout
from ._recording_columns import checked_columns
from ._rtde import is_rtde, rtde_layout


def layout_of(
    file: str,
    header: Header,
    joints: int | Sequence[str] | None = None,
    mapping: ColumnMapping | None = None,
) -> Layout:
    """Chooses what a file's columns mean, by their names.

    Logs of Universal Robots and libfranka, columns that say joint and unit, or this package's
    own; a mapping says what is different.

    **Arguments**

    - `file`: as it is named in messages.
    - `header`: of the file.
    - `joints`: of the robot: names, which decide on the order, or how many.
    - `mapping`: of column names and units.

    **Raises** `RecordingError`: one line that says what is missing or unknown.
    """
    if mapping is None:
        return _by_format(file, header).checked(file).of_joints(file, joints)
    try:
        base = _by_format(file, header)
    except RecordingError as error:  # not a format of ours: the mapping has to say everything
        base = None
        header = dataclasses.replace(header, hint=str(error).removeprefix(f"{file}: "))
    layout = mapping.layout(file, header, base, joints).checked(file)
    if mapping.joints is not None and not isinstance(joints, int | None) and is_numbered(joints):
        return layout.of_joints(file, len(joints))  # the mapping says their order
    return layout.of_joints(file, joints)


def _by_format(file: str, header: Header) -> Layout:
    if is_rtde(header):
        return rtde_layout(header)
    if is_libfranka(header):
        return libfranka_layout(header)
    if is_named_header(header):
        return named_layout(file, header)
    return checked_columns(file, header.names)

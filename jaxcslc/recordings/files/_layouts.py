"""Layouts that column names show: libfranka, Universal Robots, named columns, the package's own."""

import dataclasses
import re
from collections.abc import Iterable, Sequence

from .._recording import RecordingError, column_names
from ._column_mapping import ColumnMapping
from ._layout import (
    QUANTITIES,
    REQUIRED,
    ColumnLayout,
    Header,
    LayoutColumn,
    is_numbered,
    listed_units,
    si_factor,
)


_JOINTS = 7
_NAMES = {"position": "state.q", "torque": "state.tau_J", "velocity": "state.dq"}


def is_libfranka(header: Header) -> bool:
    """Return whether columns are those of `franka::logToCSV`."""
    return {"time", "state.q[0]"} <= set(header.names)


def libfranka_layout(header: Header) -> ColumnLayout:
    """The layout of the log that libfranka writes, `franka::logToCSV`.

    Columns `time` [ms], `state.q[0]` to `state.q[6]` [rad], `state.dq[0]` and on [rad/s],
    `state.tau_J[0]` and on [N m]: torques measured at the links, gravity included. Commands
    are not read.
    """
    quantities = {
        quantity: tuple(LayoutColumn(f"{stem}[{joint}]") for joint in range(_JOINTS))
        for quantity, stem in _NAMES.items()
        if f"{stem}[{_JOINTS - 1}]" in header.names
    }
    return ColumnLayout(
        LayoutColumn("time", 1e-3),
        quantities,
        notes=header.notes,
        hint="the log has no column state.tau_J[6]",
    )


_PREFIXES = {
    "time": ("time", "t", "timestamp", "stamp"),
    "position": ("position", "pos", "q", "angle"),
    "velocity": ("velocity", "vel", "speed", "qd", "dq"),
    "acceleration": ("acceleration", "acc", "qdd", "ddq"),
    "torque": ("torque", "tau", "effort"),
    "current": ("current",),
}
_QUANTITIES = {prefix: name for name, prefixes in _PREFIXES.items() for prefix in prefixes}
_COLUMN = re.compile(
    r"""(?P<prefix>[A-Za-z]+)
        (?:_(?P<joint>.+?) | \[(?P<index>[0-9]+)\] | (?P<number>[0-9]+))?
        \s*(?:[\[(]\s*(?P<unit>[^\[\]()\d][^\[\]()]*)[\])])?""",
    re.VERBOSE,
)


@dataclasses.dataclass(frozen=True)
class NamedColumn:
    """Meaning of a column's name: `q_shoulder [deg]` is a position of `shoulder` in degrees."""

    name: str
    prefix: str
    quantity: str
    joint: str | None
    unit: str | None

    @classmethod
    def of(cls, name: str) -> "NamedColumn | None":
        """Parse a column's name; return None if it does not begin with a quantity's name.

        >>> NamedColumn.of("q_shoulder [deg]").joint, NamedColumn.of("tau[0]").quantity
        ('shoulder', 'torque')
        """
        parts = _COLUMN.fullmatch(name)
        if parts is None or parts["prefix"].lower() not in _QUANTITIES:
            return None
        joint = next((parts[key] for key in ("joint", "index", "number") if parts[key]), None)
        prefix = parts["prefix"].lower()
        return cls(name, prefix, _QUANTITIES[prefix], joint, parts["unit"])

    @property
    def is_telling(self) -> bool:
        """True if the name says more than the names that this package writes."""
        if self.unit is not None:
            return True
        if self.quantity != "position":
            return False
        return re.fullmatch(r"position_[0-9]+", self.name) is None


def is_named_header(header: Header) -> bool:
    """Return whether column names state quantity, joint and unit."""
    columns = [NamedColumn.of(name) for name in header.names]
    return any(column is not None and column.is_telling for column in columns)


def named_layout(file: str, header: Header) -> ColumnLayout:
    """The layout of a file whose column names say quantity, joint and, in brackets, unit.

    As in `t [ms],q_shoulder [deg],tau_shoulder [N m]`: SI units where a name has none. Columns
    without a quantity's name are left out, and a note says so.

    **Raises** `RecordingError` for a unit that is none of the quantity, a joint of which a
    quantity is missing, and currents, which need a torque constant.
    """
    columns = [column for name in header.names if (column := NamedColumn.of(name)) is not None]
    times = [column for column in columns if column.quantity == "time" and column.joint is None]
    if len(times) != 1:
        listed = ", ".join(repr(column.name) for column in times) or "none"
        raise RecordingError(f"{file}: columns of time: {listed}; expected one, as in 'time [s]'")
    by_quantity = {
        quantity: {c.joint or "": c for c in columns if c.quantity == quantity}
        for quantity in _PREFIXES
        if quantity != "time"
    }
    currents = by_quantity.pop("current")
    joints = _ordered(list(by_quantity["position"]))
    if not joints:
        raise RecordingError(f"{file}: no column of positions, as in 'q_shoulder [rad]'")
    hint = header.hint
    if currents and not by_quantity["torque"]:
        hint = current_hint(column.name for column in currents.values())
    quantities: dict[str, tuple[LayoutColumn, ...]] = {}
    for quantity, of_joints in by_quantity.items():
        if not of_joints:
            continue
        for joint in [*joints, *of_joints]:
            if joint not in of_joints or joint not in joints:
                lacking = quantity if joint not in of_joints else "position"
                raise RecordingError(
                    f"{file}: no {lacking} of joint {joint!r}; the file has positions of"
                    f" {', '.join(joints)} and {quantity} of {', '.join(of_joints)}"
                )
        quantities[quantity] = tuple(_column(file, of_joints[joint]) for joint in joints)
    read = {times[0].name, *(c.name for some in quantities.values() for c in some)}
    unread = [name for name in header.names if name not in read]
    notes = header.notes
    if unread:
        listed = ", ".join(unread[:8]) + (f" and {len(unread) - 8} more" if unread[8:] else "")
        notes = (*notes, f"columns that are not read: {listed}")
    numbered = all(joint.isdigit() for joint in joints)
    names = None if numbered or joints == [""] else tuple(joints)
    return ColumnLayout(
        _column(file, times[0]), quantities, header.joint_names or names, notes=notes, hint=hint
    )


def current_hint(names: Iterable[str]) -> str:
    """Return a message that currents alone are no torque, with the entry that is needed."""
    listed = ", ".join(names)
    return (
        f"the file has motor currents ({listed}); set unit = 'A' and a torque constant [N m/A] of"
        " each joint in [torque] of a file of --columns"
    )


def _ordered(joints: Sequence[str]) -> list[str]:
    """Joints in the file's order; numbered ones by number."""
    if all(joint.isdigit() for joint in joints):
        return sorted(joints, key=int)
    return list(joints)


def _column(file: str, column: NamedColumn) -> LayoutColumn:
    if column.unit is None:
        return LayoutColumn(column.name)
    factor = si_factor(column.unit, column.quantity)
    if factor is None and column.quantity == "torque" and si_factor(column.unit, "current"):
        raise RecordingError(f"{file}: no torque: {current_hint([column.name])}")
    if factor is None:
        raise RecordingError(
            f"{file}: column {column.name!r}: {column.unit!r} is no unit of {column.quantity};"
            f" expected {listed_units(column.quantity)}"
        )
    return LayoutColumn(column.name, factor)


EXPECTED = (
    "expected time, position_1..n, torque_1..n and, optionally, velocity_1..n, acceleration_1..n"
)


def checked_columns(file: str, names: Sequence[str]) -> ColumnLayout:
    """The layout of a file as this package writes it: SI units, joints numbered from 1.

    **Arguments**

    - `file`: as it is named in messages.
    - `names`: the columns, in any order.

    **Returns**

    What they are.

    **Raises**

    - `RecordingError`: duplicate, unknown or missing columns; nothing is guessed.
    """

    def wrong(problem: str) -> RecordingError:
        return RecordingError(f"{file}: {problem}; {EXPECTED}")

    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise wrong(f"column {_listed_columns(duplicates)} occurs more than once")
    numbers: dict[str, set[int]] = {quantity: set() for quantity in QUANTITIES}
    unknown: list[str] = []
    for name in names:
        parts = re.fullmatch(r"(position|torque|velocity|acceleration)_([1-9][0-9]*)", name)
        if parts is not None:
            numbers[parts[1]].add(int(parts[2]))
        elif name != "time":
            unknown.append(name)
    if unknown:
        raise wrong(f"unknown column {_listed_columns(unknown)}")
    if "time" not in names:
        raise wrong("missing column time")
    for quantity in REQUIRED:
        if not numbers[quantity]:
            raise wrong(f"missing column {quantity}_1 (no {quantity} columns at all)")
    for quantity, present in numbers.items():
        gaps = [f"{quantity}_{number}" for number in range(1, max(present, default=0))]
        gaps = [name for name in gaps if name not in names]
        if gaps:
            raise wrong(f"missing column {_listed_columns(gaps)} before {quantity}_{max(present)}")
    joints = len(numbers["position"])
    for quantity, present in numbers.items():
        if present and len(present) != joints:
            raise wrong(
                f"{joints} position columns but {len(present)} {quantity} columns "
                "(as many of each are needed)"
            )
    return ColumnLayout(
        LayoutColumn("time"),
        {
            quantity: tuple(LayoutColumn(name) for name in column_names(quantity, joints))
            for quantity, present in numbers.items()
            if present
        },
        relative=False,
        torque_measured=False,
    )


def _listed_columns(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name) if not name.isidentifier() else name for name in names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"


_TORQUES = ("actual_current_as_torque", "target_moment")


def is_rtde(header: Header) -> bool:
    """Return whether columns are those of a Universal Robots controller."""
    return {"timestamp", "actual_q_0"} <= set(header.names)


def rtde_layout(header: Header) -> ColumnLayout:
    """The layout of a log of Universal Robots' real-time data exchange (RTDE).

    As `record.py` of the RTDE client library and `RTDEReceive` write it: columns `timestamp` [s],
    `actual_q_0` to `actual_q_5` [rad], `actual_qd_0` and on [rad/s]; cells are separated by spaces
    or commas. Torques are `actual_current_as_torque_0` and on [N m], or else `target_moment_0`
    and on [N m], with a note: the controller computes them from its model. `actual_current_0`
    and on [A] need torque constants, see `ColumnMapping`.
    """
    quantities: dict[str, tuple[LayoutColumn, ...]] = {}
    for quantity, stems in (
        ("position", ("actual_q",)),
        ("torque", _TORQUES),
        ("velocity", ("actual_qd",)),
    ):
        for stem in stems:
            columns = _numbered(header, stem)
            if columns and quantity not in quantities:
                quantities[quantity] = columns
    notes, hint = header.notes, "the log has none of actual_current_as_torque_0, target_moment_0"
    if any(column.name == "target_moment_0" for column in quantities.get("torque", ())):
        notes = (
            *notes,
            "torques are target_moment, which the controller computes from its own model; log"
            " actual_current_as_torque, or actual_current with torque constants (--columns)",
        )
    elif currents := _numbered(header, "actual_current"):
        hint = current_hint(column.name for column in currents)
    return ColumnLayout(LayoutColumn("timestamp"), quantities, notes=notes, hint=hint)


def _numbered(header: Header, stem: str) -> tuple[LayoutColumn, ...]:
    """The columns `stem_0`, `stem_1` and on that a header has."""
    pattern = re.compile(rf"{stem}_([0-9]+)")
    numbers = sorted(int(p[1]) for name in header.names if (p := pattern.fullmatch(name)))
    return tuple(LayoutColumn(f"{stem}_{number}") for number in numbers)


def layout_of(
    file: str,
    header: Header,
    joints: int | Sequence[str] | None = None,
    mapping: ColumnMapping | None = None,
) -> ColumnLayout:
    """Choose what a file's columns mean, by their names.

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


def _by_format(file: str, header: Header) -> ColumnLayout:
    if is_rtde(header):
        return rtde_layout(header)
    if is_libfranka(header):
        return libfranka_layout(header)
    if is_named_header(header):
        return named_layout(file, header)
    return checked_columns(file, header.names)

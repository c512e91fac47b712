"""Layouts that column names show: libfranka, Universal Robots, named columns, the package's own."""

import dataclasses
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from .._recording import RecordingError, column_names
from ._layout import (
    QUANTITIES,
    REQUIRED,
    ColumnLayout,
    Header,
    LayoutColumn,
    listed,
    listed_units,
    si_factor,
)


def layout_by_format(file: str, header: Header) -> ColumnLayout:
    """Choose what a file's columns mean, by their names.

    Logs of Universal Robots and libfranka, columns that say joint and unit, or this package's
    own.

    **Raises** `RecordingError`: one line that says what is missing or unknown.
    """
    names = set(header.names)
    if {"timestamp", "actual_q_0"} <= names:
        return _rtde_layout(header)
    if {"time", "state.q[0]"} <= names:
        return _libfranka_layout(header)
    if any(column.is_telling for column in _named_columns(header)):
        return _named_layout(file, header)
    return _own_layout(file, header.names)


def _libfranka_layout(header: Header, joints: int = 7) -> ColumnLayout:
    """Return the layout of the log that libfranka writes, `franka::logToCSV`.

    Columns `time` [ms], `state.q[0]` to `state.q[6]` [rad], `state.dq[0]` and on [rad/s],
    `state.tau_J[0]` and on [N m]: torques measured at the links, gravity included. Commands
    are not read.
    """
    stems = {"position": "state.q", "torque": "state.tau_J", "velocity": "state.dq"}
    quantities = {
        quantity: tuple(LayoutColumn(f"{stem}[{joint}]") for joint in range(joints))
        for quantity, stem in stems.items()
        if f"{stem}[{joints - 1}]" in header.names
    }
    hint = "the log has no column state.tau_J[6]"
    return ColumnLayout(LayoutColumn("time", 1e-3), quantities, notes=header.notes, hint=hint)


def _rtde_layout(header: Header) -> ColumnLayout:
    """Return the layout of a log of Universal Robots' real-time data exchange (RTDE).

    As `record.py` of the RTDE client library and `RTDEReceive` write it: columns `timestamp` [s],
    `actual_q_0` to `actual_q_5` [rad], `actual_qd_0` and on [rad/s]; cells are separated by spaces
    or commas. Torques are `actual_current_as_torque_0` and on [N m], or else `target_moment_0`
    and on [N m], with a note: the controller computes them from its model. `actual_current_0`
    and on [A] need torque constants, see `ColumnMapping`.
    """

    def columns(*stems: str) -> tuple[LayoutColumn, ...]:
        """Return the columns `stem_0`, `stem_1` and on, of the first stem that has any."""
        for stem in stems:
            matches = (re.fullmatch(rf"{stem}_([0-9]+)", name) for name in header.names)
            if numbers := sorted(int(match[1]) for match in matches if match):
                return tuple(LayoutColumn(f"{stem}_{number}") for number in numbers)
        return ()

    torque = columns("actual_current_as_torque", "target_moment")
    found = {"position": columns("actual_q"), "torque": torque, "velocity": columns("actual_qd")}
    notes, hint = header.notes, "the log has none of actual_current_as_torque_0, target_moment_0"
    if torque and torque[0].name == "target_moment_0":
        notes = (
            *notes,
            "torques are target_moment, which the controller computes from its own model; log"
            " actual_current_as_torque, or actual_current with torque constants (--columns)",
        )
    elif currents := columns("actual_current"):
        hint = _current_hint(column.name for column in currents)
    quantities = {quantity: some for quantity, some in found.items() if some}
    return ColumnLayout(LayoutColumn("timestamp"), quantities, notes=notes, hint=hint)


_PREFIXES = {
    "time": ("time", "t", "timestamp", "stamp"),
    "position": ("position", "pos", "q", "angle"),
    "velocity": ("velocity", "vel", "speed", "qd", "dq"),
    "acceleration": ("acceleration", "acc", "qdd", "ddq"),
    "torque": ("torque", "tau", "effort"),
    "current": ("current",),
}
_QUANTITY_OF = {prefix: name for name, prefixes in _PREFIXES.items() for prefix in prefixes}
_COLUMN = re.compile(
    r"""(?P<prefix>[A-Za-z]+)
        (?:_(?P<joint>.+?) | \[(?P<index>[0-9]+)\] | (?P<number>[0-9]+))?
        \s*(?:[\[(]\s*(?P<unit>[^\[\]()\d][^\[\]()]*)[\])])?""",
    re.VERBOSE,
)


class _NamedColumn(NamedTuple):
    """Meaning of a column's name: `q_shoulder [deg]` is a position of `shoulder` in degrees.

    `joint` is empty where the name has none.
    """

    name: str
    quantity: str
    joint: str
    unit: str | None

    @property
    def is_telling(self) -> bool:
        """True if the name says more than the names that this package writes."""
        own = re.fullmatch(r"position_[0-9]+", self.name)
        return self.unit is not None or (self.quantity == "position" and own is None)

    def with_factor(self, file: str) -> LayoutColumn:
        """Return the column with the factor of its unit, that of SI units if it has none."""
        if self.unit is None:
            return LayoutColumn(self.name)
        factor = si_factor(self.unit, self.quantity)
        if factor is None and self.quantity == "torque" and si_factor(self.unit, "current"):
            raise RecordingError(f"{file}: no torque: {_current_hint([self.name])}")
        if factor is None:
            raise RecordingError(
                f"{file}: column {self.name!r}: {self.unit!r} is no unit of {self.quantity};"
                f" expected {listed_units(self.quantity)}"
            )
        return LayoutColumn(self.name, factor)


def _named_columns(header: Header) -> list[_NamedColumn]:
    """Parse the names of columns; those that do not begin with a quantity's name are ignored."""
    columns: list[_NamedColumn] = []
    for name in header.names:
        parts = _COLUMN.fullmatch(name)
        quantity = None if parts is None else _QUANTITY_OF.get(parts["prefix"].lower())
        if parts is not None and quantity is not None:
            joint = parts["joint"] or parts["index"] or parts["number"] or ""
            columns.append(_NamedColumn(name, quantity, joint, parts["unit"]))
    return columns


def _named_layout(file: str, header: Header) -> ColumnLayout:
    """Return the layout of a file whose column names say quantity, joint and, in brackets, unit.

    As in `t [ms],q_shoulder [deg],tau_shoulder [N m]`: SI units where a name has none. Columns
    without a quantity's name are left out, and a note says so.
    """
    columns = _named_columns(header)
    times = [column for column in columns if column.quantity == "time" and not column.joint]
    if len(times) != 1:
        found = ", ".join(repr(column.name) for column in times) or "none"
        raise RecordingError(f"{file}: columns of time: {found}; expected one, as in 'time [s]'")
    by_quantity = {
        quantity: {column.joint: column for column in columns if column.quantity == quantity}
        for quantity in (*QUANTITIES, "current")
    }
    currents = by_quantity.pop("current")
    joints = list(by_quantity["position"])
    numbered = all(joint.isdigit() for joint in joints)
    if not joints:
        raise RecordingError(f"{file}: no column of positions, as in 'q_shoulder [rad]'")
    if numbered:
        joints.sort(key=int)
    hint = header.hint
    if currents and not by_quantity["torque"]:
        hint = _current_hint(column.name for column in currents.values())
    quantities: dict[str, tuple[LayoutColumn, ...]] = {}
    for quantity, found in by_quantity.items():
        if not found:
            continue
        for joint in [*joints, *found]:
            if joint not in found or joint not in joints:
                lacking = quantity if joint not in found else "position"
                raise RecordingError(
                    f"{file}: no {lacking} of joint {joint!r}; the file has positions of"
                    f" {', '.join(joints)} and {quantity} of {', '.join(found)}"
                )
        quantities[quantity] = tuple(found[joint].with_factor(file) for joint in joints)
    names = None if numbered or joints == [""] else tuple(joints)
    layout = ColumnLayout(
        times[0].with_factor(file), quantities, header.joint_names or names, hint=hint
    )
    unread = [name for name in header.names if name not in layout.names]
    more = f" and {len(unread) - 8} more" if len(unread) > 8 else ""
    note = (f"columns that are not read: {', '.join(unread[:8])}{more}",) if unread else ()
    return dataclasses.replace(layout, notes=(*header.notes, *note))


def _current_hint(names: Iterable[str]) -> str:
    """Return a message that currents alone are no torque, with the entry that is needed."""
    return (
        f"the file has motor currents ({', '.join(names)}); set unit = 'A' and a torque constant"
        " [N m/A] of each joint in [torque] of a file of --columns"
    )


def _own_layout(file: str, names: Sequence[str]) -> ColumnLayout:
    """Return the layout of a file as this package writes it: SI units, joints numbered from 1.

    Duplicate, unknown and missing columns are errors; nothing is guessed.
    """

    def wrong(problem: str) -> RecordingError:
        return RecordingError(
            f"{file}: {problem}; expected time, position_1..n, torque_1..n and, optionally,"
            " velocity_1..n, acceleration_1..n, or a file that says which columns these are"
            " (--columns)"
        )

    if duplicates := sorted({name for name in names if names.count(name) > 1}):
        raise wrong(f"column {listed(duplicates, 4)} occurs more than once")
    numbers: dict[str, set[int]] = {quantity: set() for quantity in QUANTITIES}
    unknown: list[str] = []
    for name in names:
        parts = re.fullmatch(rf"({'|'.join(QUANTITIES)})_([1-9][0-9]*)", name)
        if parts is not None:
            numbers[parts[1]].add(int(parts[2]))
        elif name != "time":
            unknown.append(name)
    if unknown:
        raise wrong(f"unknown column {listed(unknown, 4)}")
    if "time" not in names:
        raise wrong("missing column time")
    for quantity in REQUIRED:
        if not numbers[quantity]:
            raise wrong(f"missing column {quantity}_1 (no {quantity} columns at all)")
    for quantity, present in numbers.items():
        highest = max(present, default=0)
        if gaps := [n for n in column_names(quantity, highest) if n not in names]:
            raise wrong(f"missing column {listed(gaps, 4)} before {quantity}_{highest}")
    joints = len(numbers["position"])
    for quantity, present in numbers.items():
        if present and len(present) != joints:
            raise wrong(
                f"{joints} position columns but {len(present)} {quantity} columns "
                "(as many of each are needed)"
            )
    quantities = {
        quantity: tuple(map(LayoutColumn, column_names(quantity, joints)))
        for quantity, present in numbers.items()
        if present
    }
    return ColumnLayout(LayoutColumn("time"), quantities, relative=False, torque_measured=False)

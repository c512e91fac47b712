"""Layouts that column names show: libfranka, Universal Robots, named columns, the package's own."""

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from jaxcslc._text_table import first_of

from .._recording import RecordingError, column_names
from ._layout import (
    COMMAND_QUANTITIES,
    COMMANDED,
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
    columns = _TORQUE_NAMES.parsed(header.names)
    if any(column.is_telling for column in columns):
        return _named_layout(file, header, columns, (*QUANTITIES, "current"))
    return _own_layout(file, header)


def servo_layout(file: str, header: Header) -> ColumnLayout:
    """Choose what the columns of a file of servos mean, by their names.

    Commands and positions as in `goal_position_1`, `present_position_1`, or `command_elbow [deg]`,
    `position_elbow [deg]`; radians and seconds where a name has no unit.

    **Raises** `RecordingError`: one line that says what is missing or unknown.
    """
    columns = _SERVO_NAMES.parsed(header.names)
    return _named_layout(file, header, columns, COMMAND_QUANTITIES)


class RecordingKind(NamedTuple):
    """Kind of recording: its quantities, those that it needs, and its formats."""

    quantities: tuple[str, ...]
    required: tuple[str, ...]
    layout_by_format: Callable[[str, Header], ColumnLayout]


TORQUE_RECORDING = RecordingKind(QUANTITIES, REQUIRED, layout_by_format)
SERVO_RECORDING = RecordingKind(COMMAND_QUANTITIES, COMMANDED, servo_layout)


def _libfranka_layout(header: Header) -> ColumnLayout:
    """Return the layout of the log that libfranka writes, `franka::logToCSV`.

    Columns `time` [ms], `state.q[0]` to `state.q[6]` [rad], `state.dq[0]` and on [rad/s],
    `state.tau_J[0]` and on [N m]: torques measured at the links, gravity included. Commands
    are not read.
    """
    stems = {"position": "state.q", "torque": "state.tau_J", "velocity": "state.dq"}
    quantities = {
        quantity: tuple(LayoutColumn(f"{stem}[{joint}]") for joint in range(7))
        for quantity, stem in stems.items()
        if f"{stem}[6]" in header.names
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
# Commands and readings of position servos: Dynamixel's and Feetech's registers, ROS, LeRobot.
_SERVO_PREFIXES = {
    "time": _PREFIXES["time"],
    "command": (
        *("command", "commanded", "commanded_position", "command_position", "cmd"),
        *("goal", "goal_position", "target", "target_position", "desired", "desired_position"),
        *("reference", "setpoint", "action"),
    ),
    "position": (
        *_PREFIXES["position"],
        *("present_position", "actual_position", "measured_position", "observation.state"),
    ),
    "velocity": (*_PREFIXES["velocity"], "present_velocity", "present_speed"),
    "current": ("current", "present_current"),
}


class _ColumnNames:
    """Names of columns that begin with a quantity's name, and say a joint and, perhaps, a unit."""

    def __init__(self, prefixes: Mapping[str, Sequence[str]]) -> None:
        self._quantities = {prefix: name for name, given in prefixes.items() for prefix in given}
        longest_first = sorted(self._quantities, key=len, reverse=True)
        self._pattern = re.compile(
            rf"""(?P<prefix>{"|".join(map(re.escape, longest_first))})
            (?:_(?P<joint>.+?) | \[(?P<index>[0-9]+)\] | (?P<number>[0-9]+))?
            \s*(?:[\[(]\s*(?P<unit>[^\[\]()\d][^\[\]()]*)[\])])?""",
            re.VERBOSE | re.IGNORECASE,
        )

    def parsed(self, names: Iterable[str]) -> "list[_NamedColumn]":
        """Parse names of columns; those that do not begin with a quantity's name are ignored."""
        columns: list[_NamedColumn] = []
        for name in names:
            if (parts := self._pattern.fullmatch(name)) is not None:
                joint = parts["joint"] or parts["index"] or parts["number"] or ""
                quantity = self._quantities[parts["prefix"].lower()]
                columns.append(_NamedColumn(name, quantity, joint, parts["unit"]))
        return columns


_TORQUE_NAMES = _ColumnNames(_PREFIXES)
_SERVO_NAMES = _ColumnNames(_SERVO_PREFIXES)


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


def _named_layout(
    file: str, header: Header, columns: Sequence[_NamedColumn], quantities_read: Sequence[str]
) -> ColumnLayout:
    """Return the layout of a file whose column names say quantity, joint and, in brackets, unit.

    As in `t [ms],q_shoulder [deg],tau_shoulder [N m]`: SI units where a name has none. Columns
    without a quantity's name are skipped, and a note says so.
    """
    times = [column for column in columns if column.quantity == "time" and not column.joint]
    if len(times) != 1:
        found = ", ".join(repr(column.name) for column in times) or "none"
        raise RecordingError(f"{file}: columns of time: {found}; expected one, as in 'time [s]'")
    by_quantity = {
        quantity: {column.joint: column for column in columns if column.quantity == quantity}
        for quantity in quantities_read
    }
    currents = by_quantity.pop("current") if "torque" in by_quantity else {}
    joints = list(by_quantity["position"])
    numbered = all(joint.isdigit() for joint in joints)
    if not joints:
        raise RecordingError(f"{file}: no column of positions, as in 'q_shoulder [rad]'")
    if numbered:
        joints.sort(key=int)
    hint = header.hint
    if currents and not by_quantity["torque"]:
        hint = _current_hint(column.name for column in currents.values())
    if "command" not in by_quantity and _commands(header.names):
        hint = SERVO_HINT
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
    unread = [name or "one without a name" for name in header.names if name not in layout.names]
    note = (f"columns that are not read: {first_of(unread, 8)}",) if unread else ()
    return dataclasses.replace(layout, notes=(*header.notes, *note))


SERVO_HINT = "but commanded positions: use --drive servo"
"""Why a recording of servos has no torque, and what to do."""


def _commands(names: Iterable[str]) -> list[str]:
    """Return those names of columns that are of commanded positions."""
    return [c.name for c in _SERVO_NAMES.parsed(names) if c.quantity == "command"]


def _current_hint(names: Iterable[str]) -> str:
    """Return a message that currents alone are no torque, with the entry that is needed."""
    return (
        f"the file has motor currents ({', '.join(names)}); set unit = 'A' and a torque constant"
        " [N m/A] of each joint in [torque] of a file of --columns"
    )


def _own_layout(file: str, header: Header) -> ColumnLayout:
    """Return the layout of a file as this package writes it: SI units, joints numbered from 1.

    Duplicate, unknown and missing columns are errors; nothing is guessed.
    """
    names = header.names

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
    if _commands(unknown) and not numbers["torque"]:
        raise RecordingError(f"{file}: no torque, {SERVO_HINT}")
    if unknown:
        problem = header.hint or f"unknown column {listed(unknown, 4)}"
        raise RecordingError(
            f"{wrong(problem)}; jaxcslc init ROBOT LOG writes one where names or values tell"
        )
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

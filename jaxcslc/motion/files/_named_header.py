import dataclasses
import re
from collections.abc import Iterable, Sequence

from .. import RecordingError
from ._layout import Column, Header, Layout
from ._units import listed_units, si_factor


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
    """What a column's name says: `q_shoulder [deg]` is a position of `shoulder` in degrees."""

    name: str
    prefix: str
    quantity: str
    joint: str | None
    unit: str | None

    @classmethod
    def of(cls, name: str) -> "NamedColumn | None":
        """Of a column's name; None if it does not begin with a quantity's.

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
        """Whether it says more than the columns that this package writes."""
        if self.unit is not None:
            return True
        if self.quantity != "position":
            return False
        return re.fullmatch(r"position_[0-9]+", self.name) is None


def is_named_header(header: Header) -> bool:
    """Whether column names say quantity, joint and unit."""
    columns = [NamedColumn.of(name) for name in header.names]
    return any(column is not None and column.is_telling for column in columns)


def named_layout(file: str, header: Header) -> Layout:
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
    quantities: dict[str, tuple[Column, ...]] = {}
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
    return Layout(
        _column(file, times[0]), quantities, header.joint_names or names, notes=notes, hint=hint
    )


def current_hint(names: Iterable[str]) -> str:
    """Why currents alone are no torque, and what is needed."""
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


def _column(file: str, column: NamedColumn) -> Column:
    if column.unit is None:
        return Column(column.name)
    factor = si_factor(column.unit, column.quantity)
    if factor is None and column.quantity == "torque" and si_factor(column.unit, "current"):
        raise RecordingError(f"{file}: no torque: {current_hint([column.name])}")
    if factor is None:
        raise RecordingError(
            f"{file}: column {column.name!r}: {column.unit!r} is no unit of {column.quantity};"
            f" expected {listed_units(column.quantity)}"
        )
    return Column(column.name, factor)

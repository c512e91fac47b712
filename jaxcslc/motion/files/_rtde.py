import re

from ._layout import Column, Header, Layout
from ._named_header import current_hint


_TORQUES = ("actual_current_as_torque", "target_moment")


def is_rtde(header: Header) -> bool:
    """Whether columns are those of a Universal Robots controller."""
    return {"timestamp", "actual_q_0"} <= set(header.names)


def rtde_layout(header: Header) -> Layout:
    """The layout of a log of Universal Robots' real-time data exchange (RTDE).

    As `record.py` of the RTDE client library and `RTDEReceive` write it: columns `timestamp` [s],
    `actual_q_0` to `actual_q_5` [rad], `actual_qd_0` and on [rad/s]; cells are separated by spaces
    or commas. Torques are `actual_current_as_torque_0` and on [N m], or else `target_moment_0`
    and on [N m], with a note: the controller computes them from its model. `actual_current_0`
    and on [A] need torque constants, see `ColumnMapping`.
    """
    quantities: dict[str, tuple[Column, ...]] = {}
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
    return Layout(Column("timestamp"), quantities, notes=notes, hint=hint)


def _numbered(header: Header, stem: str) -> tuple[Column, ...]:
    """The columns `stem_0`, `stem_1` and on that a header has."""
    pattern = re.compile(rf"{stem}_([0-9]+)")
    numbers = sorted(int(p[1]) for name in header.names if (p := pattern.fullmatch(name)))
    return tuple(Column(f"{stem}_{number}") for number in numbers)

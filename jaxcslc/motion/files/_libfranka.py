from ._layout import Column, Header, Layout


_JOINTS = 7
_NAMES = {"position": "state.q", "torque": "state.tau_J", "velocity": "state.dq"}


def is_libfranka(header: Header) -> bool:
    """Whether columns are those of `franka::logToCSV`."""
    return {"time", "state.q[0]"} <= set(header.names)


def libfranka_layout(header: Header) -> Layout:
    """The layout of the log that libfranka writes, `franka::logToCSV`.

    Columns `time` [ms], `state.q[0]` to `state.q[6]` [rad], `state.dq[0]` and on [rad/s],
    `state.tau_J[0]` and on [N m]: torques measured at the links, gravity included. Commands
    are not read.
    """
    quantities = {
        quantity: tuple(Column(f"{stem}[{joint}]") for joint in range(_JOINTS))
        for quantity, stem in _NAMES.items()
        if f"{stem}[{_JOINTS - 1}]" in header.names
    }
    return Layout(
        Column("time", 1e-3),
        quantities,
        notes=header.notes,
        hint="the log has no column state.tau_J[6]",
    )

"""Statements of C for torque of all terms but friction of single joints."""

from collections.abc import Sequence
from typing import NamedTuple

from ....codegen import KernelText, Motion, Value, block_row, block_text, called_functions
from ....network import CSLC
from ....network.terms import JointTerm


class SmoothCode(NamedTuple):
    """Statements of C for torque of all terms but friction of single joints, a sample each.

    They read `q[BLOCK * joint + i]`, `qd`, `qdd` and `k[coefficient]`, and write rows of a block.

    **Attributes**

    - `calls`: statements that write `called[BLOCK * row + i]`; `call_count`: rows of these.
    - `torque`: that read these and write `torque[BLOCK * joint + i]`.
    - `columns`: that write `columns[BLOCK * row + i]`; `entries`: joint and coefficient of each.
    - `operations`: of torque.
    """

    calls: str
    call_count: int
    torque: str
    columns: str
    entries: tuple[tuple[int, int], ...]
    operations: int


def smooth_code(network: CSLC, block: int) -> SmoothCode:
    """The statements of a network, for blocks of so many samples."""
    motion = Motion(network.motion_count)
    graph, zero = motion.graph, motion.graph.constant(0.0)
    laws = {
        index
        for term in network.terms
        if isinstance(term, JointTerm)
        for index in network.layout.indices(term.kind).tolist()
    }
    entries: dict[tuple[int, int], Value] = {}
    for joint, index, value in network.column_entries(motion):
        if index not in laws:
            entries[joint, index] = entries.get((joint, index), zero) + value
    torque = [zero] * network.joint_count
    for (joint, index), value in entries.items():
        torque[joint] = torque[joint] + value * graph.input(f"k[{index}]")
    columns = list(entries.values())
    called = called_functions(graph, [*columns, *torque])
    rows = {name: (name, 0) for name in ("q", "qd", "qdd")}
    calling = block_text(graph, block, rows)
    reading = block_text(graph, block, rows, called, ("called", 0))

    def statements(text: KernelText, outputs: Sequence[Value], name: str) -> str:
        stores = (f"{block_row(name, block, row)} = {{0}};" for row in range(len(outputs)))
        return "\n".join(text.statements(zip(outputs, stores, strict=True)))

    return SmoothCode(
        statements(calling, [Value(graph, index) for index in called], "called"),
        len(called),
        statements(reading, torque, "torque"),
        statements(reading, columns, "columns"),
        tuple(entries),
        graph.cost(torque),
    )

from collections.abc import Sequence
from typing import NamedTuple

from ....codegen import KernelText, Motion, Operation, Value
from ....network import CSLC
from ....network.terms import JointTerm


# Functions that a compiler calls number by number. Apart from the arithmetic, that is done on
# several numbers at a time.
_CALLED = ("sin", "cos", "exp", "tanh")


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
    called = [
        index
        for index in graph.needed([*columns, *torque])
        if graph.operations[index].name in _CALLED
    ]
    rows = {graph.operations[index]: row for row, index in enumerate(called)}

    def of_motion(operation: Operation) -> str | None:
        if operation.name != "input" or operation.text.startswith("k["):
            return operation.text or None
        quantity, index = operation.text.rstrip("]").split("[")
        return f"{quantity}[{block * int(index)} + i]"

    def with_calls(operation: Operation) -> str | None:
        if operation in rows:
            return f"called[{block * rows[operation]} + i]"
        return of_motion(operation)

    def statements(outputs: Sequence[Value], name: str, *, calling: bool = False) -> str:
        text = KernelText(graph, of_motion if calling else with_calls)
        stores = (f"{name}[{block * row} + i] = {{0}};" for row in range(len(outputs)))
        return "\n".join(text.statements(zip(outputs, stores, strict=True)))

    return SmoothCode(
        statements([Value(graph, index) for index in called], "called", calling=True),
        len(called),
        statements(torque, "torque"),
        statements(columns, "columns"),
        tuple(entries),
        graph.cost(torque),
    )

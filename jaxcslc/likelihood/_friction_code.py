"""Statements of C for torque of all terms but friction of single joints."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax

from ..codegen import (
    KernelText,
    Motion,
    Operation,
    Value,
    block_row,
    block_text,
    called_functions,
    derivatives,
)
from ..network import CSLC, ExpressionFunctions, JointTerm


class FrictionCode(NamedTuple):
    """A function in C for the friction of each joint, at an instant.

    `static void law_J(double q, double qd, double slope, double* values, double* by_q, double*
    by_qd, double* by_slope)` has for joint J what its coefficients are multiplied by, with the
    derivatives of these by position, velocity and the slope of static friction.

    **Attributes**

    - `functions`: their text.
    - `indices`: for each joint the coefficients, in the order of values.
    - `slopes`: the joints whose friction has a slope.
    """

    functions: str
    indices: tuple[tuple[int, ...], ...]
    slopes: tuple[int, ...]


def friction_code(network: CSLC) -> FrictionCode:
    """The functions of a network's joints; slopes of static friction are arguments."""
    texts: list[str] = []
    indices: list[tuple[int, ...]] = []
    for joint in range(network.joint_count):
        motion = Motion(1)
        slope = motion.graph.input("slope")
        laws = list(_values(network, joint, motion, slope))
        indices.append(tuple(index for index, _ in laws))
        texts.append(_function(joint, motion, slope, [value for _, value in laws]))
    slopes = {
        joint
        for term in network.terms
        if isinstance(term, JointTerm) and term.law.slopes is not None
        for joint in term.joints
    }
    return FrictionCode("\n\n".join(texts), tuple(indices), tuple(sorted(slopes)))


def _values(network: CSLC, joint: int, motion: Motion, slope: Value) -> Iterator[tuple[int, Value]]:
    """Coefficients of a joint's friction, and what they are multiplied by."""
    functions = ExpressionFunctions(motion)
    for term in network.terms:
        if not isinstance(term, JointTerm) or joint not in term.joints:
            continue
        known = term.law.slopes is not None
        law = jax.tree.map(
            lambda x, known=known: slope if known else motion.graph.constant(float(x[joint])),
            term.law,
        )
        values = law.inputs(functions, motion.q[0], motion.qd[0])
        first = network.layout.indices(term.kind)[term.joints.index(joint) :: len(term.joints)]
        yield from zip(first.tolist(), motion.values(values), strict=True)


def _function(joint: int, motion: Motion, slope: Value, values: list[Value]) -> str:
    def reading(operation: Operation) -> str | None:
        return operation.text.replace("[0]", "") or None

    outputs = [(value, f"values[{i}] = {{0}};") for i, value in enumerate(values)]
    for name, by in (("q", motion.q[0]), ("qd", motion.qd[0]), ("slope", slope)):
        for i, value in enumerate(derivatives(values, by)):
            outputs.append((value, f"by_{name}[{i}] = {{0}};"))
    lines = "\n".join(KernelText(motion.graph, reading).statements(outputs))
    return (
        f"static void law_{joint}(double q, double qd, double slope, double* restrict values,\n"
        "    double* restrict by_q, double* restrict by_qd, double* restrict by_slope)\n"
        f"{{\n{lines}\n}}"
    )


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

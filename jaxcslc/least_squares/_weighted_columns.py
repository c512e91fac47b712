"""Expressions of each joint's weighted columns and torque, for generated kernels."""

from typing import NamedTuple

from ..codegen import Motion, Value
from ..network import CSLC


class WeightedColumn(NamedTuple):
    """A column of one joint's weighted rows, or its weighted torque, as an expression.

    - `row`: its number among the columns of all joints, torques included.
    - `coefficient`: its coefficient; for torques, the number of coefficients and that of the joint.
    """

    row: int
    coefficient: int
    value: Value


def weighted_columns(network: CSLC) -> tuple[Motion, list[WeightedColumn]]:
    """Return the expressions that a kernel computes: each joint's columns, then its torque.

    Inputs beside those of the motion are `torque[j]` and `weight[j]`. A column that is always zero
    is one, too, where the network's support has it.

    **Returns** the motion of the expressions, and the columns in the order of their rows.
    """
    motion = Motion(network.motion_count)
    graph = motion.graph
    entries: dict[tuple[int, int], Value] = {}
    for joint, index, value in network.column_entries(motion):
        key = joint, index
        entries[key] = entries[key] + value if key in entries else value
    columns: list[WeightedColumn] = []
    for joint, support in enumerate(network.support):
        weight, zero = graph.input(f"weight[{joint}]"), graph.constant(0.0)
        values = [(index, entries.get((joint, index), zero)) for index in support]
        values.append((network.size + joint, graph.input(f"torque[{joint}]")))
        for coefficient, value in values:
            columns.append(WeightedColumn(len(columns), coefficient, value * weight))
    return motion, columns

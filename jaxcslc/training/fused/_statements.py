from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ...adaptive import AdaptiveNetwork, Signals
from ...network.straight_line import (
    Expressions,
    KernelText,
    Operation,
    Value,
    array_outputs,
    traced,
)
from .._rules import AbstractRule


# What is computed once for all trainings, of a pattern alone; moduli and signs come at no cost.
_ONCE = ("add", "subtract", "multiply", "sign")
_FREE = ("fabs", "negate")
# More statements than these compile for minutes.
_MOST = 20_000


@dataclass(frozen=True, eq=False)
class RuleStatements:
    """What one pattern adds to the change of one training's weights, as straight-line code.

    **Attributes**

    - `graph`: of the expressions.
    - `sums`: those that are summed over patterns.
    - `entries`: where they are in the change, (groups, weights) flattened; others are zero.
    - `rows`: what is read of a pattern, computed once for all trainings.
    - `weights`: which weights are read.
    - `shape`: of the change.
    """

    graph: Expressions
    sums: tuple[Value, ...]
    entries: tuple[int, ...]
    rows: tuple[Value, ...]
    weights: tuple[int, ...]
    shape: tuple[int, int]

    def text(
        self, row: str, weight: str, total: str, functions: Mapping[str, str] | None = None
    ) -> list[str]:
        """Statements that add a pattern's part to the sums of a training.

        - `row`, `weight`, `total`: what number {0} of each is called.
        - `functions`: as of `KernelText`.
        """
        index_of = {value.index: i for i, value in enumerate(self.rows)}
        indices = {operation: i for i, operation in enumerate(self.graph.operations)}

        def reading(operation: Operation) -> str | None:
            if operation.text.startswith("weight"):
                return weight.format(int(operation.text.split()[1]))
            at = index_of.get(indices[operation])
            return None if at is None else row.format(at)

        kernel_text = KernelText(self.graph, reading, functions)
        stores = [
            (value, f"{total.format(i)} {'-' if minus else '+'}= {{0}};")
            for i, minus, value in _in_order(self.graph, kernel_text, self.sums)
        ]
        return kernel_text.statements_in_turn(stores)

    @property
    def operations(self) -> int:
        """Sums, products and other functions of a pattern and a training."""
        rows = {value.index for value in self.rows}
        text = KernelText(self.graph, lambda _: None)
        computed = text.needed(self.sums, rows)
        free = ("input", "constant", *_FREE)
        return sum(self.graph.operations[i].name not in free for i in computed) + len(self.sums)

    def patterns(
        self,
        signals: Signals,
        targets: Float[Array, "outputs patterns"],
        counts: Float[Array, "outputs patterns"],
    ) -> list[Array]:
        """The rows of all patterns, (patterns,) each."""
        inputs: dict[str, Any] = {}
        for number, array in enumerate(jax.tree.leaves((signals, targets, counts))):
            inputs |= {f"{_name(number)} {i}": row for i, row in enumerate(array)}
        return array_outputs(self.graph, self.rows, inputs)


def rule_statements(
    network: AdaptiveNetwork, rule: AbstractRule, learning: tuple[bool, ...]
) -> RuleStatements | None:
    """Those of a rule's `change`; None where it cannot be written so, or is too long.

    Traced from the rule itself, whatever it is, if it has no numbers of its own.
    """
    if jax.tree.leaves(rule) or not network.single_adaptive_layer:
        return None
    links = sum(layer.links.count for _, layer in network.adaptive_layers)
    if 8 * links > _MOST:
        return None
    bare = AdaptiveNetwork(
        network.subnetworks, _no_preprocessing, network.activation, network.names
    )
    return _rule_statements(bare, rule, learning)


def _no_preprocessing(patterns: Any) -> Signals:
    raise NotImplementedError


@lru_cache(maxsize=16)
def _rule_statements(
    network: AdaptiveNetwork, rule: AbstractRule, learning: tuple[bool, ...]
) -> RuleStatements | None:
    graph = Expressions()
    parts, outputs_count = network.subnetworks, network.outputs_count
    sizes = [part.layers[0].inputs for part in parts]
    sizes += [layer.contexts for part in parts for layer in part.contexts]
    arrays = [
        np.array([graph.input(f"{_name(i)} {j}") for j in range(size)], object).reshape(size, 1)
        for i, size in enumerate([*sizes, outputs_count, outputs_count])
    ]
    weights = np.array([graph.input(f"weight {i}") for i in range(network.size)], object)

    def change(weights: Array, *arrays: Array) -> Array:
        *of_signals, targets, counts = arrays
        contexts = iter(of_signals[len(parts) :])
        signals = Signals(
            tuple(of_signals[: len(parts)]),
            tuple(tuple(next(contexts) for _ in part.contexts) for part in parts),
        )
        return rule.change(network, weights, signals, targets, counts, learning)

    outputs = traced(graph, change, [weights, *arrays])
    if outputs is None:
        return None
    values = list(outputs[0].ravel())
    entries = tuple(i for i, value in enumerate(values) if not value.is_zero)
    sums = tuple(values[i] for i in entries)
    used = graph.needed(sums)
    if len(used) > _MOST:
        return None
    rows, read = _rows(graph, sums)
    return RuleStatements(graph, sums, entries, rows, read, outputs[0].shape)


def _rows(graph: Expressions, sums: Sequence[Value]) -> tuple[tuple[Value, ...], tuple[int, ...]]:
    """What patterns alone decide, where it meets weights; and the weights."""
    operations = graph.operations
    alone: dict[int, bool] = {}  # whether an operation is of the pattern alone, constants included
    for index in graph.needed(sums):
        name, arguments = operations[index].name, operations[index].arguments
        if name == "input":
            alone[index] = not operations[index].text.startswith("weight")
        else:
            computed = name in (*_ONCE, *_FREE, "constant")
            alone[index] = computed and all(alone[i] for i in arguments)

    def reading(operation: Operation) -> str | None:
        index = indices[operation]
        is_row = alone[index] and operation.name not in (*_FREE, "constant")
        return "row" if is_row or operation.name == "input" else None

    indices = {operation: i for i, operation in enumerate(operations)}
    needed = KernelText(graph, reading).needed(sums)
    read = [i for i in needed if reading(operations[i]) is not None]
    rows = tuple(Value(graph, i) for i in read if alone[i])
    return rows, tuple(int(operations[i].text.split()[1]) for i in read if not alone[i])


def _in_order(
    graph: Expressions, text: KernelText, sums: Sequence[Value]
) -> list[tuple[int, bool, Value]]:
    """Terms of sums, in which sum each and whether it is subtracted: next is always the one that
    needs least to be computed.

    So few values are alive at a time: of the nodes that lead to one output, and then those that
    lead to the next. In the order of layers all nodes of a network would be, far more than a GPU's
    thread has registers.
    """
    uses = Counter(i for index in graph.needed(sums) for i in graph.operations[index].arguments)
    uses.update(value.index for value in sums)
    terms: list[tuple[int, bool, Value]] = []
    for number, value in enumerate(sums):
        todo = [(False, value.index)]
        while todo:
            minus, index = todo.pop()
            name, arguments = graph.operations[index].name, graph.operations[index].arguments
            if uses[index] == 1 and name in ("add", "subtract"):
                todo += [(minus, arguments[0]), (minus != (name == "subtract"), arguments[1])]
            elif uses[index] == 1 and name == "negate":
                todo.append((not minus, arguments[0]))
            else:
                terms.append((number, minus, Value(graph, index)))
    # Sets of operations as the bits of numbers.
    below = [sum(1 << i for i in text.needed([value])) for _, _, value in terms]
    computed, ordered = 0, list[tuple[int, bool, Value]]()
    remaining = list(range(len(terms)))
    while remaining:
        best = min(remaining, key=lambda i: (below[i] & ~computed).bit_count())
        remaining.remove(best)
        computed |= below[best]
        ordered.append(terms[best])
    return ordered


def _name(number: int) -> str:
    """Of an array of patterns, by its place among the leaves of signals, targets and counts."""
    return f"pattern{number}"

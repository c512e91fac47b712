import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from ...adaptive import AdaptiveNetwork, Signals
from ...codegen import (
    Expressions,
    KernelText,
    Operation,
    Value,
    traced,
)
from .._rules import AbstractRule
from ._collected import Collected
from ._stages import Stage, stages_of


# What is computed once for all trainings, of a pattern alone; moduli and signs come at no cost.
_ONCE = ("add", "subtract", "multiply", "sign", "inverse")
_FREE = ("fabs", "negate")
# More statements than these compile for minutes.
_MOST = 20_000


@dataclass(frozen=True, eq=False)
class RuleStatements:
    """What one pattern adds to the change of one training's weights, as straight-line code.

    **Attributes**

    - `graph`: of the expressions.
    - `sums`: those that are summed over patterns.
    - `factors`: what weights alone decide, times each of these sums.
    - `entries`: where they are in the change, (groups, weights) flattened; others are zero.
    - `rows`: what is read of a pattern, computed once for all trainings.
    - `shape`: of the change.
    - `stages`: in which a thread adds up the sums.
    - `inputs`: names of the numbers of a pattern, in the order of its arrays.
    """

    graph: Expressions
    sums: tuple[Value, ...]
    factors: tuple[Value, ...]
    entries: tuple[int, ...]
    rows: tuple[Value, ...]
    shape: tuple[int, int]
    stages: tuple[Stage, ...]
    inputs: tuple[str, ...]

    def text(
        self,
        row: str,
        weight: str,
        total: str,
        stage: Stage,
        functions: Mapping[str, str] | None = None,
        handed: str = "handed[{0}]",
    ) -> list[str]:
        """Statements that add a pattern's part to the sums of a training.

        - `row`, `weight`, `total`: what number {0} of each is called.
        - `stage`: which sums.
        - `functions`: as of `KernelText`.
        - `handed`: what a value is called that stages hand over.
        """
        known = {value.index: handed.format(i) for i, value in stage.handed_in}
        kernel_text = self._kernel_text(row, weight, functions, known)
        kept = [(value, f"{handed.format(i)} = {{0}};") for i, value in stage.handed_on]
        stores = [
            (value, f"{total.format(number)} {'-' if minus else '+'}= {{0}};")
            for number, minus, value in stage.terms
        ]
        return kernel_text.statements_in_turn([*kept, *stores])

    def factor_text(
        self, weight: str, store: str, functions: Mapping[str, str] | None = None
    ) -> list[str]:
        """Statements for a training, once all patterns are summed.

        - `store`: of number {0} of the sums, with the factor {1}.
        """
        stores = [(value, store.format(i, "{0}")) for i, value in enumerate(self.factors)]
        return self._kernel_text("", weight, functions, {}).statements_in_turn(stores)

    def row_text(self, number: str, store: str) -> list[str]:
        """Statements that compute the rows of a pattern.

        - `number`: what number {0} of the pattern is called.
        - `store`: of number {0} of the rows, with its value {1}.
        """
        index_of = {name: i for i, name in enumerate(self.inputs)}

        def reading(operation: Operation) -> str | None:
            index = index_of.get(operation.text)
            return None if index is None else number.format(index)

        stores = [(value, store.format(i, "{0}")) for i, value in enumerate(self.rows)]
        return KernelText(self.graph, reading).statements(stores)

    def _kernel_text(
        self,
        row: str,
        weight: str,
        functions: Mapping[str, str] | None,
        known: Mapping[int, str],
    ) -> KernelText:
        names = {value.index: row.format(i) for i, value in enumerate(self.rows)} | dict(known)
        indices = {operation: i for i, operation in enumerate(self.graph.operations)}

        def reading(operation: Operation) -> str | None:
            if operation.text.startswith("weight"):
                return weight.format(int(operation.text.split()[1]))
            return names.get(indices[operation])

        return KernelText(self.graph, reading, functions)

    @property
    def operations(self) -> int:
        """Sums, products and other functions of a pattern and a training."""
        rows = {value.index for value in self.rows}
        text = KernelText(self.graph, lambda _: None)
        computed = text.needed(self.sums, rows)
        free = ("input", "constant", *_FREE)
        return sum(self.graph.operations[i].name not in free for i in computed) + len(self.sums)


def rule_statements(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    learning: tuple[bool, ...],
    *,
    by_subnetwork: bool = False,
) -> RuleStatements | None:
    """Those of a rule's `change`; None where it cannot be written so, or is too long.

    Traced from the rule itself, whatever it is, if it has no numbers of its own.

    - `by_subnetwork`: whether `counts` are of each subnetwork; its inputs are then as many more.
    """
    if jax.tree.leaves(rule) or not network.single_adaptive_layer:
        return None
    links = sum(layer.links.count for _, layer in network.adaptive_layers)
    if 8 * links > _MOST:
        return None
    bare = AdaptiveNetwork(
        network.subnetworks, _no_preprocessing, network.activation, network.names
    )
    return _rule_statements(bare, rule, learning, by_subnetwork)


def _no_preprocessing(patterns: Any) -> Signals:
    raise NotImplementedError


@lru_cache(maxsize=16)
def _rule_statements(
    network: AdaptiveNetwork, rule: AbstractRule, learning: tuple[bool, ...], by_subnetwork: bool
) -> RuleStatements | None:
    graph = Expressions()
    parts, outputs_count = network.subnetworks, network.outputs_count
    sizes = [part.layers[0].inputs for part in parts]
    sizes += [layer.contexts for part in parts for layer in part.contexts]
    masks = len(parts) if by_subnetwork else 1
    names = [
        [f"{_name(i)} {j}" for j in range(size)]
        for i, size in enumerate([*sizes, outputs_count, masks * outputs_count])
    ]
    inputs = tuple(name for of_array in names for name in of_array)
    shapes = [(-1, 1)] * (len(names) - 1)
    shapes += [(len(parts), outputs_count, 1)] if by_subnetwork else [(-1, 1)]
    arrays = [
        np.array([graph.input(name) for name in of_array], object).reshape(shape)
        for of_array, shape in zip(names, shapes, strict=True)
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
    collected = Collected(graph)
    forms = [collected.factors(values[i]) for i in entries]
    sums = tuple(collected.value(form) for form, _ in forms)
    factors = tuple(collected.product_value(product) for _, product in forms)
    if len(collected.graph.needed(sums)) > _MOST:
        return None
    rows = _rows(collected.graph, (*sums, *factors))
    shape = outputs[0].shape
    operations = collected.graph.operations
    prefix = f"{_name(len(sizes))} "
    targets = {i for i, operation in enumerate(operations) if operation.text.startswith(prefix)}
    stages = stages_of(collected.graph, sums, {value.index for value in rows}, targets)
    statements = RuleStatements(
        collected.graph, sums, factors, entries, rows, shape, stages, inputs
    )
    return replace(statements, rows=_in_use(statements))


def _in_use(statements: RuleStatements) -> tuple[Value, ...]:
    """The rows as statements read them one after the other: a kernel reads two at a time."""
    texts = (statements.text("row[{0}]", "weight", "sum", stage) for stage in statements.stages)
    numbers = (int(i) for lines in texts for i in re.findall(r"\brow\[(\d+)\]", " ".join(lines)))
    return tuple(statements.rows[i] for i in dict.fromkeys(numbers))


def _rows(graph: Expressions, sums: Sequence[Value]) -> tuple[Value, ...]:
    """What patterns alone decide, where it meets weights."""
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
    return tuple(Value(graph, i) for i in read if alone[i])


def _name(number: int) -> str:
    """Of an array of patterns, by its place among the leaves of signals, targets and counts."""
    return f"pattern{number}"

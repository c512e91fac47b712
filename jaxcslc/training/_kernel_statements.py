"""Straight-line code of a learning rule, traced from the rule itself, for `_kernel`.

What patterns alone decide is collected and computed once for all trainings. Sums are divided into
stages that the registers of a GPU's thread can hold.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from ..codegen import Expressions, KernelText, Operation, Value, traced
from ._network import AdaptiveNetwork, Signals
from ._rules import AbstractRule


# Weights and sums that a thread's registers hold beside the values of nodes: with all 43 and 62 of
# a PUMA 560's PERAL, a quarter of what the kernel did was to store values and to read them again.
_MOST_KEPT = 56
# Operations that a value handed over must save: storing and reading it costs about eight.
_LEAST_SAVING = 16
_FREE = ("fabs", "negate")  # at no cost


class Term(NamedTuple):
    """A part of one of the sums: its number, whether it is subtracted, and its value."""

    number: int
    minus: bool
    value: Value


@dataclass(frozen=True)
class KernelStage:
    """Sums that a thread accumulates over some patterns before it begins the next stage.

    **Attributes**

    - `terms`: in the order in which to compute them.
    - `handed_in`: values of earlier stages that it reads instead of computing them again.
    - `handed_on`: values that it stores for later stages, and under which numbers.
    """

    terms: tuple[Term, ...]
    handed_in: tuple[tuple[int, Value], ...] = ()
    handed_on: tuple[tuple[int, Value], ...] = ()

    @property
    def sums(self) -> tuple[int, ...]:
        """Numbers of the sums that the stage adds to."""
        return tuple(sorted({term.number for term in self.terms}))


def kernel_stages(
    graph: Expressions, sums: Sequence[Value], rows: Collection[int], targets: Collection[int]
) -> tuple[KernelStage, ...]:
    """Divide sums into stages of a thread.

    There is one stage where registers hold the sums and weights. Otherwise there is one for each
    output, or for some.

    What follows from the error of one output alone needs the weights and nodes that lead to that
    output only. What follows from several outputs' errors comes last, and reads of the others what
    would cost most to compute again.

    - `rows`: indices of the values that are read, and not computed.
    - `targets`: indices of the outputs' targets.
    """
    work = _Work(graph, rows)
    terms = _terms(graph, sums)
    if work.kept(terms) <= _MOST_KEPT:
        return (KernelStage(work.in_order(terms)),)
    parts: dict[frozenset[int], list[Term]] = {}
    for term in terms:
        needed = frozenset(targets).intersection(graph.needed([term.value]))
        parts.setdefault(needed, []).append(term)
    single = [part for key, part in sorted(parts.items(), key=lambda item: sorted(item[0]))
              if len(key) < 2]  # fmt: skip
    several = [term for key, part in parts.items() if len(key) > 1 for term in part]
    single = work.joined(single)
    if not several:
        return tuple(KernelStage(work.in_order(part)) for part in single)
    of_parts = [work.computed(term.value.index for term in part) for part in single]
    handed = work.handed(several, set().union(*of_parts))
    numbers = {index: number for number, index in enumerate(handed)}
    stages: list[KernelStage] = []
    for part, computed in zip(single, of_parts, strict=True):
        here = [i for i in numbers if i in computed]
        on = tuple((numbers[i], Value(graph, i)) for i in here if i in handed)
        handed = [i for i in handed if i not in here]
        stages.append(KernelStage(work.in_order(part), handed_on=on))
    read = tuple((number, Value(graph, i)) for i, number in numbers.items())
    known = {value.index for _, value in read}
    return (*stages, KernelStage(work.in_order(several, known), handed_in=read))


class _Work:
    """Operations that terms need, besides the rows that are read."""

    def __init__(self, graph: Expressions, rows: Collection[int]) -> None:
        self._graph, self._rows = graph, rows

    def computed(self, outputs: Iterable[int], known: Collection[int] = ()) -> set[int]:
        """Operations that compute values from rows, from what is known and from weights."""
        computed: set[int] = set()
        todo = list(outputs)
        while todo:
            index = todo.pop()
            if index in computed or index in known or index in self._rows:
                continue
            operation = self._graph.operations[index]
            if operation.name not in ("input", "constant"):
                computed.add(index)
                todo += operation.arguments
        return computed

    def cost(self, terms: Sequence[Term], known: Collection[int] = ()) -> int:
        computed = self.computed((term.value.index for term in terms), known)
        return sum(self._graph.operations[i].name not in _FREE for i in computed)

    def kept(self, terms: Sequence[Term]) -> int:
        """Return the number of weights and sums that the terms need."""
        computed = self.computed(term.value.index for term in terms)
        read = {i for index in computed for i in self._graph.operations[index].arguments}
        weights = sum(self._graph.operations[i].text.startswith("weight") for i in read)
        return weights + len({term.number for term in terms})

    def joined(self, parts: Sequence[list[Term]]) -> list[list[Term]]:
        """Parts together, where registers hold what both need; first those with most in common."""
        parts = list(parts)
        while True:
            pairs = [
                (self.cost(one) + self.cost(other) - self.cost([*one, *other]), i, j)
                for (i, one), (j, other) in combinations(enumerate(parts), 2)
                if self.kept([*one, *other]) <= _MOST_KEPT
            ]
            if not pairs:
                return parts
            _, i, j = max(pairs)
            parts[i] = [*parts[i], *parts[j]]
            del parts[j]

    def handed(self, terms: Sequence[Term], available: set[int]) -> list[int]:
        """Values that are available, which the terms would cost most to replace."""
        handed: list[int] = []
        while True:
            computed = self.computed((term.value.index for term in terms), handed)
            read = {i for index in computed for i in self._graph.operations[index].arguments}
            read |= {term.value.index for term in terms}
            candidates = read & available & computed
            if not candidates:
                return handed
            remaining, best = min((self.cost(terms, [*handed, i]), i) for i in candidates)
            if self.cost(terms, handed) - remaining < _LEAST_SAVING:
                return handed
            handed.append(best)

    def in_order(self, terms: Sequence[Term], known: Collection[int] = ()) -> tuple[Term, ...]:
        """Order terms so that the next is always the one that needs least to be computed.

        So few values are alive at a time: of the nodes that lead to one output, and then those
        that lead to the next. In the order of layers all nodes of a network would be, far more
        than a GPU's thread has registers.
        """
        # Sets of operations as the bits of numbers.
        below = [sum(1 << i for i in self.computed([t.value.index], known)) for t in terms]
        computed, ordered = 0, list[Term]()
        remaining = list(range(len(terms)))
        while remaining:
            best = min(remaining, key=lambda i: (below[i] & ~computed).bit_count())
            remaining.remove(best)
            computed |= below[best]
            ordered.append(terms[best])
        return tuple(ordered)


def _terms(graph: Expressions, sums: Sequence[Value]) -> list[Term]:
    """Return the parts that are added up to the sums and used nowhere else."""
    uses = Counter(i for index in graph.needed(sums) for i in graph.operations[index].arguments)
    uses.update(value.index for value in sums)
    terms: list[Term] = []
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
                terms.append(Term(number, minus, Value(graph, index)))
    return terms


# Values that weights take part in, as factors of a product, by their indices in ascending order;
# none of what patterns alone decide.
Product = tuple[int, ...]
# A sum of products, each times what patterns alone decide.
Form = dict[Product, Value]


class Collected:
    """An expression's values again, with what patterns alone decide collected in front of what
    weights decide.

    `a * x * w + b * w` becomes `(a * x + b) * w`, where patterns decide the bracket and a kernel
    reads it: of the links from several inputs to a node that share a weight, one product is left.
    A modulus of a product becomes the product of moduli; a quotient that is zero where the divisor
    is zero, a product with an `inverse` that is; and a value times its own inverse, whether it
    is `nonzero`, so that a node that one weight alone leads to is divided by nothing.

    **Attributes**

    - `graph`: of the new values.
    """

    def __init__(self, source: Expressions) -> None:
        self._source, self.graph = source, Expressions()
        self._forms: dict[int, Form] = {}
        self._of_weights: dict[int, bool] = {}  # whether weights alone decide a factor

    def expanded(self, value: Value) -> Form:
        """A value of the source as a sum of products."""
        for index in self._source.needed([value]):
            if index not in self._forms:
                self._forms[index] = self._form(self._source.operations[index])
        return self._forms[value.index]

    def factors(self, value: Value) -> tuple[Form, Product]:
        """Return a value as a sum and the weights' common factor of all its products.

        Only a product has such a factor.
        """
        operation = value.operation
        if operation.name == "negate":
            form, common = self.factors(value.signed()[1])
            return _negative(form), common
        if operation.name == "multiply":
            forms = [self.expanded(Value(self._source, i)) for i in operation.arguments]
            for one, other in (forms, forms[::-1]):
                if len(one) == 1 and self._by_weights(next(iter(one))):
                    ((product, coefficient),) = one.items()
                    parts = [self._product(key, product) for key in other]
                    common = tuple(i for i in product if all(i in part for part in parts))
                    remaining = [tuple(i for i in part if i not in common) for part in parts]
                    if not any(self._by_weights((i,)) for part in remaining for i in part):
                        coefficients = [coefficient * x for x in other.values()]
                        return _added(zip(remaining, coefficients, strict=True)), common
        return self.expanded(value), ()

    def value(self, form: Form) -> Value:
        """A value that is the sum."""
        graph = self.graph
        if not form:
            return graph.constant(0.0)
        minus = _minus(form)
        total = graph.constant(0.0)
        for product, coefficient in sorted(form.items()):
            total += (-coefficient if minus else coefficient) * self.product_value(product)
        turned, size = total.signed()
        if not self._is_pattern(form):
            self._of_weights.setdefault(size.index, self._sum_by_weights(form))
        return -size if minus != turned else size

    def product_value(self, product: Product) -> Value:
        value = self.graph.constant(1.0)
        for index in product:
            value *= Value(self.graph, index)
        return value

    def _form(self, operation: Operation) -> Form:
        graph = self.graph
        arguments = [self._forms[i] for i in operation.arguments]
        match operation.name:
            case "input":
                value = graph.input(operation.text)
                if not operation.text.startswith("weight"):
                    return {(): value}
                self._of_weights[value.index] = True
                return {(value.index,): graph.constant(1.0)}
            case "constant":
                return _added([((), graph.constant(operation.number))])
            case "add":
                return _added(pair for form in arguments for pair in form.items())
            case "subtract":
                return _added([*arguments[0].items(), *_negative(arguments[1]).items()])
            case "negate":
                return _negative(arguments[0])
            case "multiply":
                return self._times(*arguments)
            case "fabs":
                return self._modulus(arguments[0])
            case "choose" if (quotient := self._quotient(operation)) is not None:
                return quotient
            case name:
                values = [self.value(form) for form in arguments]
                return self._applied(name, *values)

    def _times(self, x: Form, y: Form) -> Form:
        if len(x) > 1:
            x, y = y, x
        if len(x) > 1:
            x = self._single(x)
        if not x or not y:
            return {}
        ((product, coefficient),) = x.items()
        if len(y) > 1 and (product or coefficient.signed()[1].number is None):
            y = self._single(y)
        return _added((self._product(product, key), coefficient * c) for key, c in y.items())

    def _single(self, form: Form) -> Form:
        """A sum as one factor."""
        if len(form) < 2:
            return form
        minus, value = self.value(form).signed()
        one = self.graph.constant(1.0)
        return {(value.index,): -one if minus else one}

    def _modulus(self, form: Form) -> Form:
        graph = self.graph
        return _added(
            (
                tuple(sorted(self._function("fabs", i) for i in product)),
                _pattern_modulus(graph, coefficient),
            )
            for product, coefficient in self._single(form).items()
        )

    def _inverse(self, form: Form) -> Form:
        single = self._single(form)
        return {
            tuple(sorted(self._function("inverse", i) for i in product)): _inverse(
                self.graph, coefficient
            )
            for product, coefficient in single.items()
        }

    def _function(self, name: str, factor: int) -> int:
        operation = self.graph.operations[factor]
        if name == "fabs" and operation.name in ("fabs", "nonzero"):
            return factor
        value = self.graph.apply(name, Value(self.graph, factor))
        self._of_weights[value.index] = self._of_weights[factor]
        return value.index

    def _product(self, x: Product, y: Product) -> Product:
        """Return the product of both; a value times its inverse becomes `nonzero` of it."""
        factors = sorted((*x, *y))
        while True:
            pair = next(
                (
                    (i, j, name)
                    for i in factors
                    for name, inverse in (("nonzero", "inverse"), ("", "nonzero"))
                    for j in factors
                    if self.graph.operations[j] == Operation(inverse, (i,))
                ),
                None,
            )
            if pair is None:
                return tuple(factors)
            i, j, name = pair
            factors.remove(j)
            if name:
                factors.remove(i)
                factors = sorted((*factors, self._function(name, i)))

    def _quotient(self, operation: Operation) -> Form | None:
        """Return the form of `x == 0 ? 0 : y * reciprocal(x == 0 ? 1 : x)`; else None."""
        operations = self._source.operations
        condition, otherwise, then = (operations[i] for i in operation.arguments)
        if condition.name != "equal" or then != Operation("constant"):
            return None
        divisor = [i for i in condition.arguments if operations[i] != Operation("constant")]
        if len(divisor) != 1 or otherwise.name != "multiply":
            return None
        for i, j in (otherwise.arguments, otherwise.arguments[::-1]):
            if operations[j].name != "reciprocal":
                continue
            denominator = operations[operations[j].arguments[0]]
            if denominator.name != "choose" or denominator.arguments[:2] != (
                operation.arguments[0],
                divisor[0],
            ):
                continue
            if operations[denominator.arguments[2]] == Operation("constant", number=1.0):
                inverse = self._inverse(self._forms[divisor[0]])
                return self._one_factor(self._times(self._forms[i], inverse))
        return None

    def _one_factor(self, form: Form) -> Form:
        """Combine, in each product, the factors that weights do not decide alone into one.

        That factor is computed once.
        """
        one: Form = {}
        for product, coefficient in form.items():
            mixed = tuple(i for i in product if self._is_mixed(i))
            if len(mixed) > 1:
                value = self.product_value(mixed)
                self._of_weights.setdefault(value.index, False)
                kept = [i for i in product if i not in mixed]
                one[tuple(sorted((*kept, value.index)))] = coefficient
            else:
                one[product] = coefficient
        return one

    def _is_mixed(self, factor: int) -> bool:
        nonzero = self.graph.operations[factor].name == "nonzero"
        return not nonzero and not self._of_weights[factor]

    def _applied(self, name: str, *values: Value) -> Form:
        graph = self.graph
        makers = {"equal": graph.equal, "choose": graph.choice}
        make = makers.get(name, lambda x: graph.apply(name, x))
        value = make(*values)
        known = [self._of_weights[v.index] for v in values if v.index in self._of_weights]
        if not known:
            return {(): value}
        numbers = (v.number is not None or v.index in self._of_weights for v in values)
        self._of_weights[value.index] = all(known) and all(numbers)
        return {(value.index,): self.graph.constant(1.0)}

    def _by_weights(self, product: Product) -> bool:
        return bool(product) and all(self._of_weights[i] for i in product)

    def _sum_by_weights(self, form: Form) -> bool:
        return all(
            self._by_weights(product) and x.signed()[1].number is not None
            for product, x in form.items()
        )

    @staticmethod
    def _is_pattern(form: Form) -> bool:
        return all(not product for product in form)


def _added(pairs: Iterable[tuple[Product, Value]]) -> Form:
    form: Form = {}
    for product, coefficient in pairs:
        total = form[product] + coefficient if product in form else coefficient
        form[product] = total
    return {product: x for product, x in form.items() if not x.is_zero}


def _negative(form: Form) -> Form:
    return {product: -x for product, x in form.items()}


def _minus(form: Form) -> bool:
    """Return whether the first coefficient has a minus.

    Of a sum and its negative, only one is then computed.
    """
    return min(form.items(), key=lambda item: item[0])[1].signed()[0]


def _pattern_modulus(graph: Expressions, x: Value) -> Value:
    size = x.signed()[1]
    return (
        size
        if size.number is not None or size.operation.name == "fabs"
        else graph.apply("fabs", size)
    )


def _inverse(graph: Expressions, x: Value) -> Value:
    minus, size = x.signed()
    if size.number is not None:
        inverse = graph.constant(1.0 / size.number if size.number else 0.0)
    else:
        inverse = graph.apply("inverse", size)
    return -inverse if minus else inverse


# What is computed once for all trainings, of a pattern alone.
_ONCE = ("add", "subtract", "multiply", "sign", "inverse")
# More statements than these compile for minutes.
MOST_STATEMENTS = 20_000


@dataclass(frozen=True, eq=False)
class RuleStatements:
    """Straight-line code of one pattern's share in the change of one training's weights.

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
    stages: tuple[KernelStage, ...]
    inputs: tuple[str, ...]

    def text(
        self,
        row: str,
        weight: str,
        total: str,
        stage: KernelStage,
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


def rule_statements(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    learning: tuple[bool, ...],
    *,
    by_subnetwork: bool = False,
) -> RuleStatements | None:
    """Return the statements of a rule's `change`.

    They are None where the rule cannot be written so, or is too long.

    Traced from the rule itself, whatever it is, if it has no numbers of its own.

    - `by_subnetwork`: whether `counts` are of each subnetwork; its inputs are then as many more.
    """
    if jax.tree.leaves(rule) or not network.single_adaptive_layer:
        return None
    links = sum(layer.links.count for _, layer in network.adaptive_layers)
    if 8 * links > MOST_STATEMENTS:
        return None
    bare = AdaptiveNetwork(
        network.subnetworks, _no_preprocessing, network.activation, network.names
    )
    try:
        return _rule_statements(bare, rule, learning, by_subnetwork)
    except _PreprocessingError:
        return None


class _PreprocessingError(Exception):
    """A rule that needs the network's preprocessing, which statements do not have."""


def _no_preprocessing(patterns: Any) -> Signals:
    raise _PreprocessingError


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
    if len(collected.graph.needed(sums)) > MOST_STATEMENTS:
        return None
    rows = _rows(collected.graph, (*sums, *factors))
    shape = outputs[0].shape
    operations = collected.graph.operations
    prefix = f"{_name(len(sizes))} "
    targets = {i for i, operation in enumerate(operations) if operation.text.startswith(prefix)}
    stages = kernel_stages(collected.graph, sums, {value.index for value in rows}, targets)
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
    """Return the values that patterns alone decide, where they meet weights."""
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
    """Name an array of patterns by its place among the leaves of signals, targets and counts."""
    return f"pattern{number}"

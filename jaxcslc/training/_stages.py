"""Division of a rule's sums into stages that the registers of a GPU's thread can hold."""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from ..codegen import Expressions, Value


# Weights and sums that a thread's registers hold beside the values of nodes: with all 43 and 62 of
# a PUMA 560's PERAL, a quarter of what the kernel did was to store values and to read them again.
_MOST_KEPT = 56
# Operations that a value handed over must save: storing and reading it costs about eight.
_LEAST_SAVING = 16
_FREE = ("fabs", "negate")


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
    - `handed_in`: values of earlier stages that it reads in place of computing them again.
    - `handed_on`: values that it stores for later stages, and under which numbers.
    """

    terms: tuple[Term, ...]
    handed_in: tuple[tuple[int, Value], ...] = ()
    handed_on: tuple[tuple[int, Value], ...] = ()

    @property
    def sums(self) -> tuple[int, ...]:
        """Numbers of the sums that the stage adds to."""
        return tuple(sorted({term.number for term in self.terms}))


def stages_of(
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
        """Values that are available, in place of which the terms would cost most."""
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

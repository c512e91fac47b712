"""Independent angles of sines and cosines, with arguments as integer sums of them."""

from collections.abc import Iterable
from math import gcd, lcm
from typing import Any


Terms = dict[Any, Any]  # what is added in the argument of a function: monic term to its rational


class Angles:
    """The independent angles of sines and cosines, and every argument as an integer sum of them.

    Arguments of few terms first and, among those, the most frequent; of arguments that are
    multiples of one another, what divides them all.
    """

    def __init__(self, largest_multiple: int) -> None:
        self._largest = largest_multiple
        self._counts: dict[frozenset[tuple[Any, Any]], dict[Any, int]] = {}
        self._basis: list[Terms] = []
        # Arguments that are large multiples, or fractions of sums, of angles of the basis.
        self._apart: list[Terms] = []

    def add(self, terms: Terms) -> None:
        """Counts an argument."""
        if terms:
            first = terms[min(terms, key=str)]
            direction = frozenset((name, factor / first) for name, factor in terms.items())
            counts = self._counts.setdefault(direction, {})
            counts[first] = counts.get(first, 0) + 1

    def settle(self) -> None:
        """Chooses the angles."""
        candidates: list[tuple[int, int, str, Terms]] = []
        for direction, counts in self._counts.items():
            smallest = _common_divisor(counts)
            near = max(abs(factor / smallest) for factor in counts) <= self._largest
            for factor in (smallest,) if near else sorted(counts, key=abs):
                terms = {name: part * factor for name, part in direction}
                label = str(sorted(map(str, terms)))
                candidates.append((len(terms), -sum(counts.values()), label, terms))
        for *_, terms in sorted(candidates, key=lambda candidate: candidate[:3]):
            if self._integers(terms) is None:
                (self._basis if self._independent(terms) else self._apart).append(terms)

    def multiples(self, terms: Terms) -> Iterable[tuple[Any, int]]:
        """Angles with the multiple of each."""
        if not terms:
            return
        integers = self._integers(terms)
        assert integers is not None, terms
        for angle, multiple in zip((*self._basis, *self._apart), integers, strict=True):
            if multiple:
                yield sum(factor * term for term, factor in angle.items()), multiple

    def _integers(self, terms: Terms) -> list[int] | None:
        """An argument as an integer sum of the angles; none if it is no such sum."""
        everything = [*self._basis, *self._apart]
        for index, angle in enumerate(everything):
            for multiple in range(1, self._largest + 1):
                for sign in (multiple, -multiple):
                    if terms == {name: sign * factor for name, factor in angle.items()}:
                        return [sign if i == index else 0 for i in range(len(everything))]
        joined, pivots = self._echelon(terms)
        if joined is None or len(self._basis) in pivots:
            return None
        solution = [joined[row, len(self._basis)] for row in range(len(self._basis))]
        whole = all(x.is_Integer and abs(x) <= self._largest for x in solution)
        return [int(x) for x in solution] + [0] * len(self._apart) if whole else None

    def _independent(self, terms: Terms) -> bool:
        return not self._basis or len(self._basis) in self._echelon(terms)[1]

    def _echelon(self, terms: Terms) -> tuple[Any, tuple[int, ...]]:
        """Return the reduced echelon form of basis columns, with an argument as the last column."""
        from sympy import Matrix, Rational

        if not self._basis:
            return None, ()
        columns = (*self._basis, terms)
        names = list(dict.fromkeys(name for part in columns for name in part))
        return Matrix([[part.get(n, Rational(0)) for part in columns] for n in names]).rref()


def _common_divisor(factors: Iterable[Any]) -> Any:
    """The largest rational that all rationals are integer multiples of."""
    from sympy import Rational

    numerator, denominator = 0, 1
    for factor in factors:
        numerator, denominator = gcd(numerator, int(factor.p)), lcm(denominator, int(factor.q))
    return Rational(numerator, denominator)

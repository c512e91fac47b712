from collections.abc import Callable, Iterable
from math import gcd, lcm
from typing import Any

from flint import fmpq, fmpq_mat

from ._lagrange import Form


_LARGEST_DENOMINATOR = 1000
Direction = tuple[tuple[Any, Any], ...]


def direction(form: Form) -> tuple[Direction, Any]:
    """A form up to a multiple, as a hashable key, and the multiple that the form is of it."""
    items = sorted(form.items())
    scale = items[0][1]
    return tuple((key, value / scale) for key, value in items), scale


class Basis:
    """The minimum set of forms of which every form is a rational combination (stage C.1.4).

    Forms that differ by a multiple are one. Of those that remain, the simplest that are
    linearly independent are kept, fewest terms first; the others are rational combinations of
    them. Multiples are made integers without a common divisor, and the first is positive.

    - `forms`: to be written in the basis.
    - `label`: what sorts forms of as many terms.
    - `known`: whether a key of the forms is of a number (C.1.2); none is by default. Combinations
      of the forms that contain no other keys are kept first, so that as much of the basis as
      possible is known.
    """

    def __init__(
        self,
        forms: Iterable[Form],
        label: Callable[[Form], str],
        known: Callable[[Any], bool] = lambda key: False,
    ) -> None:
        multiples: dict[Direction, list[Any]] = {}
        for form in forms:
            key, multiple = direction(form)
            multiples.setdefault(key, []).append(multiple)
        for form in _known_combinations([dict(key) for key in multiples], known):
            multiples.setdefault(direction(form)[0], [fmpq(1)])
        candidates: list[tuple[Direction, Any]] = [
            (key, _unit(factors)) for key, factors in multiples.items()
        ]
        candidates.sort(
            key=lambda item: (
                not all(known(key) for key, _ in item[0]),
                len(item[0]),
                label(_scaled(*item)),
            )
        )
        self.forms: list[Form] = []
        # Echelon rows: leading key -> (row, the same row as a combination of basis forms).
        self._rows: dict[Any, tuple[Form, dict[int, Any]]] = {}
        self._combinations: dict[Direction, dict[int, Any]] = {}
        for key, unit in candidates:
            form = _scaled(key, unit)
            remainder, used = self._reduce(form)
            if remainder:
                index = len(self.forms)
                self.forms.append(form)
                self._combinations[key] = {index: 1 / unit}
                combination = {i: -value for i, value in used.items()}
                combination[index] = fmpq(1)
                self._rows[min(remainder)] = remainder, combination
            else:
                self._combinations[key] = {i: value / unit for i, value in used.items()}

    def combination(self, form: Form) -> dict[int, Any]:
        """`form` as {index of basis form: rational}."""
        key, multiple = direction(form)
        return {index: multiple * value for index, value in self._combinations[key].items()}

    def _reduce(self, form: Form) -> tuple[Form, dict[int, Any]]:
        """What is left of `form` after the rows so far, and the combination taken off."""
        remainder, used = dict(form), {}
        for lead in list(self._rows):
            if lead in remainder:
                row, combination = self._rows[lead]
                factor = remainder[lead] / row[lead]
                for key, value in row.items():
                    total = remainder.get(key, 0) - factor * value
                    if total:
                        remainder[key] = total
                    else:
                        del remainder[key]
                for index, value in combination.items():
                    total = used.get(index, 0) + factor * value
                    used[index] = total
        return remainder, {index: value for index, value in used.items() if value}


def _known_combinations(forms: list[Form], known: Callable[[Any], bool]) -> list[Form]:
    """A basis of the combinations of forms that contain known keys alone, in echelon form."""
    keys = sorted({key for form in forms for key in form}, key=lambda key: (known(key), key))
    if not any(map(known, keys)):
        return []
    rows = [[form.get(key, fmpq(0)) for key in keys] for form in forms]
    echelon, rank = fmpq_mat(rows).rref()
    combinations = [
        {key: value for key, value in zip(keys, row, strict=True) if value}
        for row in echelon.tolist()[:rank]
    ]
    return [form for form in combinations if all(map(known, form))]


def _scaled(key: Direction, unit: Any) -> Form:
    return {name: value * unit for name, value in key}


def _unit(multiples: list[Any]) -> Any:
    """The largest rational that all multiples are integer multiples of, signed as the first."""
    numerator, denominator = 0, 1
    for multiple in multiples:
        numerator = gcd(numerator, int(fmpq(multiple).numerator))
        denominator = lcm(denominator, int(fmpq(multiple).denominator))
    # The gcd of fractions p/q in lowest terms is gcd(p) / lcm(q). Where twists are arbitrary,
    # multiples are cosines of them and have no common measure worth the name.
    if denominator > _LARGEST_DENOMINATOR:
        return fmpq(multiples[0])
    return fmpq(numerator if multiples[0] > 0 else -numerator, denominator)

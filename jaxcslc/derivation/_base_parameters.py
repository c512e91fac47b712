"""Minimal sets of coefficients: base parameters for numeric lengths, forms for symbolic ones.

`base_parameters` eliminates linear forms at random positions in exact arithmetic. `Basis` does
the same for the forms of the symbolic algebra (stage C.1.4).
"""

import dataclasses
import math
import random
from collections.abc import Callable, Collection, Iterable, Sequence
from math import gcd, lcm
from typing import Any

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat, fmpz_mod_ctx, fmpz_mod_mat

from ..manipulator import Manipulator
from ._chain import Chain, link_twists
from ._exact import exact_number
from ._inertial_terms import BODY, InertialTerm, gravity_factors, kinetic_factors
from ._lagrange import Form


# Parameters that are regrouped into others where that is possible, as the identification
# literature does (Gautier and Khalil 1990): mass, then the third first moment, then one moment.
_REGROUPED_LAST = {"Iyy": 1, "hz": 2, "m": 3}
_SEED = 1990
# A Mersenne prime for exact arithmetic and another to test its result under.
_PRIME, _CHECK = 2**521 - 1, 2**607 - 1
_BITS = 1024  # of ball arithmetic, where fractions are longer than the prime
_IDLE = 3  # positions that add nothing, after which the span is complete


Row = list[Any]


def base_parameters(
    robot: Manipulator, chain: Chain, terms: Sequence[InertialTerm]
) -> tuple[tuple[int, ...], list[dict[int, Any]]]:
    """The minimal set of parameter combinations that torque depends on, lengths being numbers.

    Every element of M and G is, at every position, a linear form in `terms`. The base
    parameters are a basis of the span of these forms, here its reduced row echelon form: each
    is one term plus a rational combination of terms that affect torque in no other way. That
    makes it canonical: it depends on the order of the terms alone.

    The span is built from the forms at random positions until three further ones add nothing,
    in arithmetic modulo a large prime: it is as exact as that of rationals and does not swell.
    (Rationals of arbitrary angles grow to thousands of digits in elimination: 8 s for a tree of
    7 joints where this takes a fraction of one.) The combinations are then read back as the
    simplest fractions of their residues and tested at one more position, under another
    prime. Where angles are arbitrary the fractions are longer than that; then they are computed
    as numbers, in ball arithmetic that bounds its own rounding, and rounded once.

    Positions are drawn from a fixed seed; a set that misses part of the span is a zero of a
    polynomial that does not vanish identically. Building it from the coefficients of the
    expanded tables gives the same echelon form (tested) but needs the tables, which have tens
    of thousands of monomials when twists are arbitrary.

    **Returns**

    - The terms of the basis, as indices into `terms`.
    - For each of them the combination that it stands for, as {index: rational}.
    """
    order = sorted(range(len(terms)), key=lambda index: _preference(terms[index], index))
    forms = _Forms(robot, chain, terms, order)
    rows, pivots, built_from = _echelon_form(forms, _PRIME)
    fractions = [
        {column: _fraction(int(x), _PRIME) for column, x in enumerate(row) if x != 0}
        for row in rows
    ]
    if not _span_forms(forms, pivots, fractions):
        fractions = _in_balls(forms, pivots, fractions, built_from)
    combinations = [
        {order[column]: fmpq(*fraction) for column, fraction in row.items()} for row in fractions
    ]
    basis = [order[column] for column in pivots]
    by_link = sorted(range(len(basis)), key=lambda i: (terms[basis[i]].link, order.index(basis[i])))
    return tuple(basis[i] for i in by_link), [combinations[i] for i in by_link]


@dataclasses.dataclass(frozen=True)
class _Forms:
    """Elements of M and G as linear forms in the terms, whose columns are in `order`."""

    robot: Manipulator
    chain: Chain
    terms: Sequence[InertialTerm]
    order: Sequence[int]

    def at_random_position(self, draw: random.Random, field: Callable[[int], Any]) -> list[Row]:
        """The forms' coefficients at one position, as numbers of a field."""
        return _forms_at_random_position(
            self.robot, self.chain, self.terms, self.order, draw, field
        )


def _echelon_form(forms: _Forms, prime: int) -> tuple[list[Row], list[int], list[Row]]:
    """The span's reduced row echelon form modulo a prime.

    **Returns** its rows, their pivot columns, and the forms at the positions that it was built
    from, one after the other.
    """
    draw, field = random.Random(_SEED), fmpz_mod_ctx(prime)
    weights = random.Random(_SEED + 2)
    rows: list[Row] = []
    seen: list[Row] = []
    built_from = 0
    idle = 0
    while idle < _IDLE:
        new = forms.at_random_position(draw, field)
        seen += new
        # A combination of all forms, with random weights, is outside the span if one of them is.
        combination = fmpz_mod_mat([[field(weights.randrange(prime)) for _ in new]], field)
        one = (combination * fmpz_mod_mat(new, field)).tolist()
        if fmpz_mod_mat([*rows, *one], field).rref()[1] == len(rows):
            idle += 1
            continue
        built_from = len(seen)
        matrix, rank = fmpz_mod_mat([*rows, *new], field).rref()
        rows = matrix.tolist()[:rank]  # behind them are rows of zeros
        idle = 0
    return rows, [_first_not_zero(row) for row in rows], seen[:built_from]


def _first_not_zero(row: Row) -> int:
    return next(column for column, x in enumerate(row) if x != 0)


def _span_forms(
    forms: _Forms, pivots: Sequence[int], fractions: Sequence[dict[int, tuple[int, int]]]
) -> bool:
    """Return whether the combinations span the forms at a new position, modulo another prime."""
    field = fmpz_mod_ctx(_CHECK)
    combinations = [
        {column: field(top) / field(bottom) for column, (top, bottom) in row.items()}
        for row in fractions
    ]
    for form in forms.at_random_position(random.Random(_SEED + 1), field):
        remainder = list(form)
        for pivot, combination in zip(pivots, combinations, strict=True):
            if form[pivot] != 0:
                for column, x in combination.items():
                    remainder[column] = remainder[column] - form[pivot] * x
        if any(x != 0 for x in remainder):
            return False
    return True


def _in_balls(
    forms: _Forms,
    pivots: Sequence[int],
    nonzero: Sequence[Collection[int]],
    built_from: Sequence[Row],
) -> list[dict[int, tuple[int, int]]]:
    """The combinations as numbers: for each, the columns where it is not zero are in `nonzero`.

    Every form is the sum of the combinations, weighted by the form's entries at the pivots. As many
    independent forms as there are combinations are enough, and a tenth of the work of all
    of them; they are those that are independent in `built_from`, the same positions' residues.
    """
    draw, field = random.Random(_SEED), fmpz_mod_ctx(_PRIME)
    at_pivots = fmpz_mod_mat([[row[pivot] for row in built_from] for pivot in pivots], field)
    independent_rows = [_first_not_zero(row) for row in at_pivots.rref()[0].tolist()]
    with ctx.workprec(_BITS):
        rows: list[Row] = []
        while len(rows) < len(built_from):
            rows += forms.at_random_position(draw, arb)
        independent = [rows[index] for index in independent_rows]
        weights = arb_mat([[row[pivot] for pivot in pivots] for row in independent])
        solution = weights.solve(arb_mat(independent))
        return [
            {
                column: (1, 1)
                if column == pivot
                else float(solution[row, column]).as_integer_ratio()
                for column in nonzero[row]
            }
            for row, pivot in enumerate(pivots)
        ]


def _fraction(residue: int, prime: int) -> tuple[int, int]:
    """The fraction of smallest numerator and denominator that leaves this residue (Wang 1981)."""
    bound = math.isqrt(prime // 2)
    before, now, factor_before, factor = prime, residue, 0, 1
    while now > bound:
        quotient = before // now
        before, now = now, before - quotient * now
        factor_before, factor = factor, factor_before - quotient * factor
    return (now, factor) if factor > 0 else (-now, -factor)


def _preference(term: InertialTerm, index: int) -> tuple[int, int]:
    if term.known is not None:
        return 4, index  # so that coefficients of known terms alone are apart from others
    if term.factors == ("motor",):
        return 0, index + 10_000  # after every inertia, before what is regrouped
    last = max((_REGROUPED_LAST.get(entry, 0) for entry, _ in term.body), default=0)
    return (last if len(term.body) == 1 else 0), index


def _forms_at_random_position(
    robot: Manipulator,
    chain: Chain,
    terms: Sequence[InertialTerm],
    order: Sequence[int],
    draw: random.Random,
    field: Any,
) -> list[list[Any]]:
    """Coefficients of `terms`, in `order`, in every element of M and G at one position."""

    def number(x: Any) -> Any:
        return field(int(x.numerator)) / field(int(x.denominator))

    def anywhere() -> Any:
        return field(draw.randrange(1, 2**20)) / field(2**19)

    cosines: list[Any] = []
    sines: list[Any] = []
    for _ in chain.angles:
        t = anywhere()
        cosines.append((1 - t * t) / (1 + t * t))
        sines.append(2 * t / (1 + t * t))
    zero = field(0)
    a, d, b = (
        [number(exact_number(getattr(joint, letter).value or 0.0)) for joint in robot.joints]
        for letter in "adb"
    )
    twists = link_twists(
        chain.in_numbers(number),
        cosines=cosines,
        sines=sines,
        a=a,
        d=[
            offset + anywhere() if joint.kind == "P" else offset
            for joint, offset in zip(robot.joints, d, strict=True)
        ],
        b=b,
        gravity=tuple(number(exact_number(g)) for g in robot.gravity),  # type: ignore[arg-type]
    )
    n, needed = len(twists), set[str](BODY)
    columns = {index: column for column, index in enumerate(order)}
    rows: list[list[Any]] = []

    def row(first: int, factors_of: Any) -> list[Any]:
        entries = [zero] * len(terms)
        cache: dict[int, dict[str, Any]] = {}
        for index, term in enumerate(terms):
            if term.link >= first and term.body:
                factors = cache.setdefault(term.link, {}) or factors_of(twists[term.link])
                cache[term.link] = factors
                total = sum(
                    (
                        (multiple if isinstance(multiple, int) else number(multiple))
                        * factors.get(entry, 0)
                        for entry, multiple in term.body
                    ),
                    zero,
                )
                entries[columns[index]] = total
        return entries

    for j in range(n):
        for k in range(j, n):
            entries = row(k, lambda twist, j=j, k=k: kinetic_factors(twist, j, k, needed))
            if j == k:
                for index, term in enumerate(terms):
                    if term.factors == ("motor",) and term.link == j:
                        entries[columns[index]] = field(1)
            rows.append(entries)
        rows.append(row(j, lambda twist, j=j: gravity_factors(twist, j, needed)))
    return rows


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
        """Return the remainder of `form` after the rows so far, and the combination taken off."""
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

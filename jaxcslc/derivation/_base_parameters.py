"""Minimal sets of coefficients: base parameters for numeric lengths, forms for symbolic ones.

`base_parameters` eliminates linear forms at random positions in exact arithmetic. `Basis` does
the same for the forms of the symbolic algebra (stage C.1.4).
"""

import dataclasses
import functools
import math
import random
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat, fmpz_mod_ctx, fmpz_mod_mat

from ..manipulator import Manipulator
from ._chain import Chain, LinkTwists, exact_number, link_twists
from ._lagrange import BODY, Form, InertialTerm, gravity_factors, kinetic_factors


# Parameters that are regrouped into others where that is possible, as the identification
# literature does (Gautier and Khalil 1990): mass, then the third first moment, then one moment.
_REGROUPED_LAST = {"Iyy": 1, "hz": 2, "m": 3}
_SEED = 1990  # of the random positions
_PRIME = 2**521 - 1  # a Mersenne prime
# Of numerators and denominators that are read back from residues: by chance, a residue is that of a
# fraction this short once in 2^(521 - 2 * 200).
_LONGEST = 2**200
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
    simplest fractions of their residues. Where angles are arbitrary the fractions are too long for
    that; then they are computed as numbers, in ball arithmetic that bounds its own rounding, and
    rounded once.

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
    rows, pivots, built_from = _echelon_form(forms)
    fractions = [
        {column: _fraction(int(x)) for column, x in enumerate(row) if x != 0} for row in rows
    ]
    if any(max(abs(top), bottom) > _LONGEST for row in fractions for top, bottom in row.values()):
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
        """Return the coefficients of all forms at one position, as numbers of a field."""

        def number(x: Any) -> Any:
            return field(int(x.numerator)) / field(int(x.denominator))

        def anywhere() -> Any:
            return field(draw.randrange(1, 2**20)) / field(2**19)

        cosines: list[Any] = []
        sines: list[Any] = []
        for _ in self.chain.angles:
            t = anywhere()
            cosines.append((1 - t * t) / (1 + t * t))
            sines.append(2 * t / (1 + t * t))
        joints = self.robot.joints
        a, d, b = (
            [number(exact_number(getattr(joint, letter).value or 0.0)) for joint in joints]
            for letter in "adb"
        )
        twists = link_twists(
            self.chain.in_numbers(number),
            cosines=cosines,
            sines=sines,
            a=a,
            d=[
                offset + anywhere() if joint.kind == "P" else offset
                for joint, offset in zip(joints, d, strict=True)
            ],
            b=b,
            gravity=tuple(number(exact_number(g)) for g in self.robot.gravity),  # type: ignore[arg-type]
        )
        zero, n, needed = field(0), len(twists), set[str](BODY)
        terms = [self.terms[index] for index in self.order]
        bodies = [
            [(entry, x if isinstance(x, int) else number(x)) for entry, x in term.body]
            for term in terms
        ]
        links = sorted({term.link for term in terms if term.body})
        motors = {x.link: column for column, x in enumerate(terms) if x.factors == ("motor",)}

        def row(first: int, factors_of: Callable[[LinkTwists], dict[str, Any]]) -> Row:
            factors = {link: factors_of(twists[link]) for link in links if link >= first}
            return [
                sum((x * factors[term.link].get(entry, 0) for entry, x in body), zero)
                if term.link >= first
                else zero
                for term, body in zip(terms, bodies, strict=True)
            ]

        rows: list[Row] = []
        for j in range(n):
            for k in range(j, n):
                entries = row(k, lambda twist, j=j, k=k: kinetic_factors(twist, j, k, needed))
                if j == k and j in motors:
                    entries[motors[j]] = field(1)
                rows.append(entries)
            rows.append(row(j, lambda twist, j=j: gravity_factors(twist, j, needed)))
        return rows


def _echelon_form(forms: _Forms) -> tuple[list[Row], list[int], list[Row]]:
    """The span's reduced row echelon form modulo the prime.

    **Returns** its rows, their pivot columns, and the forms at the positions that it was built
    from, one after the other.
    """
    draw, field = random.Random(_SEED), fmpz_mod_ctx(_PRIME)
    weights = random.Random(_SEED + 2)
    rows: list[Row] = []
    seen: list[Row] = []
    built_from = 0
    idle = 0
    while idle < _IDLE:
        new = forms.at_random_position(draw, field)
        seen += new
        # A combination of all forms, with random weights, is outside the span if one of them is.
        combination = fmpz_mod_mat([[field(weights.randrange(_PRIME)) for _ in new]], field)
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


def _fraction(residue: int) -> tuple[int, int]:
    """The fraction of smallest numerator and denominator that leaves this residue (Wang 1981)."""
    bound = math.isqrt(_PRIME // 2)
    before, now, factor_before, factor = _PRIME, residue, 0, 1
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


_LARGEST_DENOMINATOR = 1000  # of a common measure of multiples
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
        candidates = [
            (key, unit, {name: value * unit for name, value in key})
            for key, unit in ((key, _unit(factors)) for key, factors in multiples.items())
        ]
        candidates.sort(
            key=lambda item: (not all(map(known, item[2])), len(item[2]), label(item[2]))
        )
        names = list(dict.fromkeys(name for *_, form in candidates for name in form))
        columns = [[form.get(name, 0) for *_, form in candidates] for name in names]
        # Columns of pivots are the first that are independent; others are written in them.
        echelon, rank = fmpq_mat(columns).rref() if columns else (fmpq_mat(0, 0), 0)
        pivots = [_first_not_zero(row) for row in echelon.tolist()[:rank]]
        self.forms: list[Form] = [candidates[column][2] for column in pivots]
        self._combinations: dict[Direction, dict[int, Any]] = {
            key: {i: x / unit for i in range(rank) if (x := echelon[i, column])}
            for column, (key, unit, _) in enumerate(candidates)
        }

    def combination(self, form: Form) -> dict[int, Any]:
        """Return `form` as {index of basis form: rational}."""
        key, multiple = direction(form)
        return {index: multiple * value for index, value in self._combinations[key].items()}


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


def _unit(multiples: Sequence[Any]) -> Any:
    """Return the largest rational that all multiples are integers of, signed as the first.

    Where twists are arbitrary, multiples are cosines of them and have no common measure worth the
    name: then it is the first.
    """
    measure = functools.reduce(fmpq.gcd, map(fmpq, multiples), fmpq(0))
    if measure.denominator > _LARGEST_DENOMINATOR:
        return fmpq(multiples[0])
    return measure if multiples[0] > 0 else -measure

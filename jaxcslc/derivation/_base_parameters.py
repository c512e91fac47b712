import random
from collections.abc import Sequence
from typing import Any

from sympy import QQ
from sympy.polys.matrices import DomainMatrix

from ..manipulator import Manipulator
from ._chain import Chain, link_twists
from ._exact import exact_number
from ._inertial_terms import BODY, InertialTerm, gravity_factors, kinetic_factors


# Parameters that are regrouped into others where that is possible, as the identification
# literature does (Gautier and Khalil 1990): mass, then the third first moment, then one moment.
_REGROUPED_LAST = {"Iyy": 1, "hz": 2, "m": 3}
_SEED = 1990


def base_parameters(
    robot: Manipulator, chain: Chain, terms: Sequence[InertialTerm]
) -> tuple[tuple[int, ...], list[dict[int, Any]]]:
    """The minimal set of parameter combinations that torque depends on, lengths being numbers.

    Every element of M and G is, at every position, a linear form in `terms`. The base
    parameters are a basis of the span of these forms, here its reduced row echelon form: each
    is one term plus a rational combination of terms that are in no other way visible. That
    makes it canonical: it depends on the order of the terms alone.

    The span is built from the forms at rational positions (every cosine and sine a rational
    point of the unit circle), in exact arithmetic, until three further positions add nothing.
    Positions are drawn from a fixed seed; a set that misses part of the span is a zero of a
    polynomial that does not vanish identically. Building it from the coefficients of the
    expanded tables gives the same echelon form (tested) but needs the tables, which have tens
    of thousands of monomials when twists are arbitrary.

    **Returns** the chosen terms (indices into `terms`), and for each the combination it stands
    for, as {index: rational}.
    """
    order = sorted(range(len(terms)), key=lambda index: _preference(terms[index], index))
    draw = random.Random(_SEED)
    rows = DomainMatrix([], (0, len(terms)), QQ)
    rank, idle, pivots = 0, 0, ()
    while idle < 3:
        sample = _forms_at_random_position(robot, chain, terms, order, draw)
        rows, pivots = rows.vstack(DomainMatrix(sample, (len(sample), len(terms)), QQ)).rref()
        rows = rows[: len(pivots), :]
        idle = idle + 1 if len(pivots) == rank else 0
        rank = len(pivots)
    combinations = [
        {order[column]: row[column] for column in range(len(terms)) if row[column]}
        for row in rows.to_ddm().to_list()
    ]
    chosen = [order[column] for column in pivots]
    by_link = sorted(range(rank), key=lambda i: (terms[chosen[i]].link, order.index(chosen[i])))
    return tuple(chosen[i] for i in by_link), [combinations[i] for i in by_link]


def _preference(term: InertialTerm, index: int) -> tuple[int, int]:
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
) -> list[list[Any]]:
    """Coefficients of `terms`, in `order`, in every element of M and G at one position."""

    def rational() -> Any:
        return QQ(draw.randint(-9, 9), draw.randint(1, 9))

    cosines: list[Any] = []
    sines: list[Any] = []
    for _ in chain.angles:
        t = rational()
        cosines.append((1 - t * t) / (1 + t * t))
        sines.append(2 * t / (1 + t * t))
    zero = QQ(0)
    d = [exact_number(joint.d.value or 0.0) for joint in robot.joints]
    twists = link_twists(
        chain,
        cosines=cosines,
        sines=sines,
        a=[exact_number(joint.a.value or 0.0) for joint in robot.joints],
        d=[
            offset + rational() if joint.kind == "P" else offset
            for joint, offset in zip(robot.joints, d, strict=True)
        ],
        gravity=tuple(exact_number(g) for g in robot.gravity),  # type: ignore[arg-type]
    )
    n, needed = len(twists), set[str](BODY)
    place = {index: column for column, index in enumerate(order)}
    rows: list[list[Any]] = []

    def row(first: int, factors_of: Any) -> list[Any]:
        entries = [zero] * len(terms)
        cache: dict[int, dict[str, Any]] = {}
        for index, term in enumerate(terms):
            if term.link >= first and term.body:
                factors = cache.setdefault(term.link, {}) or factors_of(twists[term.link])
                cache[term.link] = factors
                total = sum(
                    (multiple * QQ(factors.get(entry, 0)) for entry, multiple in term.body), zero
                )
                entries[place[index]] = total
        return entries

    for j in range(n):
        for k in range(j, n):
            entries = row(k, lambda twist, j=j, k=k: kinetic_factors(twist, j, k, needed))
            if j == k:
                for index, term in enumerate(terms):
                    if term.factors == ("motor",) and term.link == j:
                        entries[place[index]] = QQ(1)
            rows.append(entries)
        rows.append(row(j, lambda twist, j=j: gravity_factors(twist, j, needed)))
    return rows

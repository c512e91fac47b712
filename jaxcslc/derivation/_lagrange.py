"""Lagrange's formulation: mass matrix, gravity vector and Christoffel symbols, as polynomials.

Each element maps monomials of the position to linear forms of inertial terms (stage C.1.4).
"""

from collections.abc import Mapping, Sequence
from typing import Any

from flint import fmpq

from ._chain import LinkTwists
from ._inertial_terms import InertialTerm, gravity_factors, kinetic_factors
from ._polynomials import Monomial, PositionRing, SparsePolynomial


# A form is linear in the terms. The key names a product of parameters and symbolic constants: index
# of the inertial term, exponents of the constants.
Form = dict[Any, Any]
Element = dict[Monomial, Form]  # one entry of M, G or the Christoffel symbols


def mass_matrix(
    ring: PositionRing, twists: Sequence[LinkTwists], terms: Sequence[InertialTerm]
) -> dict[tuple[int, int], Element]:
    """Upper triangle of the mass matrix (Eqn. 2.3-24) with motor inertias (Eqn. 2.5-6).

    Each element is factorised as stage C.1.4 asks: for every product of position-dependent
    quantities, the linear form of constants that multiplies it.
    """
    elements: dict[tuple[int, int], Element] = {}
    by_link = _by_link(terms, len(twists))
    for j in range(len(twists)):
        for k in range(j, len(twists)):
            element: Element = {}
            for i in range(k, len(twists)):
                needed = {entry for _, term in by_link[i] for entry, _ in term.body}
                factors = kinetic_factors(twists[i], j, k, needed)
                _collect(element, ring, by_link[i], factors)
            elements[j, k] = element
    one: Monomial = (0,) * len(ring.variables)
    for index, term in enumerate(terms):
        if term.factors == ("motor",):
            form = elements[term.link, term.link].setdefault(one, {})
            form[index, (0,) * len(ring.constants)] = fmpq(1)
    return elements


def gravity_vector(
    ring: PositionRing, twists: Sequence[LinkTwists], terms: Sequence[InertialTerm]
) -> dict[tuple[int], Element]:
    """The gravity effect vector (Eqn. 2.4-7), factorised like the mass matrix."""
    elements: dict[tuple[int], Element] = {}
    by_link = _by_link(terms, len(twists))
    for j in range(len(twists)):
        element: Element = {}
        for i in range(j, len(twists)):
            needed = {entry for _, term in by_link[i] for entry, _ in term.body}
            _collect(element, ring, by_link[i], gravity_factors(twists[i], j, needed))
        elements[j,] = element
    return elements


def christoffel_symbols(
    ring: PositionRing, mass: Mapping[tuple[int, ...], Element]
) -> dict[tuple[int, int, int], Element]:
    """Christoffel symbols of the first kind c_ijk, j <= k, k != i (Eqn. 2.4-5).

    Those with k = i >= j vanish. `mass` is the upper triangle, its forms in whatever they are
    written in: differentiating a mass matrix written in coefficients gives the velocity links
    in terms of mass coefficients at once (thesis 5.1.2).
    """
    n = max(k for _, k in mass) + 1
    derivatives: dict[tuple[int, int, int], Element] = {}
    for (j, k), element in mass.items():
        for joint in range(j + 1, n):  # M_jk does not move with the joints up to min(j, k)
            derivatives[j, k, joint] = ring.derivative(element, joint)

    def derivative(j: int, k: int, joint: int) -> Element:
        return derivatives.get((min(j, k), max(j, k), joint), {})

    symbols: dict[tuple[int, int, int], Element] = {}
    for i in range(n):
        for j in range(n):
            for k in range(j, n):
                if k != i:
                    symbols[i, j, k] = _half_sum(
                        derivative(i, k, j), derivative(i, j, k), derivative(j, k, i)
                    )
    return symbols


def _half_sum(plus: Element, also: Element, minus: Element) -> Element:
    total: Element = {}
    for element, sign in ((plus, 1), (also, 1), (minus, -1)):
        for monomial, form in element.items():
            form_total = total.setdefault(monomial, {})
            for key, value in form.items():
                form_total[key] = form_total.get(key, 0) + sign * value / 2
    return _without_zeros(total)


def _by_link(terms: Sequence[InertialTerm], links: int) -> list[list[tuple[int, InertialTerm]]]:
    grouped: list[list[tuple[int, InertialTerm]]] = [[] for _ in range(links)]
    for index, term in enumerate(terms):
        if term.body:
            grouped[term.link].append((index, term))
    return grouped


def _collect(
    element: Element,
    ring: PositionRing,
    terms: Sequence[tuple[int, InertialTerm]],
    factors: dict[str, Any],
) -> None:
    """Add `terms` times the polynomials that multiply them, sorted by position monomial."""
    split = len(ring.variables)
    normal = {entry: ring.normal_form(polynomial) for entry, polynomial in factors.items()}
    for index, term in terms:
        for entry, multiple in term.body:
            polynomial = normal.get(entry, 0)
            exact = fmpq(multiple.numerator, multiple.denominator)
            if not isinstance(polynomial, SparsePolynomial):  # a plain number
                constant = (0,) * (split + len(ring.constants))
                polynomial = {constant: fmpq(polynomial)} if polynomial else {}
            for exponents, value in polynomial.items():
                form = element.setdefault(exponents[:split], {})
                key = (index, exponents[split:])
                total = form.get(key, 0) + exact * value
                if total:
                    form[key] = total
                else:
                    del form[key]
    for monomial in [monomial for monomial, form in element.items() if not form]:
        del element[monomial]


def _without_zeros(element: Element) -> Element:
    kept = {
        monomial: {key: value for key, value in form.items() if value}
        for monomial, form in element.items()
    }
    return {monomial: form for monomial, form in kept.items() if form}

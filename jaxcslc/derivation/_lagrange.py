"""Lagrange's formulation: mass matrix, gravity vector and Christoffel symbols, as polynomials.

Link parameters come as products, each of which belongs to entries of `BODY`, the ten numbers of a
rigid body: dynamics are linear in these (Eqns. 2.3-17, 2.3-20). An element of M or G maps monomials
of the position to linear forms of the products (stage C.1.4).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from flint import fmpq

from ..manipulator import LinkInertia, Manipulator
from ._chain import LinkTwists, add, cross, decimal_fraction, dot, minus
from ._polynomials import Monomial, PositionRing, SparsePolynomial, product_text


# The ten numbers that a rigid body's dynamics are linear in: inertia tensor about the frame's
# origin, first moments, mass.
BODY = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz", "hx", "hy", "hz", "m")
"""Names of the ten numbers that a rigid body's dynamics are linear in: inertia tensor about the
frame's origin, first moments, mass."""
_AXES = ("x", "y", "z")
_FIRST_MOMENTS = BODY[6:9]
_CENTRE = ("rx", "ry", "rz")


class UnitInertia(NamedTuple):
    """Inertia of a robot with one base parameter of 1 and all others zero.

    **Attributes**

    - `link`: index of the link that has inertia.
    - `body`: its ten numbers, in the order of `BODY`; zeros for a motor.
    - `motor`: inertia that the link's joint adds to its own, 1 or 0.
    """

    link: int
    body: tuple[int | float, ...]
    motor: int


@dataclass(frozen=True)
class InertialTerm:
    """Product of a link's physical parameters, and its place in the link's inertia.

    **Attributes**

    - `link`: counted from 0.
    - `factors`: `("Ixx",)`, `("m", "rx", "ry")`, `("motor",)`, to be multiplied.
    - `body`: entries of `BODY` that contain the product, with their multiples of it (Eqns. 2.3-17,
      2.3-20). Where the centre of gravity is known, the mass is in first moments too, multiplied
      by its coordinates (C.1.2).
    - `central`: whether it is a moment about the centre of gravity instead of the frame's origin.
    - `known`: its value, where that is a number in the algebra; else None.
    """

    link: int
    factors: tuple[str, ...]
    body: tuple[tuple[str, int | Fraction], ...]
    central: bool = False
    known: Fraction | None = None

    @property
    def label(self) -> str:
        """Term as it is printed, links counted from 1: `"m6*rz6^2"`, `"Ixx3"`, `"Im2"`."""
        factors = ("Im" if factor == "motor" else factor for factor in self.factors)
        return product_text(Counter(f"{factor}{self.link + 1}" for factor in factors).items())

    @property
    def unit_inertia(self) -> UnitInertia:
        """Inertia of the link if this term is 1 and all others are zero."""
        multiples = dict(self.body)
        numbers = (multiples.get(entry, 0) for entry in BODY)
        body = tuple(float(x) if isinstance(x, Fraction) else x for x in numbers)
        return UnitInertia(self.link, body, int(self.factors == ("motor",)))


def inertial_terms(robot: Manipulator) -> tuple[InertialTerm, ...]:
    """Return every product of parameters that the robot's links have, link by link, motors last."""
    bodies = (term for link, x in enumerate(robot.inertia) for term in _terms_of_body(link, x))
    motors = (InertialTerm(link, ("motor",), ()) for link, x in enumerate(robot.inertia) if x.motor)
    return (*bodies, *motors)


def _terms_of_body(link: int, inertia: LinkInertia) -> list[InertialTerm]:
    same = {moment: moment for moment in ("Ixx", "Iyy", "Izz")}
    for first, second in inertia.equal:  # a chain of pairs makes one moment of all
        one, joined = min(same[first], same[second]), {same[first], same[second]}
        same = {moment: one if name in joined else name for moment, name in same.items()}
    centre: dict[str, Fraction] = dict(
        zip(_CENTRE, map(decimal_fraction, inertia.centre or ()), strict=False)
    )
    body: dict[tuple[str, ...], dict[str, int | Fraction]] = {}

    def put(factors: tuple[str, ...], entries: Mapping[str, int | Fraction]) -> None:
        if centre:  # coordinates are numbers, which multiply the mass
            multiple = math.prod(centre[factor] for factor in factors[1:])
            factors, entries = factors[:1], {name: x * multiple for name, x in entries.items()}
        if set(inertia.zero).isdisjoint(factors) and any(entries.values()):
            of_term = body.setdefault(factors, {})
            for entry, multiple in entries.items():
                of_term[entry] = of_term.get(entry, 0) + multiple

    for moment in same:
        put((same[moment],), {moment: 1})
    if inertia.form == "full":
        for product in ("Ixy", "Ixz", "Iyz"):
            put((product,), {product: 1})
    else:
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            put(
                ("m", f"r{_AXES[a]}", f"r{_AXES[a]}"),
                {f"I{_AXES[b]}{_AXES[b]}": 1, f"I{_AXES[c]}{_AXES[c]}": 1},
            )
        for a, b in ((0, 1), (0, 2), (1, 2)):
            put(("m", f"r{_AXES[a]}", f"r{_AXES[b]}"), {f"I{_AXES[a]}{_AXES[b]}": -1})
    for axis in _AXES:
        put(("m", f"r{axis}"), {f"h{axis}": 1})
    put(("m",), {"m": 1})
    central = inertia.form == "principal"
    known = None if inertia.mass is None else decimal_fraction(inertia.mass)
    return [
        InertialTerm(
            link,
            factors,
            tuple(entries.items()),
            central and factors[0][0] == "I",
            known if factors == ("m",) else None,
        )
        for factors, entries in body.items()
    ]


def kinetic_factors(twists: LinkTwists, j: int, k: int, needed: set[str]) -> dict[str, Any]:
    """Return the factor of each entry of `BODY` that is in `needed` in M_jk (Eqn. 2.3-24).

    The bilinear form of the kinetic energy: w_j' I w_k + h · (v_j x w_k + v_k x w_j) + m v_j · v_k.
    """
    wj, wk, vj, vk = twists.angular[j], twists.angular[k], twists.linear[j], twists.linear[k]
    factors: dict[str, Any] = {}
    for a, name in enumerate(_AXES):
        if f"I{name}{name}" in needed:
            factors[f"I{name}{name}"] = wj[a] * wk[a]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        name = f"I{_AXES[a]}{_AXES[b]}"
        if name in needed:
            factors[name] = wj[a] * wk[b] + wj[b] * wk[a]
    if not needed.isdisjoint(_FIRST_MOMENTS):
        factors |= zip(_FIRST_MOMENTS, add(cross(vj, wk), cross(vk, wj)), strict=True)
    if "m" in needed:
        factors["m"] = dot(vj, vk)
    return factors


def gravity_factors(twists: LinkTwists, j: int, needed: set[str]) -> dict[str, Any]:
    """Return the factor of each entry of `BODY` in G_j (Eqns. 2.3-28, 2.4-7).

    The potential energy is -g · p for every mass point p, and dp/dq_j = v_j + w_j x r.
    """
    w, v, g = twists.angular[j], twists.linear[j], twists.gravity
    factors: dict[str, Any] = {}
    if not needed.isdisjoint(_FIRST_MOMENTS):
        factors |= zip(_FIRST_MOMENTS, cross(w, g), strict=True)
    if "m" in needed:
        factors["m"] = minus(dot(v, g))
    return factors


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
    kept = {monomial: {k: x for k, x in form.items() if x} for monomial, form in total.items()}
    return {monomial: form for monomial, form in kept.items() if form}


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

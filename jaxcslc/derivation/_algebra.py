"""Whole derivation of a robot's inverse dynamics: `derive_algebra` and its result, the `Algebra`.

Lengths are symbols or numbers. With symbols, coefficients are the thesis's (stage C.1.4); with
numbers, they are base parameters. Tables are made when they are first used.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, Literal

from flint import fmpq

from ..manipulator import Length, Manipulator, Numbering, RobotError, Subnumbering
from ._base_parameters import Basis, base_parameters
from ._chain import Chain, LinkTwists, exact_number, link_twists
from ._lagrange import (
    Element,
    Form,
    InertialTerm,
    UnitInertia,
    christoffel_symbols,
    gravity_vector,
    inertial_terms,
    mass_matrix,
)
from ._polynomials import PositionRing
from ._tables import (
    Addend,
    Coefficient,
    Column,
    ProductTable,
    addend_unit,
    positive_by_construction,
    sum_text,
    table,
)


Lengths = Literal["symbolic", "numeric"] | tuple[str, ...]
"""Lengths that stay symbols: all, none, or those named."""


@dataclass(frozen=True, eq=False)
class Tables:
    """The tables of the three subnetworks, each made when it is first used."""

    ring: PositionRing
    numbering: Numbering | None
    elements: Callable[[], tuple[dict[Column, Element], dict[Column, Element]]]
    """Gives the mass matrix and the gravity vector, their forms written in coefficients."""

    @cached_property
    def _written(self) -> tuple[dict[Column, Element], dict[Column, Element]]:
        return self.elements()

    @cached_property
    def mass(self) -> ProductTable:
        return self._table("mass", self._written[0])

    @cached_property
    def velocity(self) -> ProductTable:
        return self._table("velocity", christoffel_symbols(self.ring, self._written[0]))

    @cached_property
    def gravity(self) -> ProductTable:
        return self._table("gravity", self._written[1])

    def _table(self, name: str, elements: Mapping[Any, Element]) -> ProductTable:
        if self.numbering is None:
            return table(self.ring, elements)
        return table(self.ring, elements, getattr(self.numbering, name), self.numbering.source)


@dataclass(frozen=True, eq=False)
class Algebra:
    """A robot's inverse dynamics in exact arithmetic: what a network is built from.

    Derived again from an equal robot it compares equal, so that compiled functions are shared.

    **Attributes**

    - `robot`, `lengths`: what it was derived from.
    - `ring`: names and meaning of the position-dependent variables.
    - `terms`: the products of link parameters that occur.
    - `coefficients`: inertial coefficients, in the order of the network's vector. Friction is
      no matter of algebra and is added by the network.
    - `base_terms`: for numeric lengths, the index in `terms` of the term that each base parameter
      is named after.

    `mass`, `velocity` and `gravity` are the tables of the three subnetworks.
    """

    robot: Manipulator
    lengths: Lengths
    ring: PositionRing
    terms: tuple[InertialTerm, ...]
    coefficients: tuple[Coefficient, ...]
    base_terms: tuple[int, ...]
    tables: Tables

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Algebra) and self.tables is other.tables

    def __hash__(self) -> int:
        return id(self.tables)

    @property
    def chain(self) -> Chain:
        return self.ring.chain

    @property
    def unit_inertias(self) -> tuple[UnitInertia, ...]:
        """Inertia of each base parameter alone; for numeric lengths.

        Torque depends on the links through the base parameters only. So it is what the terms that
        these are named after produce alone, set to the base parameters, all others being zero. (In
        matrices: k = L θ with L in reduced echelon form, so selecting the columns of these terms is
        a right inverse of L.)
        """
        return tuple(self.terms[index].unit_inertia for index in self.base_terms)

    @property
    def mass(self) -> ProductTable:
        """Inputs and links of the mass matrix's upper triangle (thesis 5.1.1)."""
        return self.tables.mass

    @property
    def velocity(self) -> ProductTable:
        """Inputs and links of the Christoffel symbols, in mass coefficients (thesis 5.1.2)."""
        return self.tables.velocity

    @property
    def gravity(self) -> ProductTable:
        """Inputs and links of the gravity effect vector (thesis 5.1.3)."""
        return self.tables.gravity


def derive_algebra(robot: Manipulator, lengths: Lengths) -> Algebra:
    """Derive Eqns. 2.3-17 to 2.5-6 and stage C.1.4 for any serial robot.

    **Arguments**

    - `robot`: its joints, inertial terms and gravity.
    - `lengths`: `"symbolic"` keeps lengths and gravity as symbols: the coefficients are those of
      the thesis, mass and gravity apart. `"numeric"` puts their values in: fewer coefficients,
      the base parameters of the identification literature, which mass and gravity share. A tuple
      of names keeps these lengths, and gravity, as symbols and puts the values of the others in
      (thesis 8.2.1): mass and gravity stay apart.

    **Raises** `RobotError` if a length that is to be a number has no value, if a name is no length
    of the robot, or if a published numbering does not fit.

    >>> from jaxcslc.manipulator import Manipulator
    >>> pendulum = Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> [c.expression for c in derive_algebra(pendulum, "numeric").coefficients]
    ['Izz1 + Im1', 'm1*rx1', 'm1*ry1']
    """
    # Link parameters are no part of the algebra: robots that differ in them share one derivation.
    return dataclasses.replace(_derived(robot, lengths), robot=robot)


@lru_cache(maxsize=64)
def _derived(robot: Manipulator, lengths: Lengths) -> Algebra:
    chain = Chain.from_robot(robot)
    terms = inertial_terms(robot)
    if lengths == "numeric":
        return _with_numbers(robot, chain, terms)
    return _with_symbols(robot, chain, terms, lengths)


def _with_numbers(robot: Manipulator, chain: Chain, terms: tuple[InertialTerm, ...]) -> Algebra:
    robot.length_values()  # every length must have one
    base_terms, combinations = base_parameters(robot, chain, terms)
    ring = PositionRing(chain, ())
    coefficients = tuple(
        _coefficient(f"kB{i}", "base", _with_name_first(combination, terms), robot)
        for i, combination in enumerate(combinations, start=1)
    )

    def elements() -> tuple[dict[Column, Element], dict[Column, Element]]:
        # A base parameter is its base term plus what is regrouped into it, so that a form is
        # the combination that its entries at the base terms give: the others can be left out.
        twists = _twists(robot, ring, lambda length, _: exact_number(length.value or 0.0))
        kept = [terms[index] for index in base_terms]
        parts = mass_matrix(ring, twists, kept), gravity_vector(ring, twists, kept)
        mass, weight = (
            _rewritten(part, lambda form: {i: fmpq(v) for (i, _), v in form.items()})
            for part in parts
        )
        return mass, weight

    tables = Tables(ring, None, elements)
    return Algebra(robot, "numeric", ring, terms, coefficients, base_terms, tables)


def _with_name_first(form: Form, terms: Sequence[InertialTerm]) -> list[Addend]:
    """Return a base parameter's addends; the term that it is named after comes first."""
    addends = _addends({(index, ()): value for index, value in form.items()}, terms, ())
    return sorted(addends, key=lambda addend: addend.factor != 1)


def _with_symbols(
    robot: Manipulator, chain: Chain, terms: tuple[InertialTerm, ...], lengths: Lengths
) -> Algebra:
    named = _kept(robot, lengths)
    gravity = _gravity_symbols(robot)
    ring = PositionRing(chain, (*named, *(symbol for symbol, _ in gravity if symbol)))
    taken = {*ring.variables, *(symbol for symbol, _ in gravity)}
    if clash := taken & set(named):
        raise RobotError(
            f"robot {robot.name!r}: length {min(clash)!r} has the name of a position variable or"
            " of gravity; give it another"
        )

    def exact_length(length: Length, name: str) -> Any:
        symbol = length.symbol or name
        return ring.constant(symbol) if symbol in named else exact_number(length.value or 0.0)

    twists = _twists(robot, ring, exact_length)
    mass = mass_matrix(ring, twists, terms)
    weight = gravity_vector(ring, twists, terms)

    def addends(form: Form) -> tuple[Addend, ...]:
        return _addends(form, terms, ring.constants)

    def label(form: Form) -> str:
        return sum_text((addend.factor, addend.label) for addend in addends(form))

    # Symbolic constants are in every form's key, so elements of M and G never share one.
    known = {index for index, term in enumerate(terms) if term.known is not None}
    numbering = robot.numbering if lengths == "symbolic" else None  # published for symbols
    accelerations = tuple(symbol for symbol, _ in gravity if symbol)
    coefficients: list[Coefficient] = []
    rewrites: list[Callable[[Form], Form]] = []
    for group, part in (("mass", mass), ("gravity", weight)):
        basis = Basis(_forms(part), label, lambda key: key[0] in known)
        if lengths == "symbolic":
            order = _published_order(basis, part, numbering and getattr(numbering, group), ring)
        else:  # multiples of numbers are no integers: each coefficient begins with its first term
            order = [(i, 1 / form[min(form)]) for i, form in enumerate(basis.forms)]
        rewrites.append(_rewriting(basis, order, len(coefficients)))
        for form, (index, scale) in sorted(
            zip(basis.forms, order, strict=True), key=lambda entry: entry[1][0]
        ):
            scaled = {key: value * scale for key, value in form.items()}
            name = f"k{group[0].upper()}{index + 1}"
            coefficients.append(_coefficient(name, group, addends(scaled), robot, accelerations))

    def elements() -> tuple[dict[Column, Element], dict[Column, Element]]:
        return _rewritten(mass, rewrites[0]), _rewritten(weight, rewrites[1])

    tables = Tables(ring, numbering, elements)
    return Algebra(robot, lengths, ring, terms, tuple(coefficients), (), tables)


def _rewriting(
    basis: Basis, order: Sequence[tuple[int, Any]], start: int
) -> Callable[[Form], Form]:
    """Return what writes forms in coefficients, which `start` at an index of the vector."""
    return lambda form: {
        start + order[index][0]: value / order[index][1]
        for index, value in basis.combination(form).items()
    }


def _kept(robot: Manipulator, lengths: Lengths) -> dict[str, Length]:
    """The lengths that stay symbols."""
    named = robot.named_lengths()
    if isinstance(lengths, str):
        return named
    for symbol in lengths:
        if symbol not in named:
            raise RobotError(
                f"robot {robot.name!r} has no length {symbol!r};"
                f" expected symbolic, numeric, or some of {', '.join(named) or 'none'}"
            )
    for symbol, length in named.items():
        if symbol not in lengths and length.value is None:
            raise RobotError(
                f"robot {robot.name!r}: length {symbol!r} has no value; give one, or keep it"
                " symbolic"
            )
    return {symbol: length for symbol, length in named.items() if symbol in lengths}


def _twists(
    robot: Manipulator, ring: PositionRing, number: Callable[[Length, str], Any]
) -> tuple[LinkTwists, ...]:
    of: dict[str, list[Any]] = {letter: [] for letter in "adb"}
    for i, joint in enumerate(robot.joints, start=1):
        for letter, shift, length in joint.lengths:
            of[letter].append(0 if length.is_zero else number(length, f"{letter}{i + shift}"))
        if joint.kind == "P":
            of["d"][-1] = of["d"][-1] + ring.joint_variable(i - 1)
    if ring.constants:
        gravity = tuple(
            sign * ring.constant(symbol) if symbol else 0
            for symbol, sign in _gravity_symbols(robot)
        )
    else:
        gravity = tuple(exact_number(g) for g in robot.gravity)
    return link_twists(
        ring.chain,
        cosines=ring.cosines,
        sines=ring.sines,
        a=of["a"],
        d=of["d"],
        b=of["b"],
        gravity=gravity,  # type: ignore[arg-type]
        reduce=ring.normal_form,
    )


def _gravity_symbols(robot: Manipulator) -> tuple[tuple[str, int], ...]:
    """A symbol and its sign for each component of gravity: `g` alone along an axis."""
    present = [axis for axis, g in zip("xyz", robot.gravity, strict=True) if g]
    return tuple(
        ("", 0) if not g else (("g", 1 if g > 0 else -1) if len(present) == 1 else (f"g{axis}", 1))
        for axis, g in zip("xyz", robot.gravity, strict=True)
    )


def constant_values(robot: Manipulator) -> dict[str, float]:
    """Values of the constants that symbolic expressions name: lengths [m], gravity [m/s²]."""
    gravity = {
        symbol: sign * g
        for (symbol, sign), g in zip(_gravity_symbols(robot), robot.gravity, strict=True)
        if symbol
    }
    return {**robot.length_values(), **gravity}


def _forms(elements: Mapping[Any, Element]) -> list[Form]:
    return [form for element in elements.values() for form in element.values()]


def _rewritten(
    elements: Mapping[Any, Element], rewrite: Callable[[Form], Form]
) -> dict[Column, Element]:
    return {
        column: {monomial: rewrite(form) for monomial, form in element.items()}
        for column, element in elements.items()
    }


def _published_order(
    basis: Basis,
    elements: Mapping[Any, Element],
    published: Subnumbering | None,
    ring: PositionRing,
) -> list[tuple[int, Any]]:
    """Return each basis form's published index, and the factor to the published form."""
    if published is None or not published.coefficients:
        return [(index, fmpq(1)) for index in range(len(basis.forms))]
    order: dict[int, tuple[int, Any]] = {}
    for number, (label, column, multiple) in enumerate(published.coefficients):
        monomial = ring.parse(label)
        indices = tuple(index - 1 for index in column)
        element = elements.get(indices, {})
        form = element.get(monomial) if monomial is not None else None
        combination = basis.combination(form) if form else {}
        if len(combination) != 1 or set(combination) & set(order):
            raise RobotError(
                f"numbering: the link from {label!r} to element {column} does not define a"
                f" coefficient of its own (number {number + 1})"
            )
        ((index, value),) = combination.items()
        order[index] = number, value / exact_number(multiple)
    if len(order) != len(basis.forms):
        raise RobotError(
            f"numbering: lists {len(order)} coefficients, the algebra has {len(basis.forms)}"
        )
    return [order[index] for index in range(len(basis.forms))]


def _addends(
    form: Form, terms: Sequence[InertialTerm], constants: Sequence[str]
) -> tuple[Addend, ...]:
    return tuple(
        Addend(
            Fraction(int(fmpq(value).numerator), int(fmpq(value).denominator)),
            tuple((name, power) for name, power in zip(constants, powers, strict=True) if power),
            terms[index],
        )
        for (index, powers), value in sorted(form.items())
    )


def _coefficient(
    name: str,
    group: str,
    addends: Sequence[Addend],
    robot: Manipulator,
    accelerations: Sequence[str] = (),
) -> Coefficient:
    kind = robot.joints[addends[0].term.link].kind
    return Coefficient(
        name,
        group,
        sum_text((addend.factor, addend.label) for addend in addends),
        addend_unit(addends[0], prismatic=kind == "P", gravity=accelerations),
        positive_by_construction(addends, accelerations),
        tuple(addends),
    )

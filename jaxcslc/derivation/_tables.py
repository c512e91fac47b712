"""Coefficients, inputs and links of a subnetwork, as the thesis's Appendix B tabulates them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import fmpq, fmpq_mat

from ..manipulator import RobotError, Subnumbering
from ._lagrange import Element, InertialTerm
from ._polynomials import Monomial, PositionRing, product_text


@dataclass(frozen=True)
class Addend:
    """Addend of a coefficient: a rational times named constants times link parameters."""

    factor: Fraction
    constants: tuple[tuple[str, int], ...]  # name and power, as in ("d4", 2)
    term: InertialTerm

    @property
    def label(self) -> str:
        """Addend without its rational factor, as in `"d4^2*m4"`."""
        return "*".join([*filter(None, [product_text(self.constants)]), self.term.label])


@dataclass(frozen=True, eq=False)  # compared by identity, like the table that indexes it
class Coefficient:
    """A coefficient of the inverse dynamics: what one weight of the network is.

    **Attributes**

    - `name`: `kM1`, `kG1`, `kB1` (a base parameter, lengths being numbers), `kv1`, `kd1`, `ko1`.
    - `group`: `"mass"`, `"gravity"`, `"base"`, `"viscous"`, `"dry"` or `"offset"`.
    - `expression`: in terms of physical parameters; links are counted from 1, `rx ry rz` is the
      centre of gravity, `Im` the effective motor inertia.
    - `unit`: SI.
    - `positive`: whether its sign is positive by construction (thesis 5.2.3).
    - `addends`: the expression, to compute with.

    >>> import jaxcslc as jc
    >>> coefficient = jc.derive(jc.puma560()).coefficients[3]
    >>> coefficient.name, coefficient.expression, coefficient.unit, coefficient.positive
    ('kM4', 'Izz6', 'kg m²', True)
    """

    name: str
    group: str
    expression: str
    unit: str
    positive: bool
    addends: tuple[Addend, ...] = ()

    @property
    def is_known(self) -> bool:
        """True if the coefficient is made of known masses alone (thesis C.1.2)."""
        return bool(self.addends) and all(x.term.known is not None for x in self.addends)

    def known_value(self, constants: Mapping[str, float]) -> float:
        """Return the value of a coefficient that `is_known`.

        - `constants`: values of lengths and gravity, by name.
        """
        return sum(
            float(x.factor * (x.term.known or 0))
            * math.prod(constants[name] ** power for name, power in x.constants)
            for x in self.addends
        )


def sum_text(addends: Iterable[tuple[Any, str]]) -> str:
    """Return a sum as it is printed, its rationals as decimals: `"Ixx4 - 0.5*m4*rz4"`.

    - `addends`: rational factors, and what they multiply; `""` for 1.
    """
    text = ""
    for factor, label in addends:
        top, bottom = int(abs(factor).numerator), int(factor.denominator)
        number = str(top) if bottom == 1 else repr(top / bottom)
        part = "*".join(x for x in ("" if number == "1" and label else number, label) if x)
        sign = "-" if factor < 0 else "+"
        text += f" {sign} {part}" if text else part if sign == "+" else f"-{part}"
    return text


def addend_unit(addend: Addend, *, prismatic: bool, gravity: Sequence[str]) -> str:
    """SI unit of a coefficient from any one of its addends.

    `prismatic`: whether the addend's joint is prismatic (the motor inertia is then a mass).
    `gravity`: names of constants that are accelerations.
    """
    metres, per_second_squared = 0, 0
    for name, power in addend.constants:
        metres += power
        per_second_squared += power if name in gravity else 0
    for factor in addend.term.factors:
        if factor.startswith("I") or (factor == "motor" and not prismatic):
            metres += 2
        elif factor.startswith("r"):
            metres += 1
    if per_second_squared:
        return {1: "N", 2: "N m"}.get(metres, f"kg m^{metres}/s²")
    return {0: "kg", 1: "kg m", 2: "kg m²"}[metres]


Column = tuple[int, ...]  # (row, column) of M, (i, j, k) of c_ijk or (joint,) of G, from 0


@dataclass(frozen=True)
class TableLink:
    """A link of the network: from an input to an element, weighted by coefficients.

    **Attributes**

    - `input`, `column`: indices into the table's `inputs` and `columns`.
    - `weights`: (coefficient, multiple) pairs, coefficients counted from 0 in the network's vector.
    """

    input: int
    column: int
    weights: tuple[tuple[int, Fraction], ...]


@dataclass(frozen=True, eq=False)  # compared by identity: a table is part of compiled functions
class ProductTable:
    """Table of one subnetwork: element = sum over its links of weight times input (thesis 5.1).

    **Attributes**

    - `inputs`: monomials in the ring's variables: the preprocessed inputs.
    - `labels`: the same as they are printed, `"c23*s4*c5"`.
    - `columns`: which element each node of the second layer is, indices from 0: (j, k) of the
      mass matrix, (i, j, k) of the Christoffel symbols, (i,) of the gravity vector.
    - `links`: those that exist.
    """

    inputs: tuple[Monomial, ...]
    labels: tuple[str, ...]
    columns: tuple[Column, ...]
    links: tuple[TableLink, ...]

    @property
    def coefficients(self) -> frozenset[int]:
        """Indices of the coefficients that the links use."""
        return frozenset(index for link in self.links for index, _ in link.weights)


def table(
    ring: PositionRing,
    elements: Mapping[Column, Element],
    published: Subnumbering | None = None,
    source: str = "",
) -> ProductTable:
    """Sort elements, their forms written in coefficients, into inputs and links.

    Inputs are numbered as they are met, column by column, simple ones first; or as `published`
    lists them.

    **Raises** `RobotError` if the published inputs are not exactly those of the algebra.
    """
    inputs: dict[Monomial, int] = {}
    if published is not None and published.inputs:
        inputs = _published_inputs(ring, elements, published.inputs, source)
    else:
        for element in elements.values():
            for monomial in sorted(element, key=lambda m: (sum(m), [-power for power in m])):
                inputs.setdefault(monomial, len(inputs))
    columns = tuple(elements)
    links = [
        TableLink(
            inputs[monomial],
            column,
            tuple(
                (index, Fraction(int(value.numerator), int(value.denominator)))
                for index, value in sorted(form.items())
            ),
        )
        for column, element in enumerate(elements.values())
        for monomial, form in element.items()
    ]
    links.sort(key=lambda link: (link.input, link.column))
    return ProductTable(
        tuple(inputs), tuple(ring.label(monomial) for monomial in inputs), columns, tuple(links)
    )


def _published_inputs(
    ring: PositionRing, elements: Mapping[Column, Element], labels: Sequence[str], source: str
) -> dict[Monomial, int]:
    monomials = {monomial for element in elements.values() for monomial in element}
    inputs: dict[Monomial, int] = {}
    for label in labels:
        monomial = ring.parse(label)
        if monomial is None or monomial not in monomials or monomial in inputs:
            raise RobotError(
                f"numbering ({source}): {label!r} is not an input of this robot, or is listed twice"
            )
        inputs[monomial] = len(inputs)
    if missing := monomials - set(inputs):
        raise RobotError(
            f"numbering ({source}): input {ring.label(min(missing))!r} of this robot is not listed"
        )
    return inputs


_MOMENTS = {"Ixx": ("y", "z"), "Iyy": ("x", "z"), "Izz": ("x", "y")}


def positive_by_construction(addends: Sequence[Addend], gravity: Sequence[str]) -> bool:
    """Return whether a coefficient is positive for every possible mass distribution (thesis 5.2.3).

    Moments of inertia, first moments and mass of a link are integrals over its mass of products
    of two of x, y, z and the lengths. So a link's share of a coefficient is the integral of a
    quadratic form, which cannot be negative if the form is positive semidefinite. Shares of
    different links, of moments about a centre of gravity and of motors add up.

    Sufficient, and checked in exact arithmetic. It finds the four that the thesis names (kM4,
    kM6, kM9 and kM11 of the PUMA 560) and others, such as complete squares.
    """
    forms: dict[tuple[int, bool], dict[tuple[str, str], Fraction]] = {}
    for addend in addends:
        lengths = [name for name, power in addend.constants for _ in range(power)]
        if any(name in gravity for name in lengths):
            return False
        factors, link = addend.term.factors, addend.term.link
        if factors == ("motor",):
            if addend.factor < 0:
                return False
            continue
        moment = factors[0].startswith("I")
        # A principal moment is an integral about the centre of gravity: another form.
        form = forms.setdefault((link, addend.term.central), {})
        if factors[0] in _MOMENTS:
            for axis in _MOMENTS[factors[0]]:
                _add(form, axis, axis, addend.factor)
        elif moment:  # a tensor's off-diagonal element is -∫ x y dm
            _add(form, factors[0][1], factors[0][2], -addend.factor)
        else:
            variables = [factor[1] for factor in factors[1:]] + lengths
            variables += ["1"] * (2 - len(variables))  # numeric lengths are in the factor
            if len(variables) != 2:
                return False
            _add(form, variables[0], variables[1], addend.factor)
    return all(_positive_semidefinite(form) for form in forms.values())


def _add(form: dict[tuple[str, str], Fraction], a: str, b: str, value: Fraction) -> None:
    """Add value * a * b to a form, stored as its symmetric matrix."""
    for key in ((a, b), (b, a)):
        form[key] = form.get(key, Fraction(0)) + value / 2


def _positive_semidefinite(form: dict[tuple[str, str], Fraction]) -> bool:
    """Return whether a form is positive semidefinite.

    Its eigenvalues are real. By Descartes' rule of signs none is negative if, and only if, the
    coefficients of the characteristic polynomial alternate in sign.
    """
    names = sorted({name for key in form for name in key})
    entries = [[form.get((a, b), Fraction(0)) for b in names] for a in names]
    matrix = fmpq_mat([[fmpq(x.numerator, x.denominator) for x in row] for row in entries])
    coefficients = matrix.charpoly().coeffs()
    return all(x * (-1) ** (len(names) - power) >= 0 for power, x in enumerate(coefficients))

"""Sparse polynomials in a robot's position, with rational coefficients and a normal form.

Generators are cosine and sine of every independent angle, variables of prismatic joints, and
named constants. Equal functions are equal polynomials, because s² is replaced by 1 - c².
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, no_type_check

from flint import fmpq

from ._chain import Chain


Monomial = tuple[int, ...]


def product_text(powers: Iterable[tuple[str, int]]) -> str:
    """Return a product of powers as it is printed: `"c23*c5^2"`."""
    return "*".join(name if power == 1 else f"{name}^{power}" for name, power in powers if power)


class SparsePolynomial(dict[Monomial, Any]):
    """A polynomial with rational coefficients: exponents of the generators to coefficients.

    Without zeros. What it is added to or multiplied by is a polynomial in the same generators, or
    a number. (The rings of sympy do the same. Importing sympy took longer than the derivations of
    a PUMA 560 and a Panda together, and products here have tens of terms, in which FLINT's own
    polynomials would gain nothing.) The order of terms follows from that of the operands: the sign
    of a coefficient of the network is that of the first term in which it is met.

    >>> x = SparsePolynomial.generator(0, 2)
    >>> y = SparsePolynomial.generator(1, 2)
    >>> (x + y) * (x - y)
    {(2, 0): 1, (0, 2): -1}
    """

    @classmethod
    def generator(cls, index: int, count: int) -> "SparsePolynomial":
        """Return the generator with an index, out of `count`."""
        return cls({tuple(int(i == index) for i in range(count)): fmpq(1)})

    @classmethod
    def without_zeros(cls, terms: dict[Monomial, Any]) -> "SparsePolynomial":
        """Make a polynomial of terms of which some may be zero."""
        return cls((monomial, value) for monomial, value in terms.items() if value)

    # A check of annotations at run time, as in the tests, would take most of a derivation's time.
    @no_type_check
    def __add__(self, other: Any) -> Any:
        return self._plus(other, 1)

    @no_type_check
    def __radd__(self, other: Any) -> Any:
        return self._plus(other, 1)

    @no_type_check
    def __sub__(self, other: Any) -> Any:
        return self._plus(other, -1)

    @no_type_check
    def __rsub__(self, other: Any) -> Any:
        return (-self)._plus(other, 1)

    @no_type_check
    def __neg__(self) -> "SparsePolynomial":
        return SparsePolynomial((monomial, -value) for monomial, value in self.items())

    @no_type_check
    def __mul__(self, other: Any) -> "SparsePolynomial":
        if not isinstance(other, SparsePolynomial):
            return self.without_zeros({monomial: value * other for monomial, value in self.items()})
        result = {}
        for one, factor in self.items():
            for two, value in other.items():
                monomial = tuple(map(int.__add__, one, two))
                result[monomial] = result.get(monomial, 0) + factor * value
        return self.without_zeros(result)

    __rmul__ = __mul__

    @no_type_check
    def __pow__(self, power: int) -> Any:
        return math.prod([self] * power, start=fmpq(1))

    @no_type_check
    def __eq__(self, other: object) -> bool:
        if isinstance(other, dict):
            return dict.__eq__(self, other)
        return not self and other == 0

    __hash__ = None

    @no_type_check
    def _plus(self, other: Any, sign: int) -> Any:
        result = SparsePolynomial(self)
        if not isinstance(other, SparsePolynomial):
            if not other:
                return result
            if not self:  # of how many generators is not known, and a number is as good
                return sign * other
            other = {(0,) * len(next(iter(self))): fmpq(other)}
        _add_multiple(result, sign, other)
        return result


def _add_multiple(total: dict[Any, Any], factor: Any, form: dict[Any, Any]) -> None:
    """Add a multiple of a sum's terms to another's, in place; terms that cancel are deleted."""
    for key, value in form.items():
        new = total.get(key, 0) + factor * value
        if new:
            total[key] = new
        else:
            del total[key]


@dataclass(frozen=True, eq=False)
class PositionRing:
    """Polynomials in the position of a robot, with rational coefficients.

    Its generators are, in this order: cosine and sine of every independent angle, the variable
    of every prismatic joint, and the named constants (lengths and gravity) that are kept
    symbolic. In normal form the power of a sine is 0 or 1, s² being 1 - c². Then two functions
    of the position are equal exactly if their polynomials are: cosines and sines of independent
    angles satisfy no other relation.
    """

    chain: Chain
    constants: tuple[str, ...]

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names of the position-dependent generators: `c2`, `s2`, `c23`, ..., `q3`."""
        names = [f"{function}{angle.label}" for angle in self.chain.angles for function in "cs"]
        return (*names, *(f"q{joint + 1}" for joint in self._prismatic))

    @cached_property
    def _prismatic(self) -> tuple[int, ...]:
        return tuple(i for i, link in enumerate(self.chain.links) if link.prismatic)

    @cached_property
    def _generators(self) -> tuple[SparsePolynomial, ...]:
        count = len(self.variables) + len(self.constants)
        return tuple(SparsePolynomial.generator(index, count) for index in range(count))

    @property
    def cosines(self) -> Sequence[Any]:
        return self._generators[0 : 2 * len(self.chain.angles) : 2]

    @property
    def sines(self) -> Sequence[Any]:
        return self._generators[1 : 2 * len(self.chain.angles) : 2]

    def joint_variable(self, joint: int) -> Any:
        """Return the variable of a prismatic joint, joints counted from 0."""
        return self._generators[2 * len(self.chain.angles) + self._prismatic.index(joint)]

    def constant(self, name: str) -> Any:
        return self._generators[len(self.variables) + self.constants.index(name)]

    def normal_form(self, polynomial: Any) -> Any:
        """Return the same function with every s² replaced by 1 - c²."""
        if not isinstance(polynomial, SparsePolynomial):  # a plain number
            return polynomial
        for angle in range(len(self.chain.angles)):
            cos, sin = 2 * angle, 2 * angle + 1
            while any(monomial[sin] > 1 for monomial in polynomial):
                polynomial = self._without_square(polynomial, cos, sin)
        return polynomial

    @staticmethod
    def _without_square(polynomial: SparsePolynomial, cos: int, sin: int) -> SparsePolynomial:
        result: dict[Monomial, Any] = {}
        for monomial, coefficient in polynomial.items():
            if monomial[sin] < 2:
                result[monomial] = result.get(monomial, 0) + coefficient
                continue
            row = list(monomial)
            row[sin] -= 2
            for factor in (coefficient, -coefficient):  # s² = 1 - c²
                key = tuple(row)
                result[key] = result.get(key, 0) + factor
                row[cos] += 2
        return SparsePolynomial.without_zeros(result)

    def derivative(self, polynomial: dict[Monomial, Any], joint: int) -> dict[Monomial, Any]:
        """Partial derivative of a normal form with respect to a joint variable, in normal form.

        `polynomial` maps monomials to forms, themselves dictionaries of rationals. A joint turns
        c into -s and s into c in every angle that contains it.
        """
        result: dict[Monomial, dict[Any, Any]] = {}

        def put(monomial: list[int], form: dict[Any, Any], factor: int) -> None:
            _add_multiple(result.setdefault(tuple(monomial), {}), factor, form)

        for angle, sign in self._angles_in(joint):
            cos, sin = 2 * angle, 2 * angle + 1
            for monomial, form in polynomial.items():
                power = monomial[cos]
                if monomial[sin] == 0:
                    if power:
                        row = list(monomial)
                        row[cos], row[sin] = power - 1, 1
                        put(row, form, -sign * power)
                else:  # d(c^p s) = c^(p+1) - p c^(p-1) s² = (p + 1) c^(p+1) - p c^(p-1)
                    row = list(monomial)
                    row[cos], row[sin] = power + 1, 0
                    put(row, form, sign * (power + 1))
                    if power:
                        row[cos] = power - 1
                        put(row, form, -sign * power)
        if joint in self._prismatic:
            at = 2 * len(self.chain.angles) + self._prismatic.index(joint)
            for monomial, form in polynomial.items():
                if monomial[at]:
                    row = list(monomial)
                    row[at] -= 1
                    put(row, form, monomial[at])
        return {monomial: form for monomial, form in result.items() if form}

    def _angles_in(self, joint: int) -> list[tuple[int, int]]:
        return [
            (index, sign)
            for index, angle in enumerate(self.chain.angles)
            for member, sign in angle.terms
            if member == joint
        ]

    def label(self, monomial: Monomial) -> str:
        """Return a product as it is printed: `"c23*s4*c5^2"`, and `"1"` for the constant."""
        return product_text(zip(self.variables, monomial, strict=True)) or "1"

    def parse(self, label: str) -> Monomial | None:
        """Return the monomial that `label` names, factors in any order; None if it is not one."""
        powers = dict.fromkeys(self.variables, 0)
        for factor in [] if label == "1" else label.split("*"):
            name, _, power = factor.partition("^")
            if name not in powers or not (power or "1").isdigit():
                return None
            powers[name] += int(power or 1)
        return tuple(powers[name] for name in self.variables)

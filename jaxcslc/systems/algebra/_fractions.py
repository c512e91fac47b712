"""Rational functions of generators in normal form, modulo their relations."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from ._generators import Generators


Monomial = tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Fraction:
    """A rational function of generators, in normal form: two polynomials over the rationals."""

    numerator: Any
    denominator: Any


class FractionField:
    """Rational functions of generators with rational coefficients, modulo their relations.

    Sparse polynomials of SymPy, as in `jaxcslc.derivation`. Generators of variables come first, so
    that a monomial is what multiplies coefficients, followed by a product of constants.

    **Attributes**

    - `variables`, `constants`: the generators, in the order of the exponents of monomials.
    """

    def __init__(self, generators: Generators) -> None:
        from sympy import QQ
        from sympy.polys.rings import ring

        symbols = list(generators.values)
        self.variables = [x for x in symbols if not generators.is_constant(x)]
        self.constants = [x for x in symbols if generators.is_constant(x)]
        self.values = generators.values
        names = [*self.variables, *self.constants] or ["x"]  # no ring is without a generator
        self.ring, *elements = ring(names, QQ)
        self._element = dict(zip(names, elements, strict=True))
        self._relations: list[tuple[int, int, Any]] = []
        for relation in generators.relations:
            value = self._of(relation.value)
            if value.denominator == 1:
                index = names.index(relation.generator)
                self._relations.append((index, relation.power, value.numerator))

    def of(self, expression: Any) -> Fraction:
        """An expression that `Generators.rational` made, in normal form."""
        fraction = self._of(expression)
        numerator, denominator = map(self.normal_form, (fraction.numerator, fraction.denominator))
        if denominator == 1:
            return Fraction(numerator, denominator)
        return Fraction(*numerator.cancel(denominator))

    def normal_form(self, polynomial: Any) -> Any:
        """Return an equal polynomial without the powers that relations replace."""
        changed = True
        while changed:
            changed = False
            for index, power, value in self._relations:
                while any(monomial[index] >= power for monomial in polynomial):
                    polynomial = self._replaced(polynomial, index, power, value)
                    changed = True
        return polynomial

    def _replaced(self, polynomial: Any, index: int, power: int, value: Any) -> Any:
        kept: dict[Monomial, Any] = {}
        lowered: dict[Monomial, Any] = {}
        for monomial, coefficient in polynomial.items():
            if monomial[index] < power:
                kept[monomial] = coefficient
            else:
                row = list(monomial)
                row[index] -= power
                lowered[tuple(row)] = coefficient
        ring = self.ring
        return ring.from_dict(kept) + ring.from_dict(lowered) * value

    def parts(self, polynomial: Any) -> dict[Monomial, dict[Monomial, Any]]:
        """Return the factor of each product of variables: a polynomial of constants."""
        split = len(self.variables)
        parts: dict[Monomial, dict[Monomial, Any]] = {}
        for monomial, coefficient in polynomial.items():
            parts.setdefault(monomial[:split], {})[self._constants_of(monomial)] = coefficient
        return parts

    def _constants_of(self, monomial: Monomial) -> Monomial:
        return monomial[len(self.variables) : len(self.variables) + len(self.constants)]

    def of_constants(self, part: dict[Monomial, Any]) -> Any:
        """A polynomial of constants as an element of the ring."""
        none = (0,) * len(self.variables)
        return self.ring.from_dict({(*none, *monomial): x for monomial, x in part.items()})

    def factors(self, polynomial: Any) -> tuple[Any, Any, Any]:
        """A polynomial as a product: of variables, of constants, and of factors of both."""
        split = len(self.variables)
        one = self.ring.one
        parts = [one, one, one]
        if polynomial.is_ground:
            return polynomial, one, one
        content, factors = polynomial.factor_list()
        for factor, multiplicity in factors:
            in_variables = any(any(monomial[:split]) for monomial in factor)
            in_constants = any(any(monomial[split:]) for monomial in factor)
            index = 2 if in_variables and in_constants else 1 if in_constants else 0
            parts[index] *= factor**multiplicity
        return parts[0] * content, parts[1], parts[2]

    def quotient(self, polynomial: Any, divisor: Any) -> Any:
        """A polynomial over another as an expression of the original symbols."""
        if len(divisor) == 1:
            ((powers, factor),) = divisor.items()
            return self._expression(polynomial, powers, factor)
        return self.expression(polynomial) / self.expression(divisor)

    def expression(self, polynomial: Any) -> Any:
        """A polynomial as an expression of the original symbols."""
        return self.quotient(polynomial, self.ring.one)

    def _expression(self, polynomial: Any, below: Monomial, divisor: Any) -> Any:
        from sympy import Add, Mul, Rational

        values = [self.values[x] for x in (*self.variables, *self.constants)]
        terms: list[Any] = []
        for monomial, coefficient in polynomial.items():
            factor = coefficient / divisor
            powers = (above - minus for above, minus in zip(monomial, below, strict=True))
            factors = (x**n for x, n in zip(values, powers, strict=False) if n)
            terms.append(Mul(Rational(int(factor.numerator), int(factor.denominator)), *factors))
        return Add(*terms)

    def _of(self, expression: Any) -> Fraction:
        ring = self.ring
        if expression.is_Rational:
            return Fraction(
                ring.ground_new(ring.domain(int(expression.p), int(expression.q))), ring.one
            )
        if expression.is_Symbol:
            return Fraction(self._element[expression], ring.one)
        if expression.is_Pow:
            base, power = self._of(expression.base), int(expression.exp)
            if power < 0:
                base, power = Fraction(base.denominator, base.numerator), -power
            return Fraction(base.numerator**power, base.denominator**power)
        parts = [self._of(argument) for argument in expression.args]
        return self._product(parts) if expression.is_Mul else self._sum(parts)

    def _product(self, parts: Sequence[Fraction]) -> Fraction:
        numerator = denominator = self.ring.one
        for part in parts:
            numerator = self.normal_form(numerator * part.numerator)
            denominator *= part.denominator
        return Fraction(numerator, denominator)

    def _sum(self, parts: Sequence[Fraction]) -> Fraction:
        by_denominator: dict[Any, Any] = {}
        for part in parts:
            total = by_denominator.get(part.denominator, self.ring.zero)
            by_denominator[part.denominator] = total + part.numerator
        numerator, common = self.ring.zero, self.ring.one
        for denominator, total in by_denominator.items():
            if denominator == common:
                numerator += total
                continue
            joint = common.lcm(denominator)
            numerator = numerator * joint.exquo(common) + total * joint.exquo(denominator)
            common = joint
        return Fraction(numerator, common)

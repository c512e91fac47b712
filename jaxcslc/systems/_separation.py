"""Separation of known variables from unknown constants: the third stage (C.1.4, C.2).

Equations become rational functions of generators (`_generators`), modulo their relations. What
multiplies products of variables is written in a basis, the coefficients.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy
from flint import fmpq, fmpq_mat
from jaxtyping import Float, Inexact
from sympy import QQ, Add, Dummy, Rational, lambdify
from sympy.polys.fields import field

from .._text_table import text_table
from ..derivation import Basis, Coefficient, product_text, sum_text
from ._constants import ConstantIdentifiability, determine_identifiability, independent
from ._description import DescriptionError, unit_product
from ._generators import Generators


if TYPE_CHECKING:
    from ._system import System


Monomial = tuple[int, ...]


class FractionField:
    """Rational functions of generators with rational coefficients, modulo their relations.

    Generators of variables come first, so that a monomial is what multiplies coefficients,
    followed by a product of constants.

    **Attributes**

    - `variables`, `constants`: the generators, in the order of the exponents of monomials.
    - `values`: the expression that each generator stands for.
    """

    def __init__(self, generators: Generators) -> None:
        symbols = list(generators.values)
        self.variables = [x for x in symbols if not generators.is_constant(x)]
        self.constants = [x for x in symbols if generators.is_constant(x)]
        self.values = generators.values
        names = [*self.variables, *self.constants] or [Dummy()]  # no ring is without a generator
        self._expressions = [self.values.get(name, name) for name in names]
        self.field = field(names, QQ)[0]
        self.ring = self.field.ring
        self._relations: list[tuple[int, int, Any]] = []
        for generator, power, expression in generators.relations:
            value = self.field.from_expr(expression)
            if value.denom.is_ground:
                replacement = value.numer.quo_ground(value.denom.LC)
                self._relations.append((names.index(generator), power, replacement))

    def fraction(self, expression: Any) -> tuple[Any, Any]:
        """Return numerator and denominator, in normal form, of what `Generators.rational` made."""
        fraction = self.field.from_expr(expression)
        numerator, denominator = map(self.normal_form, (fraction.numer, fraction.denom))
        if denominator.is_ground:
            return numerator.quo_ground(denominator.LC), self.ring.one
        return numerator.cancel(denominator)

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
        kept, lowered = self.ring.zero, self.ring.zero
        for monomial, coefficient in polynomial.items():
            if monomial[index] < power:
                kept[monomial] = coefficient
            else:
                row = list(monomial)
                row[index] -= power
                lowered[tuple(row)] = coefficient
        return kept + lowered * value

    def parts(self, polynomial: Any) -> dict[Monomial, "Form"]:
        """Return the factor of each product of variables: a polynomial of constants."""
        split, end = len(self.variables), len(self.variables) + len(self.constants)
        parts: dict[Monomial, Form] = {}
        for monomial, coefficient in polynomial.items():
            parts.setdefault(monomial[:split], {})[monomial[split:end]] = coefficient
        return parts

    def product(self, product: Monomial, factor: Any) -> Any:
        """Return a product of variables, times a rational, as an element of the ring."""
        monomial = (*product, *(0,) * len(self.constants)) or (0,)
        return self.ring.from_dict({monomial: self._rational(factor)})

    def polynomial(self, form: "Form") -> Any:
        """Return a polynomial of constants as an element of the ring."""
        none = (0,) * len(self.variables)
        return self.ring.from_dict({(*none, *m): self._rational(x) for m, x in form.items()})

    def _rational(self, x: Any) -> Any:
        return QQ(int(x.numerator), int(x.denominator))

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

    def expression(self, polynomial: Any) -> Any:
        """Return a polynomial as an expression of the original symbols."""
        return polynomial.as_expr(*self._expressions)

    def quotient(self, polynomial: Any, divisor: Any) -> Any:
        """Return a polynomial over another as an expression; term by term over a product."""
        numerator, denominator = self.expression(polynomial), self.expression(divisor)
        if len(divisor) > 1:
            return numerator / denominator
        return Add(*(term / denominator for term in Add.make_args(numerator)))


Form = dict[Monomial, Any]
# Fractions of larger denominators are printed as decimals.
_LONGEST_DENOMINATOR = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Separation:
    """Known variables apart from unknown constants: the third stage (thesis C.1.4, C.2).

    Each equation reads

        known(variables) = sum of regressor(variables) * coefficient(constants).

    Coefficients are the fewest of which every product of constants in the equations is a rational
    combination; functions that multiply them are linearly independent. Both are exact.

    `print` shows equations, coefficients and what can't be told apart.

    **Attributes**

    - `outputs`: names of the equations.
    - `coefficients`: a coefficient that is one constant has its name, others are `k1`, `k2`, ...
      by their index in `k`, counted from 1.
    - `regressor`: for each equation and coefficient the SymPy expression that multiplies it.
    - `known`: for each equation what multiplies no unknown constant.
    - `notes`: what was done to equations, a sentence each.

    >>> import sympy
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Constant, System, Variable
    >>> theta, u = dynamicsymbols("theta u")
    >>> m, l, b, g = sympy.symbols("m l b g")
    >>> equation = sympy.Eq(u, m*l**2*theta.diff().diff() + b*theta.diff() + m*g*l*sympy.sin(theta))
    >>> pendulum = System(
    ...     "pendulum", {"pivot": equation}, (Variable(theta, "rad"), Variable(u, "N m")),
    ...     (Constant(m, "kg"), Constant(l, "m"), Constant(b), Constant(g, "m/s²", value=9.81)),
    ... )
    >>> print(pendulum.separation)
    pivot: u = k1*9.81*sin(theta) + b*dot(theta) + k3*ddot(theta)
    name  unit   expression
    k1    kg m   m*l
    b            b
    k3    kg m²  m*l^2
    """

    outputs: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    regressor: tuple[tuple[Any, ...], ...]
    known: tuple[Any, ...]
    order_per_output: tuple[int, ...]
    notes: tuple[str, ...]
    formulas: tuple[Any, ...]
    symbols: Mapping[str, Any]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @cached_property
    def identifiability(self) -> tuple[ConstantIdentifiability, ...]:
        """The identifiability of each unknown constant."""
        return determine_identifiability(self)

    def values(self, constants: Mapping[str, float]) -> Float[np.ndarray, " coefficients"]:
        """Return the coefficients of a system whose constants are known.

        **Arguments**

        - `constants`: a value for each unknown constant, by name; others are ignored.

        **Returns** `k`, (p,).

        **Raises** `DescriptionError` for a constant without a value.
        """
        missing = [name for name in self.symbols if name not in constants]
        if missing:
            raise DescriptionError(f"constants: no value of {', '.join(missing)}")
        return self.evaluate(np.array([float(constants[name]) for name in self.symbols]))

    def evaluate(
        self, constants: Inexact[np.ndarray, "constants ..."]
    ) -> Inexact[np.ndarray, "coefficients ..."]:
        """Return the coefficients for arrays of the unknown constants, in the order of `symbols`.

        Complex numbers are taken too, for derivatives by complex steps.
        """
        shape = constants.shape[1:]
        return np.stack([np.broadcast_to(x, shape) for x in self._function(*constants)])

    def __str__(self) -> str:
        rows = [[c.name, c.unit, c.expression] for c in self.coefficients]
        lines = [
            *(self._equation(i) for i in range(len(self.outputs))),
            text_table(["name", "unit", "expression"], rows, left=("unit", "expression")),
            *(str(row) for row in self.identifiability if row.verdict != "alone"),
            *self.notes,
        ]
        return "\n".join(lines)

    def _equation(self, index: int) -> str:
        text = ""
        for name, expression in zip(self.names, self.regressor[index], strict=True):
            if expression != 0:
                negative = expression.could_extract_minus_sign()
                size = str(_readable(-expression if negative else expression))
                term = (
                    name if size == "1" else f"{name}*({size})" if " " in size else f"{name}*{size}"
                )
                sign = "-" if negative else "+"
                text += f" {sign} {term}" if text else f"{'-' if negative else ''}{term}"
        return f"{self.outputs[index]}: {_readable(self.known[index])} = {text or 0}"

    @cached_property
    def _function(self) -> Any:
        symbols = list(self.symbols.values())
        return lambdify(symbols, list(self.formulas), modules="numpy", cse=True)


def separate(system: "System") -> Separation:
    """Separates the equations of a system.

    Multiples of an angle are angles of their own, unless functions of them turn out to depend on
    powers of those of the angle itself, as in `sin(2*x)` next to `sin(x)*cos(x)`: then larger and
    larger multiples are expanded.

    **Raises** `DescriptionError` for an equation in which unknown constants enter nonlinearly, and
    for equations that leave nothing to identify or are true of any multiple of the coefficients.
    """
    separation = _separated(system, 1)
    # Of an angle whose functions occur, how many times it is expanded into powers of them.
    for largest_multiple in (2, 4, 8):
        if independent(system, separation.regressor):
            return separation
        separation = _separated(system, largest_multiple)
    if independent(system, separation.regressor):
        return separation
    note = (
        "functions of the variables are linearly dependent in a way that the algebra does not see:"
        " some coefficients are determined in combinations only, which a fit will name"
    )
    return dataclasses.replace(separation, notes=(*separation.notes, note))


def _separated(system: "System", largest_multiple: int) -> Separation:
    """Separate with multiples of angles expanded up to the largest."""
    unknown = {c.name: system.symbols.constants[c.name] for c in system.unknown}
    sides = [(f"equation {name!r}", left - right) for name, (left, right) in system.numeric.items()]
    generators = Generators(sides, unknown.values(), largest_multiple)
    expressions = [generators.rational(where, x) for where, x in sides]
    field = FractionField(generators)
    numerators, divisors, common, notes = _cleared(system, field, expressions)
    known, rows = _known_apart(field, numerators, common)
    if not any(known):
        raise DescriptionError(
            f"system {system.name!r}: every term of every equation has an unknown constant, so that"
            " any multiple of a solution is one; expected a known term, such as a measured force,"
            " or the value of one constant"
        )
    if not rows:
        raise DescriptionError(
            f"system {system.name!r}: no equation depends on an unknown constant; expected one"
        )
    basis = Basis((form for *_, form in rows), lambda form: _text(field, form))
    # A coefficient's first constant counts once, so that numbers stay with the variables; and what
    # signs of constants make negative changes its sign.
    leading = [form[max(form)] for form in basis.forms]
    factors = [
        _sign(field, form) * abs(first) or first
        for form, first in zip(basis.forms, leading, strict=True)
    ]
    forms = [
        {key: value / factor for key, value in form.items()}
        for form, factor in zip(basis.forms, factors, strict=True)
    ]
    entries = [[field.ring.zero] * len(forms) for _ in known]
    combinations: list[list[list[Any]]] = [[] for _ in known]
    for index, product, form in rows:
        parts = basis.combination(form)
        combination = [parts.get(j, fmpq(0)) * factor for j, factor in enumerate(factors)]
        combinations[index].append(combination)
        for j, multiple in enumerate(combination):
            if multiple:
                entries[index][j] += field.product(product, multiple)
    formulas = tuple(field.quotient(field.polynomial(form), common) for form in forms)
    coefficients = tuple(
        _coefficient(system, field, form, formula, index, common)
        for index, (form, formula) in enumerate(zip(forms, formulas, strict=True), start=1)
    )
    return Separation(
        outputs=tuple(system.numeric),
        coefficients=coefficients,
        regressor=tuple(
            tuple(field.quotient(entry, divisor) for entry in row)
            for row, divisor in zip(entries, divisors, strict=True)
        ),
        known=tuple(map(field.quotient, known, divisors)),
        order_per_output=tuple(fmpq_mat(rows).rank() if rows else 0 for rows in combinations),
        notes=tuple(notes),
        formulas=formulas,
        symbols=unknown,
    )


def _cleared(
    system: "System", field: FractionField, expressions: Sequence[Any]
) -> tuple[list[Any], list[Any], Any, list[str]]:
    """Multiply equations by their denominators, those of variables alone apart.

    **Returns** numerators, a divisor made of variables for each, the constants that all are
    multiplied by, and a note on each equation that both have multiplied.
    """
    notes: list[str] = []
    split: list[tuple[Any, Any, Any]] = []
    common = field.ring.one
    for name, (numerator, denominator) in zip(
        system.numeric, map(field.fraction, expressions), strict=True
    ):
        of_variables, of_constants, of_both = field.factors(denominator)
        split.append((numerator, of_variables, of_constants))
        common = common.lcm(of_constants)
        if of_both != 1:
            notes.append(
                f"equation {name!r} is multiplied by {field.expression(of_both)}, which has both"
                " variables and unknown constants"
            )
    numerators = [numerator * common.exquo(constants) for numerator, _, constants in split]
    return numerators, [divisor for _, divisor, _ in split], common, notes


def _known_apart(
    field: FractionField, numerators: Sequence[Any], common: Any
) -> tuple[list[Any], list[tuple[int, Monomial, Form]]]:
    """Return what multiplies `common` alone in each equation, and the rows of all else.

    A row is an equation, a product of variables, and the form in constants that multiplies it.
    """
    rows: list[tuple[int, Monomial, Form]] = []
    known: list[Any] = []
    (unit_form,) = field.parts(common).values()
    lead = min(unit_form)
    for index, numerator in enumerate(numerators):
        known.append(field.ring.zero)
        for product, form in field.parts(numerator).items():
            multiple = form.get(lead, QQ(0)) / unit_form[lead]
            known[index] += field.product(product, multiple)
            unknown_part = {
                key: fmpq(-int(value.numerator), int(value.denominator))
                for key in {**form, **unit_form}
                if (value := form.get(key, QQ(0)) - multiple * unit_form.get(key, QQ(0)))
            }
            if unknown_part:
                rows.append((index, product, unknown_part))
    return known, rows


def _readable(expression: Any) -> Any:
    """Replace long fractions by decimals."""
    long = {x: sympy.Float(x, 6) for x in expression.atoms(Rational) if x.q > _LONGEST_DENOMINATOR}
    return expression.xreplace(long)


def _ordered(form: Form) -> list[tuple[Monomial, Any]]:
    """The addends of a form, those of constants that were described first before others."""
    return sorted(form.items(), reverse=True)


def _sign(field: FractionField, form: Form) -> int:
    """The sign of a form, 1 or -1, if the signs of its constants decide it, and otherwise 0."""
    signs = set[int]()
    for monomial, factor in form.items():
        sign = 1 if factor > 0 else -1
        for generator, power in zip(field.constants, monomial, strict=True):
            value = field.values[generator]
            if power % 2 and not value.is_positive:
                sign *= -1 if value.is_negative else 0
        signs.add(sign)
    return signs.pop() if len(signs) == 1 else 0


def _text(field: FractionField, form: Form) -> str:
    """Return a form as it is printed, its rationals as decimals: `"M + 0.5*m"`."""
    names = [str(field.values[generator]) for generator in field.constants]
    return sum_text(
        (factor, product_text(zip(names, monomial, strict=True)))
        for monomial, factor in _ordered(form)
    )


def _coefficient(
    system: "System", field: FractionField, form: Form, formula: Any, index: int, common: Any
) -> Coefficient:
    text, name = _text(field, form), f"k{index}"
    ((monomial, factor), *others) = _ordered(form)
    if common == 1 and not others and factor == 1 and sum(monomial) == 1:
        value = field.values[field.constants[monomial.index(1)]]
        name = str(value) if value.is_Symbol else name
    if common != 1:
        text = str(formula.cancel()).replace("**", "^")
    units = {constant.name: constant.unit for constant in system.unknown}
    divisor = max(common)[len(field.variables) :] if common != 1 else (0,) * len(monomial)
    powers = [
        (units.get(str(field.values[generator]), ""), power - below)
        for generator, power, below in zip(field.constants, monomial, divisor, strict=False)
        if power != below
    ]
    sign = _sign(field, form)
    return Coefficient(name, "system", text, unit_product(powers), sign == 1)

"""Separation of known variables from unknown constants: the third stage (C.1.4, C.2)."""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import fmpq, fmpq_mat
from jaxtyping import Float, Inexact

from jaxcslc._text_table import text_table
from jaxcslc.derivation import Basis, Coefficient

from ..description import DescriptionError, product_of_units
from ._fractions import FractionField, Monomial
from ._generators import Generators
from ._identifiability import ConstantIdentifiability, identifiability_of, independent


if TYPE_CHECKING:
    from .._system import System


Form = dict[Monomial, Any]
# Of an angle whose functions occur, how many times it is expanded into powers of them.
_LARGER_MULTIPLES = (2, 4, 8)
# Fractions of larger ones are printed as decimals.
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
    - `identifiability`: of each unknown constant.
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
    identifiability: tuple[ConstantIdentifiability, ...]
    notes: tuple[str, ...]
    formulas: tuple[Any, ...]
    symbols: Mapping[str, Any]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    def values(self, constants: Mapping[str, float]) -> Float[np.ndarray, " coefficients"]:
        """The coefficients of a system whose constants are known.

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
        """The coefficients for arrays of the unknown constants, in the order of `symbols`.

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
        from sympy import lambdify

        symbols = list(self.symbols.values())
        return lambdify(symbols, list(self.formulas), modules="numpy", cse=True)


def separate(system: "System") -> Separation:
    """Separates the equations of a system.

    Multiples of an angle are angles of their own, unless functions of them turn out to depend on
    powers of those of the angle itself, as in `sin(2*x)` beside `sin(x)*cos(x)`: then larger and
    larger multiples are expanded.

    **Raises** `DescriptionError` for an equation in which unknown constants enter nonlinearly, and
    for equations that leave nothing to identify or are true of any multiple of the coefficients.
    """
    separation = _separated(system, 1)
    for largest_multiple in _LARGER_MULTIPLES:
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
    from sympy import Integer

    symbols = system.symbols
    unknown = {c.name: symbols.constants[c.name] for c in system.unknown}
    sides = [(f"equation {name!r}", left - right) for name, (left, right) in system.numeric.items()]
    generators = Generators(sides, unknown.values(), largest_multiple)
    expressions = [generators.rational(where, x) for where, x in sides]
    field = FractionField(generators)
    residuals = [field.of(expression) for expression in expressions]
    notes: list[str] = []
    divisors: list[tuple[Any, Any]] = []  # of variables, and of constants
    for name, residual in zip(system.numeric, residuals, strict=True):
        of_variables, of_constants, of_both = field.factors(residual.denominator)
        divisors.append((of_variables, of_constants))
        if of_both != 1:
            notes.append(
                f"equation {name!r} is multiplied by {field.expression(of_both)}, which has both"
                " variables and unknown constants"
            )
    no_constants = (0,) * len(field.constants)
    common = field.ring.one
    for _, of_constants in divisors:
        common = common.lcm(of_constants)

    rows: list[tuple[int, Monomial, Form]] = []  # equation, product of variables, constants
    known: list[Any] = []
    (unit_form,) = field.parts(common).values()
    lead = min(unit_form)
    for index, (residual, (_, of_constants)) in enumerate(zip(residuals, divisors, strict=True)):
        numerator = residual.numerator * common.exquo(of_constants)
        known_part = field.ring.zero
        for product, form in field.parts(numerator).items():
            multiple = form.get(lead, 0) / unit_form[lead]
            if multiple:
                known_part += field.ring.from_dict({(*product, *no_constants): multiple})
            unknown_part = {
                key: value
                for key in {**form, **unit_form}
                if (value := form.get(key, 0) - multiple * unit_form.get(key, 0))
            }
            if unknown_part:
                rows.append((index, product, {k: _exact(-x) for k, x in unknown_part.items()}))
        known.append(field.quotient(known_part, divisors[index][0]))
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
    factors = [_leading(form) * _known_sign(field, form) for form in basis.forms]
    forms = [
        {key: value / factor for key, value in form.items()}
        for form, factor in zip(basis.forms, factors, strict=True)
    ]
    entries: dict[tuple[int, int], Any] = {}
    combinations: dict[int, list[list[Any]]] = {}
    for index, product, form in rows:
        parts = basis.combination(form)
        combination = [parts.get(j, fmpq(0)) * factor for j, factor in enumerate(factors)]
        combinations.setdefault(index, []).append(combination)
        for j, multiple in enumerate(combination):
            if multiple:
                term = field.ring.from_dict({(*product, *no_constants): _in_ring(field, multiple)})
                entries[index, j] = entries.get((index, j), field.ring.zero) + term
    formulas = tuple(
        field.quotient(
            field.of_constants({key: _in_ring(field, x) for key, x in form.items()}), common
        )
        for form in forms
    )
    coefficients = tuple(
        _coefficient(system, field, form, formula, index, common)
        for index, (form, formula) in enumerate(zip(forms, formulas, strict=True), start=1)
    )
    return Separation(
        outputs=tuple(system.numeric),
        coefficients=coefficients,
        regressor=tuple(
            tuple(
                field.quotient(entries[i, j], divisors[i][0]) if (i, j) in entries else Integer(0)
                for j in range(len(forms))
            )
            for i in range(len(known))
        ),
        known=tuple(known),
        order_per_output=tuple(
            fmpq_mat(combinations[i]).rank() if i in combinations else 0 for i in range(len(known))
        ),
        identifiability=identifiability_of(unknown, formulas, coefficients),
        notes=tuple(notes),
        formulas=formulas,
        symbols=unknown,
    )


def _readable(expression: Any) -> Any:
    """Replace long fractions by decimals."""
    from sympy import Float, Rational

    long = {x: Float(x, 6) for x in expression.atoms(Rational) if x.q > _LONGEST_DENOMINATOR}
    return expression.xreplace(long)


def _in_ring(field: FractionField, x: Any) -> Any:
    return field.ring.domain(int(x.numerator), int(x.denominator))


def _exact(x: Any) -> Any:
    return fmpq(int(x.numerator), int(x.denominator))


def _ordered(form: Form) -> list[tuple[Monomial, Any]]:
    """The addends of a form, those of constants that were described first before others."""
    return sorted(form.items(), reverse=True)


def _leading(form: Form) -> Any:
    return _ordered(form)[0][1]


def _known_sign(field: FractionField, form: Form) -> int:
    """-1 for a form that the signs of its constants make negative once its first one counts +1."""
    positive = 1 if _leading(form) > 0 else -1
    return -1 if _sign(field, form) * positive == -1 else 1


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
    """A form as it is printed, its rationals as decimals: `"M + 0.5*m"`."""
    text = ""
    for monomial, factor in _ordered(form):
        size = abs(factor)
        names = [
            str(field.values[generator]) + ("" if power == 1 else f"^{power}")
            for generator, power in zip(field.constants, monomial, strict=True)
            if power
        ]
        number = (
            str(size.numerator)
            if size.denominator == 1
            else repr(int(size.numerator) / int(size.denominator))
        )
        parts = "*".join([*([] if size == 1 and names else [number]), *names])
        sign = "-" if factor < 0 else "+"
        text += f" {sign} {parts}" if text else f"{'-' if sign == '-' else ''}{parts}"
    return text


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
    return Coefficient(name, "system", text, product_of_units(powers), sign == 1)

"""Variables and constants of a system: their units, and their plain symbols in equations."""

import dataclasses
import math
import re
from collections.abc import Sequence
from typing import Any

from sympy import Derivative, Float, Rational, Symbol, sympify
from sympy.core.function import AppliedUndef


class DescriptionError(ValueError):
    """A system that is described wrongly; the message is one line: where, what, what was expected.

    >>> from jaxcslc.systems import DescriptionError
    >>> issubclass(DescriptionError, ValueError)
    True
    """


_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_DIGITS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
# A unit with a power: m, m², m^2, m^-1, kg.
_FACTOR = re.compile(r"([A-Za-zµΩ°%]+)(?:\^?(-?\d+))?")

Unit = dict[str, int]


def parse_unit(text: str, where: str = "") -> Unit:
    """Return a unit as powers of its factors; what follows a slash divides.

    `"kg m²/s"` is `{"kg": 1, "m": 2, "s": -1}`. **Raises** `DescriptionError` for a text that is
    no unit.
    """
    powers: Unit = {}
    for number, part in enumerate(text.translate(_SUPERSCRIPTS).split("/")):
        for factor in part.replace("*", " ").replace("·", " ").split():
            match = _FACTOR.fullmatch(factor)
            if match is not None:
                power = int(match[2] or 1) * (1 if number == 0 else -1)
                powers[match[1]] = powers.get(match[1], 0) + power
            elif factor != "1":
                raise DescriptionError(
                    f"{where}: unit {text!r}: cannot read {factor!r}; expected as in 'kg m²/s'"
                )
    return {name: power for name, power in powers.items() if power}


def unit_text(unit: Unit) -> str:
    """Return a unit as it is printed: `"kg m²/s"`, `"1/s²"`."""

    def factors(sign: int) -> str:
        return " ".join(
            name if sign * power == 1 else name + str(sign * power).translate(_DIGITS)
            for name, power in unit.items()
            if sign * power > 0
        )

    above, below = factors(1), factors(-1)
    return above if not below else f"{above or 1}/{below.replace(' ', '/')}"


def unit_product(factors: Sequence[tuple[str, int]]) -> str:
    """Return the unit of a product of quantities, each with its power.

    Angles are numbers: a radian is no factor of a product.
    """
    powers: Unit = {}
    for text, power in factors:
        for name, exponent in parse_unit(text).items():
            powers[name] = powers.get(name, 0) + exponent * power
    if len(factors) > 1:
        powers.pop("rad", None)
    return unit_text(powers)


@dataclasses.dataclass(frozen=True)
class Variable:
    """Variable that is measured, or follows from what is measured: a state, or an input.

    Equations contain it and its first two time derivatives.

    **Attributes**

    - `symbol`: a function of time, as `sympy.physics.mechanics.dynamicsymbols` makes it, or a
      SymPy symbol if no equation contains a derivative of it.
    - `unit`: SI.
    - `column`: of a recording; the name of the symbol if omitted.
    - `rate`, `second_rate`: columns that hold measured first and second derivatives. What is not
      measured is obtained by smoothing and differentiating.
    - `kind`: `"state"`: smoothed and differentiated; `"input"`: taken as recorded, like the torque
      of a robot. If omitted, a state if equations contain a derivative of it, or if one is
      measured, and otherwise an input.

    **Raises** `DescriptionError` for a symbol that is none, or a unit that cannot be read.

    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Variable
    >>> Variable(dynamicsymbols("theta"), unit="rad").name
    'theta'
    """

    symbol: Any
    unit: str = ""
    column: str | None = None
    rate: str | None = None
    second_rate: str | None = None
    kind: str | None = None

    def __post_init__(self) -> None:
        time_function = isinstance(self.symbol, AppliedUndef) and len(self.symbol.args) == 1
        if not (isinstance(self.symbol, Symbol) or time_function):
            raise DescriptionError(
                f"variable: got {self.symbol!r}; expected a SymPy symbol or a function of time"
            )
        parse_unit(self.unit, f"variable {self.name!r}")
        if self.kind not in (None, "state", "input"):
            raise DescriptionError(
                f"variable {self.name!r}: kind is {self.kind!r}; expected 'state' or 'input'"
            )
        if self.rate is None and self.second_rate is not None:
            raise DescriptionError(
                f"variable {self.name!r}: second_rate without rate; expected a column of the first"
                " derivative too"
            )

    @property
    def name(self) -> str:
        """Name of the symbol."""
        return symbol_name(self.symbol)

    @property
    def column_name(self) -> str:
        """The column of a recording that holds it."""
        return self.name if self.column is None else self.column


@dataclasses.dataclass(frozen=True)
class Constant:
    """A constant of the equations: unknown, known, or searched.

    **Attributes**

    - `symbol`: a SymPy symbol.
    - `unit`: SI.
    - `value`: of a constant that is known; it is put in before anything else.
    - `sign`: known in advance, `"positive"` or `"negative"`.
    - `bounds`: for a constant that enters nonlinearly: the range in which it is searched
      (thesis 8.2.5).

    **Raises** `DescriptionError` for a symbol that is none, a unit that cannot be read, a value
    that contradicts the sign, or bounds that are not ascending.

    >>> import sympy
    >>> from jaxcslc.systems import Constant
    >>> Constant(sympy.Symbol("g"), unit="m/s²", value=9.81).name
    'g'
    """

    symbol: Any
    unit: str = ""
    value: float | None = None
    sign: str | None = None
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.symbol, Symbol):
            raise DescriptionError(f"constant: got {self.symbol!r}; expected a SymPy symbol")
        where = f"constant {self.name!r}"
        parse_unit(self.unit, where)
        if self.sign not in (None, "positive", "negative"):
            raise DescriptionError(
                f"{where}: sign is {self.sign!r}; expected 'positive' or 'negative'"
            )
        if self.value is not None:
            if not math.isfinite(self.value):
                raise DescriptionError(f"{where}: value is {self.value}; expected a finite number")
            if self.bounds is not None:
                raise DescriptionError(f"{where}: value and bounds; expected one of them")
            if self.value * (-1 if self.sign == "negative" else 1) < 0 and self.sign:
                raise DescriptionError(f"{where}: value is {self.value}, and its sign {self.sign}")
        if self.bounds is not None:
            low, high = self.bounds
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise DescriptionError(
                    f"{where}: bounds are {list(self.bounds)}; expected two finite numbers, the"
                    " lower first"
                )

    @property
    def name(self) -> str:
        """Name of the symbol."""
        return symbol_name(self.symbol)


def symbol_name(symbol: Any) -> str:
    """Return the name of a SymPy symbol, or of a function of time."""
    return str(symbol.func.__name__ if getattr(symbol, "is_Function", False) else symbol)


_ORDERS = ("{}", "dot({})", "ddot({})")  # a variable and its derivatives, as they are printed
_SIGNS: dict[str | None, dict[str, bool]] = {
    None: {"real": True},
    "positive": {"positive": True},
    "negative": {"negative": True},
}


class MotionSymbols:
    """Plain symbols: one for each variable, each of its two derivatives, and each constant.

    What a user wrote, with functions of time and derivatives of them, becomes algebra in these.

    **Attributes**

    - `variables`: index of each by its name.
    - `motion`: (variable, order) to its symbol, real.
    - `constants`: name to symbol, with the sign that is known.
    """

    def __init__(self, variables: Sequence[Variable], constants: Sequence[Constant]) -> None:
        self.variables = {variable.name: index for index, variable in enumerate(variables)}
        self.motion = {
            (index, order): Symbol(form.format(name), real=True)
            for name, index in self.variables.items()
            for order, form in enumerate(_ORDERS)
        }
        self.constants = {c.name: Symbol(c.name, **_SIGNS[c.sign]) for c in constants}

    def plain(self, expression: Any, where: str) -> Any:
        """An expression in these symbols alone.

        Names decide, whatever assumptions SymPy's symbols carry.

        **Raises** `DescriptionError` for names that are neither variable nor constant, and for
        third derivatives.
        """
        expression = sympify(expression)
        if any(not isinstance(d.expr, AppliedUndef) for d in expression.atoms(Derivative)):
            expression = expression.doit()
        listed = ", ".join(self.variables) or "there are none"
        replaced: dict[Any, Any] = {}
        for derivative in sorted(expression.atoms(Derivative), key=str):
            name, order = symbol_name(derivative.expr), derivative.derivative_count
            if name not in self.variables or derivative.variables != derivative.expr.args * order:
                raise DescriptionError(
                    f"{where}: {derivative} is no time derivative of a variable; expected one of"
                    f" {listed}"
                )
            if order > 2:
                raise DescriptionError(
                    f"{where}: derivative {order} of {name!r}; expected the first or the second"
                )
            replaced[derivative] = self.motion[self.variables[name], order]
        expression = expression.xreplace(replaced)
        values = {name: self.motion[index, 0] for name, index in self.variables.items()}
        # Functions of time before symbols, so that the time in them is no name of its own.
        for named in (values, values | self.constants):
            atoms = expression.atoms(AppliedUndef) if named is values else expression.free_symbols
            unknown = sorted(atoms - set(self.motion.values()), key=str)
            if missing := [atom for atom in unknown if symbol_name(atom) not in named]:
                raise DescriptionError(
                    f"{where}: unknown name {str(missing[0])!r}; expected a variable"
                    f" ({listed}) or a constant"
                    f" ({', '.join(self.constants) or 'there are none'})"
                )
            expression = expression.xreplace({atom: named[symbol_name(atom)] for atom in unknown})
        decimals = {x: Rational(repr(float(x))) for x in expression.atoms(Float)}
        return expression.xreplace(decimals)

"""Variables and constants of a system, and their units."""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any


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


def parse_unit(text: str) -> Unit:
    """A unit as powers of its factors: what follows a slash divides.

    **Raises** `ValueError` for a text that is no unit.

    >>> parse_unit("kg m²/s")
    {'kg': 1, 'm': 2, 's': -1}
    """
    powers: Unit = {}
    for number, part in enumerate(text.translate(_SUPERSCRIPTS).split("/")):
        for factor in part.replace("*", " ").replace("·", " ").split():
            match = _FACTOR.fullmatch(factor)
            if match is None and factor != "1":
                raise ValueError(f"unit {text!r}: cannot read {factor!r}; expected as in 'kg m²/s'")
            if match is not None:
                power = int(match[2] or 1) * (1 if number == 0 else -1)
                powers[match[1]] = powers.get(match[1], 0) + power
    return {name: power for name, power in powers.items() if power}


def unit_text(unit: Unit) -> str:
    """A unit as it is printed.

    >>> unit_text({"kg": 1, "m": 2, "s": -1})
    'kg m²/s'
    >>> unit_text({"s": -2})
    '1/s²'
    """

    def factors(sign: int) -> str:
        return " ".join(
            name if sign * power == 1 else name + str(sign * power).translate(_DIGITS)
            for name, power in unit.items()
            if sign * power > 0
        )

    above, below = factors(1), factors(-1)
    return above if not below else f"{above or 1}/{below.replace(' ', '/')}"


def product_of_units(factors: Iterable[tuple[str, int]]) -> str:
    """The unit of a product of quantities, each with its power.

    Angles are numbers: a radian is left out of products.

    >>> product_of_units([("kg", 1), ("m", 2)])
    'kg m²'
    """
    powers: Unit = {}
    several = 0
    for text, power in factors:
        several += 1
        for name, exponent in parse_unit(text).items():
            powers[name] = powers.get(name, 0) + exponent * power
    if several > 1:
        powers.pop("rad", None)
    return unit_text({name: power for name, power in powers.items() if power})


def check_unit(text: str, where: str) -> None:
    """**Raises** `DescriptionError` for a text that is no unit."""
    try:
        parse_unit(text)
    except ValueError as error:
        raise DescriptionError(f"{where}: {error}") from None


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
        check_symbol(self.symbol, "variable", function=True)
        check_unit(self.unit, f"variable {self.name!r}")
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
        return name_of(self.symbol)

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
        check_symbol(self.symbol, "constant", function=False)
        where = f"constant {self.name!r}"
        check_unit(self.unit, where)
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
        return name_of(self.symbol)


def name_of(symbol: Any) -> str:
    """Return the name of a SymPy symbol, or of a function of time."""
    function = getattr(symbol, "func", None)
    if getattr(symbol, "is_Function", False) and function is not None:
        return str(function.__name__)
    return str(symbol)


def check_symbol(symbol: Any, what: str, *, function: bool) -> None:
    """**Raises** `DescriptionError` unless it is a symbol or, with `function`, one of time."""
    from sympy import Symbol
    from sympy.core.function import AppliedUndef

    if isinstance(symbol, Symbol):
        return
    if function and isinstance(symbol, AppliedUndef) and len(symbol.args) == 1:
        return
    expected = "a SymPy symbol or a function of time" if function else "a SymPy symbol"
    raise DescriptionError(f"{what}: got {symbol!r}; expected {expected}")


def named(entries: tuple[Any, ...], what: str) -> Mapping[str, Any]:
    """Variables or constants by name.

    **Raises** `DescriptionError` for two of one name.
    """
    table: dict[str, Any] = {}
    for entry in entries:
        if entry.name in table:
            raise DescriptionError(f"{what} {entry.name!r} is described twice; expected once")
        table[entry.name] = entry
    return MappingProxyType(table)

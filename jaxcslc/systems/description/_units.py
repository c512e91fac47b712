import re
from collections.abc import Iterable

from ._errors import DescriptionError


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

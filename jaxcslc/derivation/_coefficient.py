import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from ._inertial_terms import InertialTerm


@dataclass(frozen=True)
class Addend:
    """One addend of a coefficient: a rational times named constants times link parameters."""

    factor: Fraction
    constants: tuple[tuple[str, int], ...]  # name and power, as in ("d4", 2)
    term: InertialTerm

    @property
    def label(self) -> str:
        """Without its rational factor: `"d4^2*m4"`."""
        names = [name if power == 1 else f"{name}^{power}" for name, power in self.constants]
        return "*".join([*names, self.term.label])


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
        """Whether it is made of known masses alone (thesis C.1.2)."""
        return bool(self.addends) and all(x.term.known is not None for x in self.addends)

    def known_value(self, constants: Mapping[str, float]) -> float:
        """The number that it is if it `is_known`.

        - `constants`: values of lengths and gravity, by name.
        """
        return sum(
            float(x.factor * (x.term.known or 0))
            * math.prod(constants[name] ** power for name, power in x.constants)
            for x in self.addends
        )


def expression(addends: Sequence[Addend]) -> str:
    """A sum as it is printed, its rationals as decimals: `"Ixx4 - 0.5*m4*rz4"`."""
    text = ""
    for addend in addends:
        size = abs(addend.factor)
        number = "" if size == 1 else f"{_decimal(size)}*"
        sign = "-" if addend.factor < 0 else "+"
        text += (
            f" {sign} {number}{addend.label}"
            if text
            else (f"{'-' if sign == '-' else ''}{number}{addend.label}")
        )
    return text


def _decimal(value: Fraction) -> str:
    return str(value.numerator) if value.denominator == 1 else repr(float(value))


def unit_of(addend: Addend, *, prismatic: bool, gravity: Sequence[str]) -> str:
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

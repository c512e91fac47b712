import math
from collections.abc import Mapping
from types import MappingProxyType


_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "epoch": 1.0},
        "position": {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "rev": _TURN, "m": 1.0, "mm": 1e-3},
        "velocity": {
            **{"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "rpm": _TURN / 60.0},
            **{"m/s": 1.0, "mm/s": 1e-3},
        },
        "acceleration": {
            **{"rad/s^2": 1.0, "deg/s^2": _DEGREE, "m/s^2": 1.0, "mm/s^2": 1e-3},
        },
        "torque": {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N": 1.0, "mN": 1e-3, "kN": 1e3},
        "current": {"A": 1.0, "mA": 1e-3},
    }
)
"""SI units in one of each unit, by quantity; those of revolute joints and of prismatic ones."""

_SPELLINGS = {
    **{"µ": "u", "μ": "u", "°": "deg", "degrees": "deg", "degree": "deg"},
    **{"²": "^2", "s2": "s^2", "**": "^", "·": "", "*": ""},
}


def si_factor(unit: str, quantity: str) -> float | None:
    """How many SI units one of another unit is.

    **Arguments**

    - `unit`: as a header or a mapping spells it: `"deg"`, `"N m"`, `"Nm"`, `"rad/s²"`.
    - `quantity`: a key of `UNITS`.

    **Returns** the factor, or None for a unit that is none of this quantity.

    >>> si_factor("mNm", "torque"), si_factor("µs", "time"), si_factor("deg", "torque")
    (0.001, 1e-06, None)
    """
    return {_plain(name): factor for name, factor in UNITS[quantity].items()}.get(_plain(unit))


def listed_units(quantity: str) -> str:
    """The units of a quantity, for a message.

    >>> listed_units("current")
    'A or mA'
    """
    *first, last = UNITS[quantity]
    return f"{', '.join(first)} or {last}"


def _plain(unit: str) -> str:
    for spelling, plain in _SPELLINGS.items():
        unit = unit.replace(spelling, plain)
    return "".join(unit.split()).replace("N.m", "Nm")

"""Friction models of joints: names of the terms, coupled joints, and checks.

The formulas of the terms are in `jaxcslc.network.terms`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from ._joint import RobotError


FRICTION_TERMS = (
    "viscous",
    "asymmetric_viscous",
    "dry",
    "asymmetric_dry",
    "static",
    "root",
    "quadratic",
    "offset",
    "spring",
    "load",
    "directional_load",
)
"""Names of the friction terms that a joint may have."""
# Of joints whose slope is not known: static friction decays to 5 % at 0.3 rad/s [s/rad].
STATIC_SLOPE = 10.0
"""Slope of static friction over speed where a robot file has none [s/rad]."""
# Kinds whose inputs are collinear, and why: a fit could not separate their coefficients.
_COLLINEAR = (
    ("viscous", "asymmetric_viscous", "asymmetric_viscous is viscous in either direction"),
    ("dry", "asymmetric_dry", "asymmetric_dry is dry in either direction"),
    ("offset", "asymmetric_dry", "asymmetric_dry is dry and offset together"),
    ("load", "directional_load", "directional_load is load where it drives and where it brakes"),
)


class Coupling(NamedTuple):
    """Two joints that share a motor's shaft, which has friction and inertia.

    The shaft turns by `q[first] + ratio * q[second]`. Joints count from 1.

    >>> Coupling(5, 6)
    Coupling(first=5, second=6, ratio=1.0)
    """

    first: int
    second: int
    ratio: float = 1.0


def check_friction(terms: Sequence[str], where: str) -> None:
    """Check the kinds of a friction model.

    **Raises** `RobotError` for kinds that are unknown, listed twice or collinear.
    """
    if unknown := [term for term in terms if term not in FRICTION_TERMS]:
        raise RobotError(
            f"{where}: unknown friction term {unknown[0]!r};"
            f" expected some of {', '.join(FRICTION_TERMS)}"
        )
    if len(set(terms)) != len(terms):
        raise RobotError(f"{where}: a friction term is listed twice")
    for first, second, why in _COLLINEAR:
        if first in terms and second in terms:
            raise RobotError(
                f"{where}: friction terms {first} and {second} exclude each other: {why}"
            )


def check_slopes(slopes: Sequence[float], where: str) -> None:
    """Check slopes of static friction, one a joint.

    **Raises** `RobotError` for one that is not positive and finite.
    """
    for i, slope in enumerate(slopes, start=1):
        if not 0 < slope < float("inf"):
            raise RobotError(
                f"{where}, joint {i}, static_slope: expected a number above 0 in s/rad, got {slope}"
            )


def couplings(pairs: Sequence[Sequence[Any]], kinds: str, where: str) -> tuple[Coupling, ...]:
    """Pairs of joints, counted from 1, with or without a ratio.

    **Raises** `RobotError` for anything but two different joints of one kind, once.
    """
    checked: list[Coupling] = []
    for pair in pairs:
        at = f"{where}, coupled"
        if len(pair) not in (2, 3) or not all(
            isinstance(joint, int) and not isinstance(joint, bool) for joint in pair[:2]
        ):
            raise RobotError(
                f"{at}: expected pairs of joints, as in [5, 6], or with a ratio, [5, 6, -1.0],"
                f" got {list(pair)!r}"
            )
        first, second = int(pair[0]), int(pair[1])
        ratio = pair[2] if len(pair) == 3 else 1.0
        if (
            isinstance(ratio, bool)
            or not isinstance(ratio, int | float)
            or not (0 < abs(ratio) < float("inf"))
        ):
            raise RobotError(f"{at}: expected a ratio other than 0, got {ratio!r}")
        for joint in (first, second):
            if not 1 <= joint <= len(kinds):
                raise RobotError(f"{at}: there is no joint {joint}; expected 1 to {len(kinds)}")
        if first == second:
            raise RobotError(f"{at}: joint {first} is paired with itself")
        if kinds[first - 1] != kinds[second - 1]:
            raise RobotError(
                f"{at}: joints {first} and {second} are revolute and prismatic;"
                " expected two of one kind"
            )
        if any({first, second} == {other.first, other.second} for other in checked):
            raise RobotError(f"{at}: joints {first} and {second} are paired twice")
        checked.append(Coupling(first, second, float(ratio)))
    return tuple(checked)

"""Products of link parameters that occur in the dynamics, and their factors in M and G.

Every product belongs to entries of `BODY`, the ten numbers of a rigid body: inertia tensor, first
moments and mass. Dynamics are linear in these (Eqns. 2.3-17, 2.3-20).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from ..manipulator import Manipulator
from ._chain import LinkTwists, add, cross, dot, minus


# The ten numbers that a rigid body's dynamics are linear in: inertia tensor about the frame's
# origin, first moments, mass.
BODY = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz", "hx", "hy", "hz", "m")
_AXES = ("x", "y", "z")
_FIRST_MOMENTS = BODY[6:9]
_CENTRE = ("rx", "ry", "rz")


@dataclass(frozen=True)
class InertialTerm:
    """Product of a link's physical parameters, and its place in the link's inertia.

    **Attributes**

    - `link`: counted from 0.
    - `factors`: `("Ixx",)`, `("m", "rx", "ry")`, `("motor",)`, to be multiplied.
    - `body`: entries of `BODY` that contain the product, with their multiples of it (Eqns. 2.3-17,
      2.3-20). Where the centre of gravity is known, the mass is in first moments too, multiplied
      by its coordinates (C.1.2).
    - `central`: whether it is a moment about the centre of gravity instead of the frame's origin.
    - `known`: its value, where that is a number in the algebra; else None.
    """

    link: int
    factors: tuple[str, ...]
    body: tuple[tuple[str, int | Fraction], ...]
    central: bool = False
    known: Fraction | None = None

    @property
    def label(self) -> str:
        """Term as it is printed, links counted from 1: `"m6*rz6^2"`, `"Ixx3"`, `"Im2"`."""
        counts: dict[str, int] = {}
        for factor in self.factors:
            name = f"{'Im' if factor == 'motor' else factor}{self.link + 1}"
            counts[name] = counts.get(name, 0) + 1
        return "*".join(name if power == 1 else f"{name}^{power}" for name, power in counts.items())


class UnitInertia(NamedTuple):
    """Inertia of a robot with one base parameter of 1 and all others zero.

    **Attributes**

    - `link`: index of the link that has inertia.
    - `body`: its ten numbers, in the order of `BODY`; zeros for a motor.
    - `motor`: inertia that the link's joint adds to its own, 1 or 0.
    """

    link: int
    body: tuple[int | float, ...]
    motor: int


def unit_inertia(term: InertialTerm) -> UnitInertia:
    """The inertia of a link of which one term is 1 and all others are zero."""
    multiples = dict(term.body)
    numbers = (multiples.get(entry, 0) for entry in BODY)
    body = tuple(float(x) if isinstance(x, Fraction) else x for x in numbers)
    return UnitInertia(term.link, body, int(term.factors == ("motor",)))


def inertial_terms(robot: Manipulator) -> tuple[InertialTerm, ...]:
    """Every product of parameters that the robot's links have, link by link, motors last."""
    terms: list[InertialTerm] = []
    for link, inertia in enumerate(robot.inertia):
        zero, same = set(inertia.zero), {moment: moment for moment in ("Ixx", "Iyy", "Izz")}
        for first, second in inertia.equal:  # a chain of pairs makes one moment of all
            one = min(same[first], same[second])
            joined = {same[first], same[second]}
            same = {moment: one if name in joined else name for moment, name in same.items()}
        body: dict[tuple[str, ...], dict[str, int | Fraction]] = {}
        centre: dict[str, Fraction] = dict(
            zip(_CENTRE, map(_fraction, inertia.centre or ()), strict=False)
        )

        def put(
            factors: tuple[str, ...],
            entries: Mapping[str, int | Fraction],
            body: dict[tuple[str, ...], dict[str, int | Fraction]] = body,
            zero: set[str] = zero,
            centre: Mapping[str, Fraction] = centre,
        ) -> None:
            for factor in factors[1:] if centre else ():
                entries = {name: multiple * centre[factor] for name, multiple in entries.items()}
            factors = factors[:1] if centre else factors
            if not zero & set(factors) and any(entries.values()):
                entries_of_term = body.setdefault(factors, {})
                for entry, multiple in entries.items():
                    entries_of_term[entry] = entries_of_term.get(entry, 0) + multiple

        for moment in ("Ixx", "Iyy", "Izz"):
            put((same[moment],), {moment: 1})
        if inertia.form == "full":
            for product in ("Ixy", "Ixz", "Iyz"):
                put((product,), {product: 1})
        else:
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                put(
                    ("m", f"r{_AXES[a]}", f"r{_AXES[a]}"),
                    {f"I{_AXES[b]}{_AXES[b]}": 1, f"I{_AXES[c]}{_AXES[c]}": 1},
                )
            for a, b in ((0, 1), (0, 2), (1, 2)):
                put(("m", f"r{_AXES[a]}", f"r{_AXES[b]}"), {f"I{_AXES[a]}{_AXES[b]}": -1})
        for axis in _AXES:
            put(("m", f"r{axis}"), {f"h{axis}": 1})
        put(("m",), {"m": 1})
        central = inertia.form == "principal"
        terms += [
            InertialTerm(
                link,
                factors,
                tuple(entries_of_term.items()),
                central and factors[0][0] == "I",
                None if inertia.mass is None or factors != ("m",) else _fraction(inertia.mass),
            )
            for factors, entries_of_term in body.items()
        ]
    terms += [
        InertialTerm(link, ("motor",), ())
        for link, inertia in enumerate(robot.inertia)
        if inertia.motor
    ]
    return tuple(terms)


def _fraction(value: float) -> Fraction:
    """The rational that the shortest decimal of a float says, as `exact_number`."""
    return Fraction(repr(float(value)))


def kinetic_factors(twists: LinkTwists, j: int, k: int, needed: set[str]) -> dict[str, Any]:
    """Return the factor of each entry of `BODY` that is in `needed` in M_jk (Eqn. 2.3-24).

    The bilinear form of the kinetic energy: w_j' I w_k + h · (v_j x w_k + v_k x w_j) + m v_j · v_k.
    """
    wj, wk, vj, vk = twists.angular[j], twists.angular[k], twists.linear[j], twists.linear[k]
    factors: dict[str, Any] = {}
    for a, name in enumerate(_AXES):
        if f"I{name}{name}" in needed:
            factors[f"I{name}{name}"] = wj[a] * wk[a]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        name = f"I{_AXES[a]}{_AXES[b]}"
        if name in needed:
            factors[name] = wj[a] * wk[b] + wj[b] * wk[a]
    if not needed.isdisjoint(_FIRST_MOMENTS):
        factors |= zip(_FIRST_MOMENTS, add(cross(vj, wk), cross(vk, wj)), strict=True)
    if "m" in needed:
        factors["m"] = dot(vj, vk)
    return factors


def gravity_factors(twists: LinkTwists, j: int, needed: set[str]) -> dict[str, Any]:
    """Return the factor of each entry of `BODY` in G_j (Eqns. 2.3-28, 2.4-7).

    The potential energy is -g · p for every mass point p, and dp/dq_j = v_j + w_j x r.
    """
    w, v, g = twists.angular[j], twists.linear[j], twists.gravity
    factors: dict[str, Any] = {}
    if not needed.isdisjoint(_FIRST_MOMENTS):
        factors |= zip(_FIRST_MOMENTS, cross(w, g), strict=True)
    if "m" in needed:
        factors["m"] = minus(dot(v, g))
    return factors

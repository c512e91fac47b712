"""One row of modified Denavit-Hartenberg parameters, with its lengths, angles and numberings.

`parsed_joint` checks the entries of a row, `modified_dh_joints` whole tables of them.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal


class RobotError(ValueError):
    """A robot description that cannot be read, is contradictory, or is incomplete.

    The message is one line: which file or argument, which joint or key, what it is and what
    was expected.
    """


JointKind = Literal["R", "P"]

_MOST_ANGLE = 4 * math.pi  # as a number: beyond, it is one in degrees
_PI_MULTIPLE = re.compile(
    r"^\s*(?P<sign>[+-]?)\s*(?P<factor>\d+(?:\.\d*)?)?\s*\*?\s*pi\s*(?:/\s*(?P<divisor>[1-9]\d*))?\s*$"
)
_SYMBOL = re.compile(r"^[A-Za-z][A-Za-z_]*\d*$")


@dataclass(frozen=True)
class Length:
    """A constant length or offset of the kinematics: a number, a symbol, or a named number.

    A length that is zero by the choice of frames has value 0 and no symbol: it never appears in an
    expression.

    **Attributes**

    - `value`: [m]; None for a symbol of unknown value.
    - `symbol`: the name that the algebra uses when lengths are kept symbolic.

    >>> Length(0.4318, "a2").is_zero, Length().is_zero
    (False, True)
    """

    value: float | None = 0.0
    symbol: str | None = None

    @property
    def is_zero(self) -> bool:
        """True if the length is zero by the choice of frames."""
        return self.symbol is None and self.value == 0.0


@dataclass(frozen=True)
class Joint:
    """Row of modified Denavit-Hartenberg parameters (thesis 2.6.1, Eqn. 2.6-1).

    The frame of link i follows from that of its parent by
    `Rot(z, gamma) Trans(z, b) Rot(x, alpha) Trans(x, a) Trans(z, d) Rot(z, theta)`. The joint
    variable is added to `theta` for a revolute joint ("R", rad) and to `d` for a prismatic one
    ("P", m). Along a serial chain `gamma` and `b` are zero, for they can be part of the row
    before; where a tree branches they are needed (Khalil and Kleinfinger 1986), and where the
    base frame is fixed.

    **Attributes**

    - `kind`: `"R"` or `"P"`.
    - `alpha`, `theta`, `gamma`: angles [rad].
    - `a`, `d`, `b`: lengths [m].
    - `parent`: the joint whose link carries this one: 1 for the first, 0 for the base, None for
      the joint before.

    >>> Joint("R", 0.0, Length(), Length(0.3), 0.0).d
    Length(value=0.3, symbol=None)
    """

    kind: JointKind
    alpha: float
    a: Length
    d: Length
    theta: float
    gamma: float = 0.0
    b: Length = Length()
    parent: int | None = None

    @property
    def lengths(self) -> tuple[tuple[str, int, Length], ...]:
        """Letter, shift of the index that it is called by, and value: a of row i is a(i-1)."""
        return ("a", -1, self.a), ("d", 0, self.d), ("b", -1, self.b)


def parse_angle(value: object, where: str) -> float:
    """An angle [rad] from a number or from a multiple of pi as text, as in `"-pi/2"`.

    **Raises** `RobotError` if `value` is neither, or an angle of more than two turns, as one in
    degrees; `where` says which entry it was.

    >>> parse_angle("-pi/2", "alpha of joint 2")
    -1.5707963267948966
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise RobotError(f"{where}: expected an angle in rad or a multiple of pi, got {value!r}")
    if not isinstance(value, str):
        angle = finite_number(value)
    elif match := _PI_MULTIPLE.match(value):
        angle = math.pi * float(match["factor"] or 1) / int(match["divisor"] or 1)
        angle = -angle if match["sign"] == "-" else angle
    else:
        try:
            angle = float(value)
        except ValueError:
            raise RobotError(
                f"{where}: expected an angle in rad or a multiple of pi such as '-pi/2',"
                f" got {value!r}"
            ) from None
    if angle is None or not math.isfinite(angle):
        raise RobotError(f"{where}: expected a finite angle, got {value!r}")
    if abs(angle) > _MOST_ANGLE and "pi" not in str(value):
        raise RobotError(
            f"{where}: {value!r} rad is more than two turns; expected an angle in rad, not in"
            " degrees, or a multiple of pi such as '-pi/2'"
        )
    return angle


def parse_length(value: object, lengths: dict[str, float], where: str) -> Length:
    """A `Length` from a number [m] or from a symbol, with its value if `lengths` has one.

    A symbol is letters followed by an optional number, as in `a2`.

    **Raises** `RobotError` if `value` is neither; `where` says which entry it was.

    >>> parse_length("a2", {"a2": 0.4318}, "a of joint 3")
    Length(value=0.4318, symbol='a2')
    """
    if isinstance(value, str):
        if not _SYMBOL.match(value):
            raise RobotError(
                f"{where}: expected a length in m or the name of one such as 'a2', got {value!r}"
            )
        return Length(lengths.get(value), value)
    number = finite_number(value)
    if number is None:
        raise RobotError(f"{where}: expected a finite length in m or its name, got {value!r}")
    return Length(number, None)


LARGEST = 1e9
"""Numbers of no robot are larger, in SI units; beyond, products of them overflow."""


def finite_number(value: object) -> float | None:
    """The number as a float, or None for anything else, and for what is larger than `LARGEST`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= LARGEST else None


def length_table(values: Mapping[str, object], where: str) -> dict[str, float]:
    """Named lengths and their values [m], checked.

    **Raises** `RobotError`, naming the length.
    """
    table: dict[str, float] = {}
    for symbol, value in values.items():
        parse_length(symbol, {}, where)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise RobotError(f"{where}, {symbol}: expected a length in m, got {value!r}")
        number = finite_number(value)
        if not number:
            raise RobotError(
                f"{where}, {symbol}: expected a finite length in m other than zero, got {value!r};"
                " where a length vanishes, write 0 instead of a name"
            )
        table[symbol] = number
    return table


def unused_lengths(values: Mapping[str, float], joints: Iterable[Joint], where: str) -> None:
    """Check that joints use all named lengths.

    **Raises** `RobotError` if a named length is not used by any joint.
    """
    used = {length.symbol for joint in joints for _, _, length in joint.lengths}
    if unused := sorted(set(values) - used):
        raise RobotError(f"{where}: {unused[0]!r} is not used by any joint")


def parsed_joint(entries: Mapping[str, Any], lengths: dict[str, float], where: str) -> Joint:
    """Return the joint of a row's entries: kind, parent, and parameters, zero where omitted.

    **Raises** `RobotError`, naming the entry that is wrong.
    """
    kind, parent = entries.get("kind", "R"), entries.get("parent")
    if kind not in ("R", "P"):
        raise RobotError(f"{where}, kind: expected 'R' (revolute) or 'P' (prismatic), got {kind!r}")
    if parent is not None and (isinstance(parent, bool) or not isinstance(parent, int)):
        raise RobotError(
            f"{where}, parent: expected the number of a joint, or 0 for the base, got {parent!r}"
        )
    alpha, theta, gamma = (
        parse_angle(entries.get(name, 0), f"{where}, {name}")
        for name in ("alpha", "theta", "gamma")
    )
    a, d, b = (parse_length(entries.get(x, 0), lengths, f"{where}, {x}") for x in ("a", "d", "b"))
    return Joint(kind, alpha, a, d, theta, gamma, b, parent)


def modified_dh_joints(
    rows: Sequence[Sequence[float | int | str]],
    parents: Sequence[int] | None,
    kinds: str | None,
    lengths: Mapping[str, float | int],
    where: str,
) -> tuple[Joint, ...]:
    """Joints of rows of modified Denavit-Hartenberg parameters.

    - `rows`, `parents`, `kinds`, `lengths`: as of `Manipulator.from_modified_dh`.
    - `where`: what messages name, as in `"robot 'arm'"`.

    **Raises** `RobotError`, naming the joint and the entry that is wrong.
    """
    kinds = "R" * len(rows) if kinds is None else kinds
    if len(kinds) != len(rows) or set(kinds) - {"R", "P"}:
        raise RobotError(
            f"{where}: kinds must be one R or P for each of {len(rows)} rows, got {kinds!r}"
        )
    if parents is not None and len(parents) != len(rows):
        raise RobotError(f"{where}: expected {len(rows)} parents, one a row, got {len(parents)}")
    values = length_table(lengths, f"{where}, lengths")
    joints: list[Joint] = []
    for i, (row, kind) in enumerate(zip(rows, kinds, strict=True), start=1):
        if len(row) not in (4, 6):
            raise RobotError(
                f"{where}, joint {i}: expected (alpha, a, d, theta) or"
                f" (alpha, a, d, theta, gamma, b), got {row!r}"
            )
        entries = dict(zip(("alpha", "a", "d", "theta", "gamma", "b"), row, strict=False))
        parent = None if parents is None else int(parents[i - 1])
        of_row = {**entries, "kind": kind, "parent": parent}
        joints.append(parsed_joint(of_row, values, f"{where}, joint {i}"))
    unused_lengths(values, joints, f"{where}, lengths")
    return tuple(joints)


_MOST_GRAVITY = 1e4  # m/s²; that of the Sun's surface is 274


def gravity_vector(gravity: Sequence[float | int], name: str) -> tuple[float, float, float]:
    """Return gravity as three numbers, or raise `RobotError` with the robot's name."""
    numbers = [isinstance(g, int | float) and not isinstance(g, bool) for g in gravity]
    if numbers != [True] * 3:
        raise RobotError(f"robot {name!r}: gravity must be three numbers in m/s², got {gravity!r}")
    x, y, z = (float(g) for g in gravity)
    if not abs(x) + abs(y) + abs(z) <= _MOST_GRAVITY:
        raise RobotError(
            f"robot {name!r}: gravity must be at most {_MOST_GRAVITY:g} m/s², got {gravity!r}"
        )
    return x, y, z


@dataclass(frozen=True)
class Subnumbering:
    """The published order of the inputs and coefficients of a subnetwork.

    **Attributes**

    - `inputs`: products of sines and cosines as printed (`"c23*s4*c5"`).
    - `coefficients`: one link of the publication for every coefficient: `(input, column, multiple)`
      means that the weight from that input to that element (`(1, 2)` for M12, `(2,)` for G2) is
      `multiple` times the coefficient.
    """

    inputs: tuple[str, ...]
    coefficients: tuple[tuple[str, tuple[int, ...], float], ...] = ()


@dataclass(frozen=True)
class Numbering:
    """A published numbering of a robot's inputs and coefficients, such as Appendix B.

    The derivation does not need one: it only permutes and scales the algebra's inputs and
    coefficients, and raises an error for a numbering that does not match them one to one.
    """

    source: str
    mass: Subnumbering
    velocity: Subnumbering
    gravity: Subnumbering

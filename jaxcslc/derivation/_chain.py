"""Kinematics of a robot, its axes grouped by parallelism, and the unit velocities of its links.

Decimals and angles become exact first: rationals, and rational points of the unit circle. The
vector functions work over any kind of number: rationals, floats, arrays or expressions. They
skip operations with zero and one, which right angles and zero lengths cause. `link_twists` gives
what Eqn. 2.3-24 needs of the transforms.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, no_type_check

from flint import fmpq

from ..manipulator import Joint, Manipulator


# Angles this close to a multiple of 90 degrees are taken as exactly that [rad].
_RIGHT_ANGLE_TOLERANCE = 1e-9
# A rational t = tan(angle / 2) of this denominator moves the angle by less than 1e-15 rad. (The
# nearest fraction of a *bounded* denominator does not: beside a simple fraction there is a gap.)
_TANGENT_DENOMINATOR = 2**52


def exact_number(value: float):
    """Return the rational that the shortest decimal of a float says: 0.4318 is 4318/10000.

    >>> exact_number(0.25)
    1/4
    """
    fraction = decimal_fraction(value)
    return fmpq(fraction.numerator, fraction.denominator)


def decimal_fraction(value: float) -> Fraction:
    """Return the same rational as one of Python's."""
    return Fraction(repr(float(value)))


def exact_cos_sin(angle: float):
    """Cosine and sine of an angle [rad] as a rational point of the unit circle.

    Multiples of 90° are exact. Any other angle is replaced by the nearby one whose half has a
    rational tangent t: ((1 - t²) / (1 + t²), 2 t / (1 + t²)), so that cos² + sin² = 1 holds
    exactly and the algebra sees a true rotation; it differs from the given one by less than
    1e-15 rad.

    >>> exact_cos_sin(-math.pi / 2)
    (0, -1)
    """
    quarter_turns = round(angle / (math.pi / 2))
    if abs(angle - quarter_turns * (math.pi / 2)) < _RIGHT_ANGLE_TOLERANCE:
        cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter_turns % 4]
        return fmpq(cos), fmpq(sin)
    remainder = angle - quarter_turns * (math.pi / 2)
    t = fmpq(round(math.tan(remainder / 2) * _TANGENT_DENOMINATOR), _TANGENT_DENOMINATOR)
    cos, sin = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
    for _ in range(quarter_turns % 4):
        cos, sin = -sin, cos
    return cos, sin


# Vectors of any kind of number: rationals, polynomials, arrays, expressions. Zeros that are part of
# a robot's geometry are plain numbers. What they are multiplied by or added to is left out, so that
# neither polynomials nor generated code grow by them.
Vector = tuple[Any, Any, Any]
Matrix = tuple[Vector, Vector, Vector]  # by rows
Rotation = tuple[Any, Any]  # cosine and sine of an angle
Reduce = Callable[[Any], Any]  # brings a product of polynomials into normal form

ZERO: Vector = (0, 0, 0)

# Functions of single numbers take any kind of number: a check at run time, as in the tests, could
# find nothing, and took nine tenths of a derivation's time.


@no_type_check
def unchanged(x: Any) -> Any:
    """The normal form of numbers that need none."""
    return x


@no_type_check
def is_zero(x: Any) -> bool:
    """Return whether a number is exactly zero; an array never is, whatever its value."""
    return not hasattr(x, "shape") and x == 0


@no_type_check
def plus(x: Any, y: Any) -> Any:
    return y if is_zero(x) else (x if is_zero(y) else x + y)


@no_type_check
def minus(x: Any) -> Any:
    return 0 if is_zero(x) else -x


@no_type_check
def times(x: Any, y: Any) -> Any:
    return 0 if is_zero(x) or is_zero(y) else x * y


@no_type_check
def signed(sign: int, x: Any) -> Any:
    return x if sign > 0 else minus(x)


def add(x: Vector, y: Vector) -> Vector:
    return plus(x[0], y[0]), plus(x[1], y[1]), plus(x[2], y[2])


def scale(factor: Any, x: Vector) -> Vector:
    return times(factor, x[0]), times(factor, x[1]), times(factor, x[2])


def dot(x: Vector, y: Vector) -> Any:
    return plus(plus(times(x[0], y[0]), times(x[1], y[1])), times(x[2], y[2]))


def cross(x: Vector, y: Vector, reduce: Reduce = unchanged) -> Vector:
    return (
        reduce(plus(times(x[1], y[2]), minus(times(x[2], y[1])))),
        reduce(plus(times(x[2], y[0]), minus(times(x[0], y[2])))),
        reduce(plus(times(x[0], y[1]), minus(times(x[1], y[0])))),
    )


def product(matrix: Matrix, x: Vector) -> Vector:
    """Matrix times vector."""
    return dot(matrix[0], x), dot(matrix[1], x), dot(matrix[2], x)


_PLANES = {"x": (1, 2), "z": (0, 1)}  # that rotations about an axis turn, and in which direction


def rotate(axis: str, x: Vector, rotation: Rotation) -> Vector:
    """Rot(axis, angle) times a vector."""
    (i, j), (c, s), turned = _PLANES[axis], rotation, list(x)
    turned[i] = plus(times(c, x[i]), minus(times(s, x[j])))
    turned[j] = plus(times(s, x[i]), times(c, x[j]))
    return turned[0], turned[1], turned[2]


def unrotate(axis: str, x: Vector, rotation: Rotation, reduce: Reduce = unchanged) -> Vector:
    """Rot(axis, -angle) times a vector: its components in axes that are rotated by the angle."""
    (i, j), (c, s), turned = _PLANES[axis], rotation, list(x)
    turned[i] = reduce(plus(times(c, x[i]), times(s, x[j])))
    turned[j] = reduce(plus(times(c, x[j]), minus(times(s, x[i]))))
    return turned[0], turned[1], turned[2]


def compose(first: Rotation, second: Rotation, sign: int = 1) -> Rotation:
    """Cosine and sine of the first angle plus, or minus, the second."""
    cos, sin = second[0], signed(sign, second[1])
    return (
        plus(times(first[0], cos), minus(times(first[1], sin))),
        plus(times(first[0], sin), times(first[1], cos)),
    )


@dataclass(frozen=True)
class Angle:
    """An independent angle: a signed running sum of joint variables, as q2 + q3 in c23.

    Where consecutive revolute axes are parallel, only the sum of their angles turns the links
    behind them (thesis 2.6.2). Taking the sum as the variable keeps the tables small.

    **Attributes**

    - `terms`: (joint, sign) pairs, joints counted from 0.
    - `wide`: whether labels separate the numbers, as for robots of ten and more joints: q1 + q2 is
      `1_2`, because `12` is q12.
    """

    terms: tuple[tuple[int, int], ...]
    wide: bool = False

    @cached_property
    def label(self) -> str:
        """`"23"` for q2 + q3, `"2-3"` for q2 - q3."""
        text = ""
        for joint, sign in self.terms:
            separator = "-" if sign < 0 else ("_" if self.wide and text else "")
            text += f"{separator}{joint + 1}"
        return text


@dataclass(frozen=True)
class ChainLink:
    """Placement of a link's frame in its parent's frame, with exact constant rotations.

    **Attributes**

    - `parent`: index of the link that carries it; -1 for the base.
    - `prismatic`: whether its joint slides along z; otherwise it turns about z.
    - `branch`, `twist`: rotations by gamma and alpha.
    - `joins_group`: whether its axis is parallel or antiparallel to the axis before.
    - `side`: direction of its axis within the group of parallel axes, +1 or -1.
    - `angle`: index of the group's running angle after this joint.
    - `offset`: the constant part of that angle.
    """

    parent: int
    prismatic: bool
    branch: Rotation
    twist: Rotation
    joins_group: bool
    side: int
    angle: int | None
    offset: Rotation


@dataclass(frozen=True)
class Chain:
    """A robot's kinematics, sorted into groups of parallel axes (thesis 2.6.2).

    Joints are numbered outwards, so that a parent's index is below its children's.
    """

    links: tuple[ChainLink, ...]
    angles: tuple[Angle, ...]

    @classmethod
    def from_robot(cls, robot: Manipulator) -> "Chain":
        """Return the chain or tree of a robot's joints."""
        return cls.from_joints(robot.joints, robot.parents)

    @classmethod
    def from_joints(cls, joints: Sequence[Joint], parents: Sequence[int]) -> "Chain":
        """
        - `joints`: in the order of their links.
        - `parents`: the index of the link that carries each link; -1 for the base.
        """
        links: list[ChainLink] = []
        angles: list[Angle] = []
        wide = len(joints) > 9
        for i, (joint, parent) in enumerate(zip(joints, parents, strict=True)):
            branch, twist = exact_cos_sin(joint.gamma), exact_cos_sin(joint.alpha)
            joins = parent >= 0 and twist[1] == 0
            if joins:
                before = links[parent]
                current, offset = before.angle, compose(before.offset, branch, before.side)
                side = before.side * int(twist[0])
            else:
                side, current, offset = 1, None, (fmpq(1), fmpq(0))
            offset = compose(offset, exact_cos_sin(joint.theta), side)
            if joint.kind == "R":
                terms = () if current is None else angles[current].terms
                current = len(angles)
                angles.append(Angle((*terms, (i, side)), wide))
            prismatic = joint.kind == "P"
            links.append(ChainLink(parent, prismatic, branch, twist, joins, side, current, offset))
        return cls(tuple(links), tuple(angles))

    def in_numbers(self, number: Callable[[Any], Any]) -> "Chain":
        """Return the chain with its constant rotations in another kind of number, as by `float`."""

        def rotation(x: Rotation) -> Rotation:
            return number(x[0]), number(x[1])

        links = [
            dataclasses.replace(
                link,
                branch=rotation(link.branch),
                twist=rotation(link.twist),
                offset=rotation(link.offset),
            )
            for link in self.links
        ]
        return Chain(tuple(links), self.angles)


@dataclass(frozen=True)
class LinkTwists:
    """Unit velocities of one link, expressed in its frame.

    **Attributes**

    - `angular`, `linear`: for every joint up to the link's, the angular velocity of the link and
      the velocity of its frame's origin when this joint alone moves at unit rate; zero for joints
      that do not carry the link.
    - `gravity`: the gravity vector.
    """

    angular: tuple[Vector, ...]
    linear: tuple[Vector, ...]
    gravity: Vector


def link_twists(
    chain: Chain,
    *,
    cosines: Sequence[Any],
    sines: Sequence[Any],
    a: Sequence[Any],
    d: Sequence[Any],
    b: Sequence[Any],
    gravity: Vector,
    reduce: Reduce = unchanged,
) -> tuple[LinkTwists, ...]:
    """Return the columns of every link's geometric Jacobian, in the link's frame.

    They are what Eqn. 2.3-24 needs of the transforms: dT_i/dq_j = T_i X_j, where X_j is the
    4 x 4 twist of joint j in frame i, so that the rotation in T_i drops out of the
    trace: Tr(dT_i/dq_j I_i dT_i'/dq_k) = Tr(X_j I_i X_k'). Multiplying the transforms out first,
    as the equation is written, gives the same polynomials through ones that are far larger.

    The same code serves every kind of number: polynomials, rationals, arrays.

    **Arguments**

    - `cosines`, `sines`: of each of `chain.angles`.
    - `a`, `d`, `b`: lengths and offsets of each joint's row, the variable of a prismatic joint
      included.
    - `gravity`: gravity vector in the base frame.
    - `reduce`: brings a product of polynomials into normal form.

    **Returns** one `LinkTwists` a link.
    """
    # For every link: Jacobian columns and gravity in the axes of its group of parallel axes, and
    # the rotation from there about the common axis.
    in_group: list[tuple[list[Vector], list[Vector], Vector, Rotation]] = []
    twists: list[LinkTwists] = []
    for i, link in enumerate(chain.links):
        angular: list[Vector] = []
        linear: list[Vector] = []
        weight, turn, side = gravity, (1, 0), 1
        if link.parent >= 0:
            angular, linear, weight, turn = in_group[link.parent]
            side = chain.links[link.parent].side
        turn = compose(turn, link.branch, side)
        cos_twist, sin_twist = link.twist
        if link.joins_group:
            height = plus(signed(side, b[i]), signed(link.side, d[i]))
            step = (times(turn[0], a[i]), times(turn[1], a[i]), height)
            linear = _moved(angular, linear, step, reduce)
        else:
            angular = [_into_frame(w, turn, side, reduce) for w in angular]
            linear = [_into_frame(v, turn, side, reduce) for v in linear]
            weight = _into_frame(weight, turn, side, reduce)
            step = (
                a[i],
                minus(times(sin_twist, d[i])),
                plus(times(cos_twist, d[i]), b[i]),
            )
            linear = _moved(angular, linear, step, reduce)
            angular = [unrotate("x", w, link.twist) for w in angular]
            linear = [unrotate("x", v, link.twist) for v in linear]
            weight = unrotate("x", weight, link.twist)
        if link.angle is None:
            turn = link.offset
        else:
            turn = compose(link.offset, (cosines[link.angle], sines[link.angle]))
        axis: Vector = (0, 0, link.side)
        apart = [ZERO] * (i - len(angular))  # joints that do not carry this link
        angular = [*angular, *apart, ZERO if link.prismatic else axis]
        linear = [*linear, *apart, axis if link.prismatic else ZERO]
        in_group.append((angular, linear, weight, turn))
        twists.append(
            LinkTwists(
                tuple(_into_frame(w, turn, link.side, reduce) for w in angular),
                tuple(_into_frame(v, turn, link.side, reduce) for v in linear),
                _into_frame(weight, turn, link.side, reduce),
            )
        )
    return tuple(twists)


def _moved(
    angular: Sequence[Vector], linear: Sequence[Vector], step: Vector, reduce: Reduce
) -> list[Vector]:
    """Velocities of a point a step further out on the same body."""
    return [add(v, cross(w, step, reduce)) for w, v in zip(angular, linear, strict=True)]


def _into_frame(x: Vector, turn: Rotation, side: int, reduce: Reduce) -> Vector:
    """Transform a vector from the axes of a group into the frame of one of its links.

    This is Rot(z, -angle), then a flip.
    """
    along, across, axial = unrotate("z", x, turn, reduce)
    return (along, across, axial) if side > 0 else (along, minus(across), minus(axial))

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import fmpq

from ..manipulator import Joint, Manipulator
from ._exact import exact_cos_sin
from ._vectors import (
    ZERO,
    Reduce,
    Rotation,
    Vector,
    add,
    compose,
    cross,
    minus,
    plus,
    signed,
    times,
    unchanged,
    unrotate_x,
    unrotate_z,
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
    """How a link's frame follows from its parent's, with exact constant rotations.

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
        """The chain or tree of a robot's joints."""
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
        """The same chain with its constant rotations in another kind of number, as by `float`."""

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
    """The columns of every link's geometric Jacobian, in the link's frame.

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

    **Returns**

    - One `LinkTwists` a link.
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
            angular = [unrotate_x(w, link.twist) for w in angular]
            linear = [unrotate_x(v, link.twist) for v in linear]
            weight = unrotate_x(weight, link.twist)
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
    """From the axes of a group into the frame of one of its links: Rot(z, -angle), then a flip."""
    along, across, axial = unrotate_z(x, turn, reduce)
    return (along, across, axial) if side > 0 else (along, minus(across), minus(axial))

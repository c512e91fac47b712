from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import fmpq

from ..manipulator import Manipulator
from ._exact import exact_cos_sin


@dataclass(frozen=True)
class Angle:
    """An independent angle: a signed running sum of joint variables, as q2 + q3 in c23.

    Where consecutive revolute axes are parallel, only the sum of their angles turns the links
    behind them (thesis 2.6.2). Taking the sum as the variable keeps the tables small.

    `terms` are (joint, sign) pairs, joints counted from 0. With `wide`, as for robots of ten and
    more joints, labels keep the numbers apart: q1 + q2 is `1_2`, because `12` is q12.
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
    """How a link's frame follows from its parent's, with exact constant rotations."""

    parent: int  # -1: the base
    prismatic: bool
    branch: tuple[Any, Any]  # cos, sin of gamma
    twist: tuple[Any, Any]  # cos, sin of alpha
    joins_group: bool  # its axis is parallel or antiparallel to the axis before
    side: int  # +1 or -1: direction of its axis within the group of parallel axes
    angle: int | None  # index of the group's running angle after this joint
    offset: tuple[Any, Any]  # cos, sin of the constant part of that angle


@dataclass(frozen=True)
class Chain:
    """A robot's kinematics, sorted into groups of parallel axes (thesis 2.6.2).

    Joints are numbered outwards, so that a parent's index is below its children's.
    """

    links: tuple[ChainLink, ...]
    angles: tuple[Angle, ...]

    @classmethod
    def from_robot(cls, robot: Manipulator) -> "Chain":
        links: list[ChainLink] = []
        angles: list[Angle] = []
        wide = len(robot.joints) > 9
        for i, (joint, parent) in enumerate(zip(robot.joints, robot.parents, strict=True)):
            branch, twist = exact_cos_sin(joint.gamma), exact_cos_sin(joint.alpha)
            joins = parent >= 0 and twist[1] == 0
            if joins:
                before = links[parent]
                current, offset = before.angle, _rotate_by(before.offset, branch, before.side)
                side = before.side * int(twist[0])
            else:
                side, current, offset = 1, None, (fmpq(1), fmpq(0))
            offset = _rotate_by(offset, exact_cos_sin(joint.theta), side)
            if joint.kind == "R":
                terms = () if current is None else angles[current].terms
                current = len(angles)
                angles.append(Angle((*terms, (i, side)), wide))
            prismatic = joint.kind == "P"
            links.append(ChainLink(parent, prismatic, branch, twist, joins, side, current, offset))
        return cls(tuple(links), tuple(angles))


def _rotate_by(a: tuple[Any, Any], b: tuple[Any, Any], side: int) -> tuple[Any, Any]:
    """Cosine and sine of the sum of two angles, the second counted about an axis's own side."""
    cos, sin = b[0], _signed(side, b[1])
    return (
        _plus(_scale(a[0], cos), _minus(_scale(a[1], sin))),
        _plus(_scale(a[0], sin), _scale(a[1], cos)),
    )


Vector = tuple[Any, Any, Any]


@dataclass(frozen=True)
class LinkTwists:
    """Unit velocities of one link, expressed in its own frame.

    `angular[j]` and `linear[j]` are the angular velocity of the link and the velocity of its
    frame's origin when joint j alone moves at unit rate, for j up to the link: zero for joints
    that do not carry it; `gravity` is the gravity vector.
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
    reduce: Any = lambda x: x,
) -> tuple[LinkTwists, ...]:
    """The columns of every link's geometric Jacobian, in the link's own frame.

    They are what Eqn. 2.3-24 needs of the transforms: dT_i/dq_j = T_i X_j, where X_j is the
    4 x 4 twist of joint j seen from frame i, so that the rotation in T_i drops out of the
    trace: Tr(dT_i/dq_j I_i dT_i'/dq_k) = Tr(X_j I_i X_k'). Multiplying the transforms out first,
    as the equation is written, gives the same polynomials through ones that are far larger.

    One text for every kind of number: polynomials, rationals, arrays.

    **Arguments**

    - `cosines`, `sines`: of each of `chain.angles`.
    - `a`, `d`, `b`: lengths and offsets of each joint's row, the variable of a prismatic joint
      included.
    - `gravity`: gravity vector in the base frame.
    - `reduce`: brings a product of polynomials into normal form.

    **Returns** one `LinkTwists` a link.
    """
    nothing: Vector = (0, 0, 0)
    # For every link: Jacobian columns and gravity in the axes of its group of parallel axes, and
    # the rotation from there about the common axis.
    seen: list[tuple[list[Vector], list[Vector], Vector, tuple[Any, Any]]] = []
    twists: list[LinkTwists] = []
    for i, link in enumerate(chain.links):
        angular: list[Vector] = []
        linear: list[Vector] = []
        weight, turn, side = gravity, (1, 0), 1
        if link.parent >= 0:
            angular, linear, weight, turn = seen[link.parent]
            side = chain.links[link.parent].side
        turn = _rotate_by(turn, link.branch, side)
        cos_twist, sin_twist = link.twist
        if link.joins_group:
            height = _plus(_signed(side, b[i]), _signed(link.side, d[i]))
            step = (_scale(turn[0], a[i]), _scale(turn[1], a[i]), height)
            linear = _moved(angular, linear, step, reduce)
        else:
            angular = [_into_frame(w, turn, side, reduce) for w in angular]
            linear = [_into_frame(v, turn, side, reduce) for v in linear]
            weight = _into_frame(weight, turn, side, reduce)
            step = (
                a[i],
                _minus(_scale(sin_twist, d[i])),
                _plus(_scale(cos_twist, d[i]), b[i]),
            )
            linear = _moved(angular, linear, step, reduce)
            angular = [_untwist(w, cos_twist, sin_twist) for w in angular]
            linear = [_untwist(v, cos_twist, sin_twist) for v in linear]
            weight = _untwist(weight, cos_twist, sin_twist)
        cos_offset, sin_offset = link.offset
        if link.angle is None:
            turn = link.offset
        else:
            c, s = cosines[link.angle], sines[link.angle]
            turn = (_scale(cos_offset, c) - _scale(sin_offset, s),
                    _scale(sin_offset, c) + _scale(cos_offset, s))  # fmt: skip
        axis: Vector = (0, 0, link.side)
        apart = [nothing] * (i - len(angular))  # joints that do not carry this link
        angular = [*angular, *apart, nothing if link.prismatic else axis]
        linear = [*linear, *apart, axis if link.prismatic else nothing]
        seen.append((angular, linear, weight, turn))
        twists.append(
            LinkTwists(
                tuple(_into_frame(w, turn, link.side, reduce) for w in angular),
                tuple(_into_frame(v, turn, link.side, reduce) for v in linear),
                _into_frame(weight, turn, link.side, reduce),
            )
        )
    return tuple(twists)


def _moved(
    angular: Sequence[Vector], linear: Sequence[Vector], step: Vector, reduce: Any
) -> list[Vector]:
    """Velocities of a point a step further out on the same body."""
    return [_add(v, _cross(w, step, reduce)) for w, v in zip(angular, linear, strict=True)]


def _is_zero(x: Any) -> bool:
    """Exactly zero; an array never is, so that this never asks for its value."""
    return not hasattr(x, "shape") and x == 0


def _signed(side: int, x: Any) -> Any:
    return x if side > 0 else _minus(x)


def _scale(factor: Any, x: Any) -> Any:
    return 0 if _is_zero(factor) or _is_zero(x) else factor * x


def _plus(x: Any, y: Any) -> Any:
    return y if _is_zero(x) else (x if _is_zero(y) else x + y)


def _add(x: Vector, y: Vector) -> Vector:
    return _plus(x[0], y[0]), _plus(x[1], y[1]), _plus(x[2], y[2])


def _minus(x: Any) -> Any:
    return 0 if _is_zero(x) else -x


def _cross(x: Vector, y: Vector, reduce: Any) -> Vector:
    return (
        reduce(_plus(_scale(x[1], y[2]), _minus(_scale(x[2], y[1])))),
        reduce(_plus(_scale(x[2], y[0]), _minus(_scale(x[0], y[2])))),
        reduce(_plus(_scale(x[0], y[1]), _minus(_scale(x[1], y[0])))),
    )


def _into_frame(x: Vector, turn: tuple[Any, Any], side: int, reduce: Any) -> Vector:
    """From the axes of a group into the frame of one of its links: Rot(z, -angle), then a flip."""
    c, s = turn
    along = reduce(_plus(_scale(c, x[0]), _scale(s, x[1])))
    across = reduce(_plus(_scale(c, x[1]), _minus(_scale(s, x[0]))))
    return (along, across, x[2]) if side > 0 else (along, _minus(across), _minus(x[2]))


def _untwist(x: Vector, cos: Any, sin: Any) -> Vector:
    return (
        x[0],
        _plus(_scale(cos, x[1]), _scale(sin, x[2])),
        _plus(_scale(cos, x[2]), _minus(_scale(sin, x[1]))),
    )

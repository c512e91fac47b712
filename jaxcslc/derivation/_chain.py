from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sympy import QQ

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
    """How a link's frame follows from the one before, with exact constant rotations."""

    prismatic: bool
    twist: tuple[Any, Any]  # cos, sin of alpha
    joins_group: bool  # its axis is parallel or antiparallel to the axis before
    side: int  # +1 or -1: direction of its axis within the group of parallel axes
    angle: int | None  # index of the group's running angle after this joint
    offset: tuple[Any, Any]  # cos, sin of the constant part of that angle


@dataclass(frozen=True)
class Chain:
    """A robot's kinematics, sorted into groups of parallel axes (thesis 2.6.2)."""

    links: tuple[ChainLink, ...]
    angles: tuple[Angle, ...]

    @classmethod
    def from_robot(cls, robot: Manipulator) -> "Chain":
        links: list[ChainLink] = []
        angles: list[Angle] = []
        side, current, offset = 1, None, (QQ(1), QQ(0))
        wide = len(robot.joints) > 9
        for i, joint in enumerate(robot.joints):
            twist = exact_cos_sin(joint.alpha)
            joins = i > 0 and twist[1] == 0
            if joins:
                side = side * int(twist[0])
            else:
                side, current, offset = 1, None, (QQ(1), QQ(0))
            turn = exact_cos_sin(joint.theta)
            offset = _rotate(offset, (turn[0], side * turn[1]))
            if joint.kind == "R":
                before = () if current is None else angles[current].terms
                current = len(angles)
                angles.append(Angle((*before, (i, side)), wide))
            links.append(ChainLink(joint.kind == "P", twist, joins, side, current, offset))
        return cls(tuple(links), tuple(angles))


def _rotate(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


Vector = tuple[Any, Any, Any]


@dataclass(frozen=True)
class LinkTwists:
    """Unit velocities of one link, expressed in its own frame.

    `angular[j]` and `linear[j]` are the angular velocity of the link and the velocity of its
    frame's origin when joint j alone moves at unit rate; `gravity` is the gravity vector.
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
    - `a`, `d`: length and offset of each joint's row, the variable of a prismatic joint included.
    - `gravity`: gravity vector in the base frame.
    - `reduce`: brings a product of polynomials into normal form.

    **Returns** one `LinkTwists` a link.
    """
    twists: list[LinkTwists] = []
    angular: list[Vector] = []  # in the axes of the current group of parallel axes
    linear: list[Vector] = []
    turn: tuple[Any, Any] = (1, 0)
    side = 1
    for i, link in enumerate(chain.links):
        cos_twist, sin_twist = link.twist
        if link.joins_group:
            step = (turn[0] * a[i], turn[1] * a[i], link.side * d[i])
            linear = [
                _add(v, _cross(w, step, reduce)) for w, v in zip(angular, linear, strict=True)
            ]
        else:
            step = (a[i], -sin_twist * d[i], cos_twist * d[i])
            angular = [_into_frame(w, turn, side, reduce) for w in angular]
            linear = [_into_frame(v, turn, side, reduce) for v in linear]
            linear = [
                _add(v, _cross(w, step, reduce)) for w, v in zip(angular, linear, strict=True)
            ]
            gravity = _into_frame(gravity, turn, side, reduce)
            angular = [_untwist(w, cos_twist, sin_twist) for w in angular]
            linear = [_untwist(v, cos_twist, sin_twist) for v in linear]
            gravity = _untwist(gravity, cos_twist, sin_twist)
        side = link.side
        cos_offset, sin_offset = link.offset
        if link.angle is None:
            turn = link.offset
        else:
            c, s = cosines[link.angle], sines[link.angle]
            turn = (_scale(cos_offset, c) - _scale(sin_offset, s),
                    _scale(sin_offset, c) + _scale(cos_offset, s))  # fmt: skip
        axis, nothing = (0, 0, side), (0, 0, 0)
        angular.append(nothing if link.prismatic else axis)
        linear.append(axis if link.prismatic else nothing)
        twists.append(
            LinkTwists(
                tuple(_into_frame(w, turn, side, reduce) for w in angular),
                tuple(_into_frame(v, turn, side, reduce) for v in linear),
                _into_frame(gravity, turn, side, reduce),
            )
        )
    return tuple(twists)


def _is_zero(x: Any) -> bool:
    """Exactly zero; an array never is, so that this never asks for its value."""
    return not hasattr(x, "shape") and x == 0


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

"""Newton and Euler's recursion over any kind of number: rationals, floats, arrays, expressions.

It gives torque, mass matrix and regressor columns (Luh, Walker and Paul 1980; Walker and Orin
1982). `jaxcslc.network` runs it over the expressions of generated code.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..manipulator import TENSOR_ENTRIES
from ._chain import (
    ZERO,
    Chain,
    Matrix,
    Rotation,
    Vector,
    add,
    cross,
    dot,
    product,
    rotate,
    scale,
    unrotate,
)


Body = Sequence[Any]  # the ten numbers of `BODY`


@dataclass(frozen=True)
class LinkFrame:
    """Pose of a link's frame in its parent's frame, at one position of the joints.

    **Attributes**

    - `parent`: index of the link that carries it; -1 for the base.
    - `prismatic`: whether its joint slides along z; otherwise it turns about z.
    - `branch`, `twist`, `joint`: rotations about the parent's z, then x, then the link's z.
    - `step`: the frame's origin, in the parent's frame [m].
    """

    parent: int
    prismatic: bool
    branch: Rotation
    twist: Rotation
    joint: Rotation
    step: Vector

    def inwards(self, x: Vector) -> Vector:
        """Return a vector's components in the parent's axes, from those in the link's."""
        return rotate("z", rotate("x", rotate("z", x, self.joint), self.twist), self.branch)

    def outwards(self, x: Vector) -> Vector:
        """Return a vector's components in the link's axes, from those in the parent's."""
        return unrotate("z", unrotate("x", unrotate("z", x, self.branch), self.twist), self.joint)

    def along(self, force: Vector, moment: Vector) -> Any:
        """Return the part of a wrench that the joint's motor bears."""
        return force[2] if self.prismatic else moment[2]


def link_frames(
    chain: Chain,
    *,
    rotations: Sequence[Rotation],
    a: Sequence[Any],
    d: Sequence[Any],
    b: Sequence[Any],
) -> tuple[LinkFrame, ...]:
    """Return the links' frames at one position (modified Denavit-Hartenberg, Eqn. 2.6-1).

    **Arguments**

    - `chain`: its constant rotations in the kind of number that is wanted (`Chain.in_numbers`).
    - `rotations`: cosine and sine of each joint's whole angle about z: the constant part, plus the
      variable of a revolute joint.
    - `a`, `d`, `b`: lengths and offsets of each joint's row, the variable of a prismatic joint
      included.

    **Returns** one frame a link.
    """
    frames: list[LinkFrame] = []
    for link, rotation, x, z, base in zip(chain.links, rotations, a, d, b, strict=True):
        twisted = rotate("x", (0, 0, z), link.twist)
        step = rotate("z", add((x, 0, 0), twisted), link.branch)
        frames.append(
            LinkFrame(
                link.parent,
                link.prismatic,
                link.branch,
                link.twist,
                rotation,
                add(step, (0, 0, base)),
            )
        )
    return tuple(frames)


@dataclass(frozen=True)
class LinkState:
    """A link's motion in its own axes.

    **Attributes**

    - `w`, `wd`: angular velocity and acceleration.
    - `a`: acceleration of the frame's origin, less gravity.
    - `spin`: the matrix [wd]× + [w]×[w]×, which gives a point's acceleration from its position.
    """

    w: Vector
    wd: Vector
    a: Vector
    spin: Matrix


@dataclass(frozen=True)
class NewtonEuler:
    """The recursive Newton-Euler equations over any kind of number (Luh, Walker and Paul 1980).

    The same code serves rationals, floats, arrays and the expressions of generated code: it needs
    sums, differences and products only. Bodies are ten numbers each, in the order of
    `BODY`, about the frame of the link that they belong to; motors are the inertia that each joint
    adds to its own.

    **Attributes**

    - `frames`: of every link, from `link_frames`.
    - `gravity`: in the base frame.

    A mass of 2 at 0.5 from a horizontal axis, exactly:

    >>> from fractions import Fraction
    >>> from jaxcslc.derivation import LinkFrame, NewtonEuler
    >>> straight = (1, 0)
    >>> frame = LinkFrame(-1, False, straight, straight, straight, (0, 0, 0))
    >>> arm = NewtonEuler((frame,), (0, Fraction(-981, 100), 0))
    >>> arm.torque([[0, 0, 0, 0, 0, 0, 1, 0, 0, 2]], [0], [0], [0])
    [Fraction(981, 100)]
    """

    frames: tuple[LinkFrame, ...]
    gravity: Vector

    def torque(
        self,
        bodies: Sequence[Body],
        motors: Sequence[Any],
        qd: Sequence[Any],
        qdd: Sequence[Any],
    ) -> list[Any]:
        """Torque of every joint: the wrench that moves each body, summed towards the base."""
        states = self.states(qd, qdd)
        wrenches = [_wrench(state, body) for state, body in zip(states, bodies, strict=True)]
        torque: list[Any] = [0] * len(wrenches)
        for i in reversed(range(len(wrenches))):
            frame = self.frames[i]
            torque[i] = frame.along(*wrenches[i])
            if frame.parent >= 0:
                force, moment = self._in_parent(i, *wrenches[i])
                carried = wrenches[frame.parent]
                wrenches[frame.parent] = add(carried[0], force), add(carried[1], moment)
        return [x + motor * rate for x, motor, rate in zip(torque, motors, qdd, strict=True)]

    def mass_matrix(self, bodies: Sequence[Body], motors: Sequence[Any]) -> list[list[Any]]:
        """Mass matrix by composite rigid bodies, from the tips inwards (Walker and Orin 1982)."""
        n = len(self.frames)
        composite = [list(body) for body in bodies]
        matrix: list[list[Any]] = [[0] * n for _ in range(n)]
        for i in reversed(range(n)):
            frame = self.frames[i]
            force, moment = _momentum(composite[i], frame.prismatic)
            matrix[i][i] = frame.along(force, moment) + motors[i]
            outer, inner = i, frame.parent
            while inner >= 0:
                force, moment = self._in_parent(outer, force, moment)
                matrix[inner][i] = matrix[i][inner] = self.frames[inner].along(force, moment)
                outer, inner = inner, self.frames[inner].parent
            if frame.parent >= 0:
                moved = _body_in_parent(frame, composite[i])
                carried = composite[frame.parent]
                composite[frame.parent] = [x + y for x, y in zip(carried, moved, strict=True)]
        return matrix

    def columns(
        self, bodies: Sequence[tuple[int, Body]], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[list[Any]]:
        """Torque of every joint (rows) for every body alone (columns), given with its link."""
        states = self.states(qd, qdd)
        rows: list[list[Any]] = [[0] * len(bodies) for _ in self.frames]
        for column, (link, body) in enumerate(bodies):
            force, moment = _wrench(states[link], body)
            at = link
            while at >= 0:
                rows[at][column] = self.frames[at].along(force, moment)
                force, moment = self._in_parent(at, force, moment)
                at = self.frames[at].parent
        return rows

    def states(self, qd: Sequence[Any], qdd: Sequence[Any]) -> list[LinkState]:
        """Return the outward recursion: motion of every link."""
        base = LinkState(ZERO, ZERO, scale(-1, self.gravity), _spin(ZERO, ZERO))
        states: list[LinkState] = []
        for frame, rate, gain in zip(self.frames, qd, qdd, strict=True):
            before = states[frame.parent] if frame.parent >= 0 else base
            a = frame.outwards(add(before.a, product(before.spin, frame.step)))
            w, wd = frame.outwards(before.w), frame.outwards(before.wd)
            relative = w[1] * rate, -(w[0] * rate), gain  # w x (0, 0, qd) + (0, 0, qdd)
            if frame.prismatic:
                a = add(a, (2 * relative[0], 2 * relative[1], gain))
            else:
                w, wd = (w[0], w[1], w[2] + rate), add(wd, relative)
            states.append(LinkState(w, wd, a, _spin(w, wd)))
        return states

    def _in_parent(self, i: int, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """A wrench about link i's origin as one about its parent's."""
        frame = self.frames[i]
        force, moment = frame.inwards(force), frame.inwards(moment)
        return force, add(moment, cross(frame.step, force))


def _spin(w: Vector, wd: Vector) -> Matrix:
    xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return (
        (-(yy + zz), xy - wd[2], xz + wd[1]),
        (xy + wd[2], -(xx + zz), yz - wd[0]),
        (xz - wd[1], yz + wd[0], -(xx + yy)),
    )


def _wrench(state: LinkState, body: Body) -> tuple[Vector, Vector]:
    """Force, and moment about the frame's origin, that move a body."""
    first: Vector = (body[6], body[7], body[8])
    force = add(scale(body[9], state.a), product(state.spin, first))
    return force, add(_tensor_moment(body, state), cross(first, state.a))


def _tensor_moment(body: Body, state: LinkState) -> Vector:
    """Compute I wd + w × I w, entry by entry of I; `spin` multiplies products of inertia."""
    xx, yy, zz, xy, xz, yz = body[:6]
    w, wd, s = state.w, state.wd, state.spin
    return (
        xx * wd[0] + (zz - yy) * (w[1] * w[2])
        + yz * (s[1][1] - s[2][2]) - xy * s[2][0] + xz * s[1][0],
        yy * wd[1] + (xx - zz) * (w[0] * w[2])
        + xz * (s[2][2] - s[0][0]) + xy * s[2][1] - yz * s[0][1],
        zz * wd[2] + (yy - xx) * (w[0] * w[1])
        + xy * (s[0][0] - s[1][1]) - xz * s[1][2] + yz * s[0][2],
    )  # fmt: skip


def _tensor_row(body: Body, axis: int) -> Vector:
    """A row of the inertia tensor among the ten numbers."""
    x, y, z = ((0, 3, 4), (3, 1, 5), (4, 5, 2))[axis]
    return body[x], body[y], body[z]


def _momentum(body: Body, prismatic: bool) -> tuple[Vector, Vector]:
    """Force and moment for a unit acceleration along, or about, the link's z axis."""
    first: Vector = (body[6], body[7], body[8])
    axis: Vector = (0, 0, 1)
    if prismatic:
        return scale(body[9], axis), cross(first, axis)
    return cross(axis, first), _tensor_row(body, 2)


def _body_in_parent(frame: LinkFrame, body: Body) -> list[Any]:
    """Ten numbers about the parent's frame, of a body that moves with the link."""
    # R I Rᵀ: by columns, then by rows of the result.
    half = [frame.inwards(_tensor_row(body, axis)) for axis in range(3)]
    tensor = [frame.inwards((half[0][a], half[1][a], half[2][a])) for a in range(3)]
    first, mass, step = frame.inwards((body[6], body[7], body[8])), body[9], frame.step
    # Parallel axes: tr(S) 1 - S with S the symmetric part of p (2 h + m p)ᵀ.
    trace = dot(step, add(add(first, first), scale(mass, step)))

    def entry(a: int, b: int) -> Any:
        outer = step[a] * first[b] + step[b] * first[a] + mass * step[a] * step[b]
        rotated = tensor[a][b] - outer
        return rotated + trace if a == b else rotated

    return [*(entry(a, b) for a, b in TENSOR_ENTRIES), *add(first, scale(mass, step)), mass]

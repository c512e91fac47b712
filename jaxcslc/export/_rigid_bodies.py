import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..manipulator import Joint, Manipulator
from ._expressions import Expressions, Value, Vector


# A rotation's entry this close to 0 or 1 is meant to be it.
_RIGHT_ANGLE = 1e-14


@dataclass(frozen=True)
class State:
    """One link's motion in its own frame: angular velocity and acceleration, and the acceleration
    of the frame's origin minus gravity; `spin` is the matrix [wd]× + [w]×[w]×."""

    w: Vector
    wd: Vector
    a: Vector
    spin: tuple[Vector, Vector, Vector]


class RigidBodies:
    """A robot's equations of motion over expressions: Newton-Euler, link by link.

    `bodies` are constants, the ten numbers (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m) of each link
    about its frame; `motors` the inertia that each joint adds to its own.
    """

    def __init__(self, graph: Expressions, robot: Manipulator) -> None:
        self.graph, self.robot = graph, robot
        self.q = [graph.input(f"q[{i}]") for i in range(robot.joint_count)]
        self.qd = [graph.input(f"qd[{i}]") for i in range(robot.joint_count)]
        self.qdd = [graph.input(f"qdd[{i}]") for i in range(robot.joint_count)]
        self.still = [graph.constant(0.0)] * robot.joint_count

    def torque(
        self, bodies: Float[np.ndarray, "links 10"], motors: Float[np.ndarray, " links"]
    ) -> list[Value]:
        """Rigid-body torque of every joint."""
        states = self.states(self.qd, self.qdd, gravity=True)
        torque = self._inward([self._wrench(s, b) for s, b in zip(states, bodies, strict=True)])
        return [
            t + float(motor) * qdd for t, motor, qdd in zip(torque, motors, self.qdd, strict=True)
        ]

    def gravity(self, bodies: Float[np.ndarray, "links 10"]) -> list[Value]:
        """Torque at rest."""
        states = self.states(self.still, self.still, gravity=True)
        return self._inward([self._wrench(s, b) for s, b in zip(states, bodies, strict=True)])

    def mass_matrix(
        self, bodies: Float[np.ndarray, "links 10"], motors: Float[np.ndarray, " links"]
    ) -> list[list[Value]]:
        """Composite rigid bodies (Walker and Orin 1982), from the tips inwards."""
        n, zero = self.robot.joint_count, self.graph.constant(0.0)
        composite = [[self.graph.constant(float(x)) for x in body] for body in bodies]
        matrix = [[zero] * n for _ in range(n)]
        for i in reversed(range(n)):
            parent = self.robot.parents[i]
            axis = self._axis(i)
            force, moment = _momentum(composite[i], *axis)
            matrix[i][i] = self._along(i, force, moment) + float(motors[i])
            at, inner = i, parent
            while inner >= 0:
                force, moment = self._outwards_in(at, force, moment)
                matrix[inner][i] = matrix[i][inner] = self._along(inner, force, moment)
                at, inner = inner, self.robot.parents[inner]
            if parent >= 0:
                moved = self._body_in_parent(i, composite[i])
                composite[parent] = [x + y for x, y in zip(composite[parent], moved, strict=True)]
        return matrix

    def columns(
        self, directions: Sequence[tuple[int, Float[np.ndarray, "10"]]]
    ) -> list[list[Value]]:
        """Torque of every joint (rows) for bodies given as (link, ten numbers) (columns)."""
        states = self.states(self.qd, self.qdd, gravity=True)
        n, zero = self.robot.joint_count, self.graph.constant(0.0)
        rows = [[zero] * len(directions) for _ in range(n)]
        for column, (link, body) in enumerate(directions):
            force, moment = self._wrench(states[link], body)
            at = link
            while at >= 0:
                rows[at][column] = self._along(at, force, moment)
                force, moment = self._outwards_in(at, force, moment)
                at = self.robot.parents[at]
        return rows

    def states(self, qd: Sequence[Value], qdd: Sequence[Value], *, gravity: bool) -> list[State]:
        """Outward recursion."""
        zero = self.graph.constant(0.0)
        still = (zero, zero, zero)
        g = self.robot.gravity if gravity else (0.0, 0.0, 0.0)
        up = (self.graph.constant(-g[0]), self.graph.constant(-g[1]), self.graph.constant(-g[2]))
        base = State(still, still, up, _spin(still, still))
        states: list[State] = []
        for i, joint in enumerate(self.robot.joints):
            parent = self.robot.parents[i]
            before = states[parent] if parent >= 0 else base
            a = _add(before.a, _times(before.spin, self._step(i)))
            w, wd, a = (self._into(i, x) for x in (before.w, before.wd, a))
            if joint.kind == "R":
                wd = (wd[0] + w[1] * qd[i], wd[1] - w[0] * qd[i], wd[2] + qdd[i])
                w = (w[0], w[1], w[2] + qd[i])
            else:
                a = (a[0] + 2 * (w[1] * qd[i]), a[1] - 2 * (w[0] * qd[i]), a[2] + qdd[i])
            states.append(State(w, wd, a, _spin(w, wd)))
        return states

    def _wrench(self, state: State, body: Float[np.ndarray, "10"]) -> tuple[Vector, Vector]:
        """Force, and moment about the frame's origin, that move a body."""
        first = _vector(self.graph, body[6:9])
        mass = self.graph.constant(float(body[9]))
        force = _add(_scale(mass, state.a), _times(state.spin, first))
        moment = _add(_turned(self.graph, body, state), _cross(first, state.a))
        return force, moment

    def _inward(self, wrenches: list[tuple[Vector, Vector]]) -> list[Value]:
        torque = [self.graph.constant(0.0)] * len(wrenches)
        for i in reversed(range(len(wrenches))):
            torque[i] = self._along(i, *wrenches[i])
            parent = self.robot.parents[i]
            if parent >= 0:
                force, moment = self._outwards_in(i, *wrenches[i])
                wrenches[parent] = (
                    _add(wrenches[parent][0], force),
                    _add(wrenches[parent][1], moment),
                )
        return torque

    def _axis(self, i: int) -> tuple[bool, Vector]:
        zero, one = self.graph.constant(0.0), self.graph.constant(1.0)
        return self.robot.joints[i].kind == "R", (zero, zero, one)

    def _along(self, i: int, force: Vector, moment: Vector) -> Value:
        return moment[2] if self.robot.joints[i].kind == "R" else force[2]

    def _angles(self, i: int) -> list[tuple[int, Value, Value]]:
        """Axis (0 for x, 2 for z), cosine and sine of the turns from the parent to the link."""
        joint = self.robot.joints[i]
        turns = [(2, *self._cos_sin(joint.gamma)), (0, *self._cos_sin(joint.alpha))]
        if joint.kind == "P":
            return [*turns, (2, *self._cos_sin(joint.theta))]
        quarter = round(joint.theta / (math.pi / 2))
        rest = joint.theta - quarter * (math.pi / 2)
        angle = self.q[i] if abs(rest) < _RIGHT_ANGLE else self.q[i] + rest
        c, s = self.graph.apply("cos", angle), self.graph.apply("sin", angle)
        for _ in range(quarter % 4):
            c, s = -s, c
        return [*turns, (2, c, s)]

    def _cos_sin(self, angle: float) -> tuple[Value, Value]:
        c, s = (
            float(round(x)) if abs(x - round(x)) < _RIGHT_ANGLE else x
            for x in (math.cos(angle), math.sin(angle))
        )
        return self.graph.constant(c), self.graph.constant(s)

    def _step(self, i: int) -> Vector:
        """Where the link's origin is, in its parent's frame."""
        joint = self.robot.joints[i]
        d = self.graph.constant(_value(joint, "d"))
        if joint.kind == "P":
            d = d + self.q[i]
        c, s = self._cos_sin(joint.alpha)
        place = (self.graph.constant(_value(joint, "a")), -(s * d), c * d)
        place = _turn(place, 2, *self._cos_sin(joint.gamma))
        return place[0], place[1], place[2] + _value(joint, "b")

    def _into(self, i: int, x: Vector) -> Vector:
        """From the parent's axes into the link's."""
        for axis, c, s in self._angles(i):
            x = _turn(x, axis, c, -s)
        return x

    def _out(self, i: int, x: Vector) -> Vector:
        for axis, c, s in reversed(self._angles(i)):
            x = _turn(x, axis, c, s)
        return x

    def _outwards_in(self, i: int, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
        """A link's wrench as its parent's."""
        force, moment = self._out(i, force), self._out(i, moment)
        return force, _add(moment, _cross(self._step(i), force))

    def _body_in_parent(self, i: int, body: Sequence[Value]) -> list[Value]:
        """Ten numbers about the parent's frame, of a body that moves with the link."""
        columns = [_row(body, a) for a in range(3)]
        half = [self._out(i, column) for column in columns]  # R I, column by column
        tensor = [self._out(i, (half[0][a], half[1][a], half[2][a])) for a in range(3)]
        first = self._out(i, (body[6], body[7], body[8]))
        step, mass = self._step(i), body[9]
        # I + terms of h = R h + m p: the parallel axes in one, p (2 h + m p) symmetrised.
        lever = _add(_add(first, first), _scale(mass, step))
        dot = total_product(step, lever)
        moved = {}
        for a in range(3):
            for b in range(a, 3):
                # tr(S) 1 - S with S the symmetric part of p (2 h + m p)ᵀ; h appears twice.
                cross = step[a] * first[b] + step[b] * first[a] + mass * step[a] * step[b]
                moved[a, b] = tensor[a][b] - cross
                if a == b:
                    moved[a, b] = moved[a, b] + dot
        whole = _add(first, _scale(mass, step))
        return [
            *(moved[a, a] for a in range(3)),
            *(moved[a, b] for a, b in ((0, 1), (0, 2), (1, 2))),
            *whole,
            mass,
        ]


def total_product(x: Vector, y: Vector) -> Value:
    """Of two vectors."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def _value(joint: Joint, letter: str) -> float:
    return float(getattr(joint, letter).value or 0.0)


def _vector(graph: Expressions, numbers: Float[np.ndarray, "3"]) -> Vector:
    x, y, z = (graph.constant(float(number)) for number in numbers)
    return x, y, z


def _add(x: Vector, y: Vector) -> Vector:
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


def _scale(factor: Value, x: Vector) -> Vector:
    return factor * x[0], factor * x[1], factor * x[2]


def _cross(x: Vector, y: Vector) -> Vector:
    return (
        x[1] * y[2] - x[2] * y[1],
        x[2] * y[0] - x[0] * y[2],
        x[0] * y[1] - x[1] * y[0],
    )


def _turn(x: Vector, axis: int, c: Value, s: Value) -> Vector:
    """A vector turned about the x or the z axis."""
    if axis == 2:
        return c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]
    return x[0], c * x[1] - s * x[2], s * x[1] + c * x[2]


def _spin(w: Vector, wd: Vector) -> tuple[Vector, Vector, Vector]:
    xx, yy, zz = w[0] * w[0], w[1] * w[1], w[2] * w[2]
    xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
    return (
        (-(yy + zz), xy - wd[2], xz + wd[1]),
        (xy + wd[2], -(xx + zz), yz - wd[0]),
        (xz - wd[1], yz + wd[0], -(xx + yy)),
    )


def _times(matrix: tuple[Vector, Vector, Vector], x: Vector) -> Vector:
    return (
        total_product(matrix[0], x),
        total_product(matrix[1], x),
        total_product(matrix[2], x),
    )


def _row(body: Sequence[Value], a: int) -> Vector:
    """A row of the inertia tensor among ten numbers."""
    places = ((0, 3, 4), (3, 1, 5), (4, 5, 2))[a]
    return body[places[0]], body[places[1]], body[places[2]]


def _turned(graph: Expressions, body: Float[np.ndarray, "10"], state: State) -> Vector:
    """I wd + w × I w, entry by entry of I: what each is multiplied by stands in `spin`."""
    xx, yy, zz, xy, xz, yz = (graph.constant(float(x)) for x in body[:6])
    w, wd, s = state.w, state.wd, state.spin
    return (
        xx * wd[0] + (zz - yy) * (w[1] * w[2])
        + yz * (s[1][1] - s[2][2]) - xy * s[2][0] + xz * s[1][0],
        yy * wd[1] + (xx - zz) * (w[0] * w[2])
        + xz * (s[2][2] - s[0][0]) + xy * s[2][1] - yz * s[0][1],
        zz * wd[2] + (yy - xx) * (w[0] * w[1])
        + xy * (s[0][0] - s[1][1]) - xz * s[1][2] + yz * s[0][2],
    )  # fmt: skip


def _momentum(body: Sequence[Value], turns: bool, axis: Vector) -> tuple[Vector, Vector]:
    """Force and moment for a unit acceleration about, or along, the link's z axis."""
    first = (body[6], body[7], body[8])
    if turns:
        return _cross(axis, first), _row(body, 2)
    return _scale(body[9], axis), _cross(first, axis)

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Algebra
from ..manipulator import Joint
from ._evaluator import AbstractEvaluator, Coefficients, Joints, Matrices, Regressor


class _LinkState(NamedTuple):
    """One link's motion in its own frame, and its Jacobian: a column a joint that carries it."""

    angular_velocity: Float[Array, "*batch 3"]
    angular_acceleration: Float[Array, "*batch 3"]
    acceleration: Float[Array, "*batch 3"]  # of the frame's origin, minus gravity
    angular_jacobian: Float[Array, "*batch 3 _"]
    linear_jacobian: Float[Array, "*batch 3 _"]


class RecursiveEvaluator(AbstractEvaluator):
    """Newton-Euler over link parameters, for robots whose closed-form tables are large.

    Cost grows with the square of the number of joints, not with the number of monomials. It
    needs numeric lengths: then each base parameter is one link parameter plus what is regrouped
    into it, and torque is what the chosen link parameters alone produce when they are set to
    the base parameters and all others to zero. (In matrices: k = L θ with L in reduced echelon
    form, so selecting the chosen columns is a right inverse of L.)

    `body` holds, for every link, the (10, chosen) matrix from its chosen parameters to
    (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), as nested tuples. `paths` lists the joints that carry
    each link, from the base outwards.
    """

    body: tuple[tuple[tuple[float, ...], ...], ...] = eqx.field(static=True)
    joints: tuple[Joint, ...] = eqx.field(static=True)
    gravity: tuple[float, float, float] = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    motors: tuple[tuple[int, int], ...] = eqx.field(static=True)
    paths: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    size: int = eqx.field(static=True)

    @classmethod
    def from_algebra(cls, algebra: Algebra) -> "RecursiveEvaluator":
        """**Raises** `ValueError` if the algebra kept lengths symbolic."""
        if algebra.lengths != "numeric":
            raise ValueError(
                "the recursive evaluator needs numeric lengths: symbolic coefficients are not"
                " independent once lengths have values; derive with lengths='numeric'"
            )
        n = algebra.robot.joint_count
        places: list[list[int]] = [[] for _ in range(n)]
        columns: list[list[list[float]]] = [[] for _ in range(n)]
        motors: list[tuple[int, int]] = []
        for place, index in enumerate(algebra.chosen):
            term = algebra.terms[index]
            if term.factors == ("motor",):
                motors.append((term.link, place))
            else:
                column = [0.0] * 10
                for entry, multiple in term.body:
                    column[_BODY.index(entry)] += multiple
                places[term.link].append(place)
                columns[term.link].append(column)
        return cls(
            tuple(tuple(zip(*c, strict=True)) if c else ((),) * 10 for c in columns),
            algebra.robot.joints,
            algebra.robot.gravity,
            tuple(tuple(p) for p in places),
            tuple(motors),
            _paths(algebra.robot.parents),
            len(algebra.chosen),
        )

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        # Joint j carries the links whose path it is on, and its own motor.
        return tuple(
            tuple(
                sorted(
                    [
                        place
                        for path, places in zip(self.paths, self.places, strict=True)
                        if joint in path
                        for place in places
                    ]
                    + [place for motor, place in self.motors if motor == joint]
                )
            )
            for joint in range(len(self.joints))
        )

    def columns(
        self,
        q: Float[Array, "joints samples"],
        qd: Float[Array, "joints samples"],
        qdd: Float[Array, "joints samples"],
    ) -> tuple[Float[Array, "_ samples"], ...]:
        regressor = self.regressor(q.T, qd.T, qdd.T)
        return tuple(
            regressor[:, joint, np.array(support, dtype=int)].T
            for joint, support in enumerate(self.support)
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        if self.size == 0:
            return jnp.zeros((*q.shape, 0), q.dtype)
        columns: list[Array] = [jnp.zeros_like(q)] * self.size
        for link, state in enumerate(self._propagate(q, qd, qdd, self.gravity)):
            body = jnp.asarray(np.array(self.body[link]), q.dtype)
            force, moment = _wrench_regressor(state)
            block = jnp.swapaxes(state.angular_jacobian, -1, -2) @ (moment @ body) + jnp.swapaxes(
                state.linear_jacobian, -1, -2
            ) @ (force @ body)
            block = self._spread(block, link, axis=-2)
            for column, place in enumerate(self.places[link]):
                columns[place] = block[..., column]
        for joint, place in self.motors:
            columns[place] = jnp.zeros_like(q).at[..., joint].set(qdd[..., joint])
        return jnp.stack(columns, axis=-1)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        return self._torque(k, q, qd, qdd, self.gravity)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        return self._torque(k, q, qd, jnp.zeros_like(q), (0.0, 0.0, 0.0))

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        still = jnp.zeros_like(q)
        return self._torque(k, q, still, still, self.gravity)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        still = jnp.zeros_like(q)
        n = q.shape[-1]
        total = jnp.zeros((*q.shape, n), q.dtype)
        for link, state in enumerate(self._propagate(q, still, still, (0.0, 0.0, 0.0))):
            inertia, first, mass = self._body(k, link)
            angular, linear = state.angular_jacobian, state.linear_jacobian
            # J' I J of the rigid body: w' I w + v' m v + h . (v x w) both ways.
            cross = _skew(first)
            product = jnp.swapaxes(angular, -1, -2) @ (
                inertia @ angular + cross @ linear
            ) + jnp.swapaxes(linear, -1, -2) @ (mass * linear - cross @ angular)
            total = total + self._spread(self._spread(product, link, axis=-1), link, axis=-2)
        motor = jnp.zeros(n, q.dtype)
        for joint, place in self.motors:
            motor = motor.at[joint].set(k[place])
        return total + jnp.broadcast_to(jnp.diag(motor), total.shape)

    def _torque(
        self, k: Array, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> Array:
        total = jnp.zeros_like(q)
        for link, state in enumerate(self._propagate(q, qd, qdd, gravity)):
            inertia, first, mass = self._body(k, link)
            w, wd, a = state.angular_velocity, state.angular_acceleration, state.acceleration
            force = mass * a + jnp.cross(wd, first) + jnp.cross(w, jnp.cross(w, first))
            moment = wd @ inertia + jnp.cross(w, w @ inertia) + jnp.cross(first, a)
            block = jnp.einsum("...xj,...x->...j", state.angular_jacobian, moment) + jnp.einsum(
                "...xj,...x->...j", state.linear_jacobian, force
            )
            total = total + self._spread(block, link, axis=-1)
        for joint, place in self.motors:
            total = total.at[..., joint].add(k[place] * qdd[..., joint])
        return total

    def _body(self, k: Array, link: int) -> tuple[Array, Array, Array]:
        """Inertia tensor (3, 3), first moment (3,) and mass that the coefficients give a link."""
        places = np.array(self.places[link], dtype=int)
        ten = jnp.asarray(np.array(self.body[link]), k.dtype) @ k[places]
        xx, yy, zz, xy, xz, yz = (ten[i] for i in range(6))
        tensor = jnp.stack(
            [jnp.stack([xx, xy, xz]), jnp.stack([xy, yy, yz]), jnp.stack([xz, yz, zz])]
        )
        return tensor, ten[6:9], ten[9]

    def _spread(self, block: Array, link: int, axis: int) -> Array:
        """Rows or columns of the joints that carry the link in their places, zeros elsewhere."""
        n, path = len(self.joints), self.paths[link]
        if path == tuple(range(len(path))):  # padding compiles faster than taking
            widths = [(0, 0)] * block.ndim
            widths[axis] = (0, n - len(path))
            return jnp.pad(block, widths)
        rows = [path.index(joint) if joint in path else len(path) for joint in range(n)]
        return jnp.take(block, np.array(rows), axis=axis, mode="fill", fill_value=0.0)

    def _propagate(
        self, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> list[_LinkState]:
        """Outward recursion: velocities, accelerations and Jacobians, link by link."""
        batch = q.shape[:-1]
        still = jnp.zeros((*batch, 3), q.dtype)
        empty = jnp.zeros((*batch, 3, 0), q.dtype)
        up = jnp.broadcast_to(-jnp.asarray(gravity, q.dtype), (*batch, 3))
        base = _LinkState(still, still, up, empty, empty)
        axis = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0], q.dtype), (*batch, 3))
        states: list[_LinkState] = []
        for i, joint in enumerate(self.joints):
            state = base if len(self.paths[i]) == 1 else states[self.paths[i][-2]]
            rate, acceleration = qd[..., i, None] * axis, qdd[..., i, None] * axis
            rotation, step = _transform(joint, q[..., i])
            w, wd = state.angular_velocity, state.angular_acceleration
            a = state.acceleration + jnp.cross(wd, step) + jnp.cross(w, jnp.cross(w, step))
            angular = state.angular_jacobian
            linear = state.linear_jacobian - _skew(step) @ angular
            w, wd, a = (_into(rotation, x) for x in (w, wd, a))
            angular = jnp.swapaxes(rotation, -1, -2) @ angular
            linear = jnp.swapaxes(rotation, -1, -2) @ linear
            column = axis[..., None]
            if joint.kind == "R":
                wd = wd + jnp.cross(w, rate) + acceleration
                w = w + rate
                angular = jnp.concatenate([angular, column], axis=-1)
                linear = jnp.concatenate([linear, 0 * column], axis=-1)
            else:
                a = a + 2 * jnp.cross(w, rate) + acceleration
                angular = jnp.concatenate([angular, 0 * column], axis=-1)
                linear = jnp.concatenate([linear, column], axis=-1)
            states.append(_LinkState(w, wd, a, angular, linear))
        return states


_BODY = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz", "hx", "hy", "hz", "m")


def _paths(parents: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    paths: list[tuple[int, ...]] = []
    for i, parent in enumerate(parents):
        paths.append((*(paths[parent] if parent >= 0 else ()), i))
    return tuple(paths)


def _transform(joint: Joint, q: Array) -> tuple[Array, Array]:
    """Rotation (..., 3, 3) and translation (..., 3) from a link's frame to its parent's."""
    ca, sa = math.cos(joint.alpha), math.sin(joint.alpha)
    theta = q + joint.theta if joint.kind == "R" else jnp.full_like(q, joint.theta)
    d = (joint.d.value or 0.0) + (q if joint.kind == "P" else jnp.zeros_like(q))
    c, s, zero, one = jnp.cos(theta), jnp.sin(theta), jnp.zeros_like(q), jnp.ones_like(q)
    rotation = jnp.stack(
        [
            jnp.stack([c, -s, zero], axis=-1),
            jnp.stack([s * ca, c * ca, -sa * one], axis=-1),
            jnp.stack([s * sa, c * sa, ca * one], axis=-1),
        ],
        axis=-2,
    )
    step = jnp.stack([(joint.a.value or 0.0) * one, -sa * d, ca * d], axis=-1)
    if joint.gamma == 0.0 and joint.b.is_zero:
        return rotation, step
    cg, sg = math.cos(joint.gamma), math.sin(joint.gamma)
    branch = jnp.asarray([[cg, -sg, 0.0], [sg, cg, 0.0], [0.0, 0.0, 1.0]], q.dtype)
    height = jnp.asarray([0.0, 0.0, joint.b.value or 0.0], q.dtype)
    # The step's leading axes are the batch's: spell out the broadcast.
    return branch @ rotation, step @ branch.T + jnp.broadcast_to(height, step.shape)


def _into(rotation: Array, x: Array) -> Array:
    return jnp.einsum("...ij,...i->...j", rotation, x)


def _skew(x: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    zero = jnp.zeros_like(x[..., 0])
    return jnp.stack(
        [
            jnp.stack([zero, -x[..., 2], x[..., 1]], axis=-1),
            jnp.stack([x[..., 2], zero, -x[..., 0]], axis=-1),
            jnp.stack([-x[..., 1], x[..., 0], zero], axis=-1),
        ],
        axis=-2,
    )


def _times_tensor(x: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 6"]:
    """The matrix K(x) with K(x) (Ixx Iyy Izz Ixy Ixz Iyz) = I x."""
    zero = jnp.zeros_like(x[..., 0])
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    return jnp.stack(
        [
            jnp.stack([a, zero, zero, b, c, zero], axis=-1),
            jnp.stack([zero, b, zero, a, zero, c], axis=-1),
            jnp.stack([zero, zero, c, zero, a, b], axis=-1),
        ],
        axis=-2,
    )


def _wrench_regressor(
    state: _LinkState,
) -> tuple[Float[Array, "*batch 3 10"], Float[Array, "*batch 3 10"]]:
    """Force, and moment about the frame's origin, as (..., 3, 10) times the ten of a body."""
    w, wd, a = state.angular_velocity, state.angular_acceleration, state.acceleration
    spin = _skew(w)
    moment = jnp.concatenate(
        [_times_tensor(wd) + spin @ _times_tensor(w), -_skew(a), jnp.zeros_like(a)[..., None]],
        axis=-1,
    )
    force = jnp.concatenate(
        [jnp.zeros((*a.shape, 6), a.dtype), _skew(wd) + spin @ spin, a[..., None]], axis=-1
    )
    return force, moment

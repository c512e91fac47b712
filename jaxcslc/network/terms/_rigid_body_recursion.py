from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ...derivation import BODY, Algebra, Coefficient
from ...manipulator import Joint
from ._compilation import in_blocks
from ._link_motion import LinkMotion, States, cross, link_motion, link_states, paths_of, turning_of
from ._term import AbstractManipulatorTerm, Coefficients, Joints, Matrices, Regressor, Rows


class RigidBodyRecursion(AbstractManipulatorTerm):
    """Newton-Euler over link parameters, for robots whose closed-form tables are large.

    Cost grows with the square of the number of joints, not with the number of monomials, and
    compile time not even with that: links are scanned over, and so are pairs of a link and a
    joint that carries it. (Unrolled, a Panda's regressor compiled five times as long.) It
    needs numeric lengths: then the torque is that of bodies which have the base parameters
    (`Algebra.unit_inertias`).

    **Attributes**

    - `body`: for every link, the matrix (10, coefficients of the link) from its coefficients to
      (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), as nested tuples.
    - `indices`: for every link, its coefficients.
    - `motors`: a joint and the coefficient of its motor's inertia, each.
    - `paths`: the joints that carry each link, from the base outwards.
    """

    body: tuple[tuple[tuple[float, ...], ...], ...] = eqx.field(static=True)
    joints: tuple[Joint, ...] = eqx.field(static=True)
    gravity: tuple[float, float, float] = eqx.field(static=True)
    indices: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    motors: tuple[tuple[int, int], ...] = eqx.field(static=True)
    paths: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")

    @classmethod
    def from_algebra(cls, algebra: Algebra) -> "RigidBodyRecursion":
        """**Raises** `ValueError` if the algebra kept lengths symbolic."""
        if algebra.lengths != "numeric":
            raise ValueError(
                "the recursive evaluator needs numeric lengths: symbolic coefficients are not"
                " independent once lengths have values; derive with lengths='numeric'"
            )
        n = algebra.robot.joint_count
        indices: list[list[int]] = [[] for _ in range(n)]
        columns: list[list[tuple[float, ...]]] = [[] for _ in range(n)]
        motors: list[tuple[int, int]] = []
        for index, unit in enumerate(algebra.unit_inertias):
            if unit.motor:
                motors.append((unit.link, index))
            else:
                indices[unit.link].append(index)
                columns[unit.link].append(tuple(float(entry) for entry in unit.body))
        return cls(
            body=tuple(tuple(zip(*c, strict=True)) if c else ((),) * len(BODY) for c in columns),
            joints=algebra.robot.joints,
            gravity=algebra.robot.gravity,
            indices=tuple(tuple(link) for link in indices),
            motors=tuple(motors),
            paths=paths_of(algebra.robot.parents),
            coefficients=algebra.coefficients,
        )

    @property
    def has_tables(self) -> bool:
        """Whether the closed form is small enough to be computed from its tables."""
        return False

    @property
    def parts(self) -> tuple[str, ...]:
        return ("mass", "velocity", "gravity")

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        # Joint j carries the links whose path it is on, and its motor.
        return tuple(
            tuple(
                sorted(
                    [
                        index
                        for path, indices in zip(self.paths, self.indices, strict=True)
                        if joint in path
                        for index in indices
                    ]
                    + [index for motor, index in self.motors if motor == joint]
                )
            )
            for joint in range(len(self.joints))
        )

    @eqx.filter_jit
    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> tuple[Float[Array, "_ samples"], ...]:
        support = self.support
        entries = [(joint, index) for joint, indices in enumerate(support) for index in indices]

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries)

        ends = np.cumsum([len(indices) for indices in support])[:-1]
        return tuple(jnp.split(in_blocks(of_block, (q, qd, qdd)), ends))

    @eqx.filter_jit
    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        if self.size == 0:
            return jnp.zeros((*q.shape, 0), q.dtype)
        n, p = len(self.joints), self.size
        entries = [(joint, index) for joint in range(n) for index in range(p)]

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries).T

        motion = (_samples_last(q), _samples_last(qd), _samples_last(qdd))
        return in_blocks(of_block, motion, samples_first=True).reshape(*q.shape, p)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        return self._torque(k, q, qd, qdd, self.gravity)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        return self._torque(k, q, qd, jnp.zeros_like(q), (0.0, 0.0, 0.0))

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        still = jnp.zeros_like(q)
        return self._torque(k, q, still, still, self.gravity)

    @eqx.filter_jit
    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        n = len(self.joints)

        def of_block(position: Array) -> Array:
            return self._mass_matrix(k, position).reshape(n * n, position.shape[1]).T

        total = in_blocks(of_block, (_samples_last(q),), samples_first=True)
        return total.reshape(*q.shape, n)

    def _mass_matrix(self, k: Array, position: Array) -> Float[Array, "joints joints samples"]:
        still = jnp.zeros_like(position)
        motion = self._motion(position, still, still, (0.0, 0.0, 0.0))
        inertia, first, mass = self._composite(k, motion)
        # Velocities of the whole at the base's origin, for a unit rate of each joint.
        turns = turning_of(self.joints, position.dtype)[:, None, None]
        axis = motion.axes[:, 2]
        angular = turns * axis
        linear = turns * cross(motion.origin, axis) + (1 - turns) * axis
        force = mass[:, None] * linear + cross(angular, first)
        moment = jnp.sum(inertia * angular[:, None], axis=2) + cross(first, linear)
        # Joint j moves what joint k carries if it carries joint k.
        upper = jnp.sum(angular[:, None] * moment[None] + linear[:, None] * force[None], axis=2)
        carries = jnp.asarray(_carries(self.paths), position.dtype)
        diagonal = jnp.eye(len(self.joints), dtype=position.dtype)
        motor = jnp.zeros(len(self.joints), position.dtype)
        for joint, index in self.motors:
            motor = motor.at[joint].set(k[index])
        upper = upper * carries[:, :, None]
        below = jnp.swapaxes(upper, 0, 1) * (1 - diagonal)[:, :, None]
        return upper + below + (motor[None] * diagonal)[:, :, None]

    def _composite(self, k: Array, motion: LinkMotion) -> tuple[Array, Array, Array]:
        """Inertia, first moment and mass that each joint carries, about the base's origin."""
        bodies = self._bodies(k)
        turn, p, mass = motion.axes, motion.origin, bodies.mass[:, None]
        # R I R', by columns of R.
        half = jnp.sum(bodies.inertia[:, :, :, None, None] * turn[:, None], axis=2)
        tensor = jnp.sum(turn[:, :, :, None] * half[:, :, None], axis=1)
        about = jnp.sum(bodies.first[:, :, None] * turn, axis=1)
        first = about + mass[:, None] * p
        mixed = jnp.sum((2 * about + mass[:, None] * p) * p, axis=1)
        outer = about[:, :, None] * p[:, None] + p[:, :, None] * about[:, None]
        outer = outer + mass[:, None, None] * p[:, :, None] * p[:, None]
        eye = jnp.eye(3, dtype=p.dtype)[None, :, :, None]
        tensor = tensor + mixed[:, None, None] * eye - outer
        n, samples = len(self.joints), p.shape[-1]
        ones = jnp.ones((1, samples), p.dtype)
        parts = tensor.reshape(n, 9, samples), first, (mass * ones)[:, None]
        flat = jnp.concatenate(parts, axis=1).reshape(n, 13 * samples)
        total = (jnp.asarray(_carries(self.paths), p.dtype) @ flat).reshape(n, 13, samples)
        return total[:, :9].reshape(n, 3, 3, samples), total[:, 9:12], total[:, 12]

    @eqx.filter_jit
    def _torque(
        self, k: Array, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> Array:
        def of_block(q: Array, qd: Array, qdd: Array) -> Array:
            return self._torque_of_block(k, q, qd, qdd, gravity).T

        motion = (_samples_last(q), _samples_last(qd), _samples_last(qdd))
        return in_blocks(of_block, motion, samples_first=True).reshape(q.shape)

    def _torque_of_block(
        self, k: Array, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> Float[Array, "joints samples"]:
        motion = self._motion(q, qd, qdd, gravity)
        w, wd, a = motion.angular_velocity, motion.angular_acceleration, motion.acceleration
        bodies = self._bodies(k)

        def inertia_times(x: Array) -> Array:  # I x, with I in the link's axes
            along = jnp.sum(motion.axes * x[:, None], axis=2)
            product = jnp.sum(bodies.inertia[..., None] * along[:, None], axis=2)
            return jnp.sum(motion.axes * product[:, :, None], axis=1)

        first = jnp.sum(bodies.first[:, :, None] * motion.axes, axis=1)
        force = bodies.mass[:, None, None] * a + cross(wd, first) + cross(w, cross(w, first))
        moment = (
            inertia_times(wd)
            + cross(w, inertia_times(w))
            + cross(first, a)
            + cross(motion.origin, force)
        )
        # What each joint carries, as moments about the base's origin.
        carries = jnp.asarray(_carries(self.paths), q.dtype)
        force, moment = (
            (carries @ x.reshape(x.shape[0], 3 * x.shape[2])).reshape(x.shape)
            for x in (force, moment)
        )
        turns = turning_of(self.joints, q.dtype)[:, None, None]
        axis = motion.axes[:, 2]
        along = turns * (moment - cross(motion.origin, force)) + (1 - turns) * force
        total = jnp.sum(axis * along, axis=1)
        for joint, index in self.motors:
            total = total.at[joint].add(k[index] * qdd[joint])
        return total

    def _motion(
        self, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> LinkMotion:
        return link_motion(self.joints, self.paths, gravity, q, qd, qdd)

    def _bodies(self, k: Array) -> "_Bodies":
        """What the coefficients give the links."""
        n = len(self.joints)
        selection = np.zeros((n, 10, self.size))
        for link, indices in enumerate(self.indices):
            if indices:
                selection[link][:, list(indices)] = np.array(self.body[link])
        ten = jnp.asarray(selection, k.dtype) @ k
        xx, yy, zz, xy, xz, yz = (ten[:, i] for i in range(6))
        tensor = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(n, 3, 3)
        return _Bodies(tensor, ten[:, 6:9, None], ten[:, 9])

    def _unit_torques(self, q: Array, qd: Array, qdd: Array) -> Float[Array, "rows samples"]:
        """Each joint's torque by each of the ten numbers of every link that it carries.

        Rows are pairs times ten, then the accelerations, then zeros.
        """
        states = link_states(self.joints, self.paths, self.gravity, q, qd, qdd)
        links, joints = _pairs(self.paths)
        turns = turning_of(self.joints, q.dtype)[joints]
        pairs = jnp.asarray(links + 1), jnp.asarray(joints + 1), turns
        _, ten = lax.scan(_unit_torques_of_pair, states, pairs)
        rows = ten.reshape(10 * len(links), q.shape[1])
        return jnp.concatenate([rows, qdd, jnp.zeros((1, q.shape[1]), q.dtype)])

    def _gathered(
        self, torques: Float[Array, "rows samples"], entries: list[tuple[int, int]]
    ) -> Float[Array, "_ samples"]:
        """Regressor entries (joint, coefficient) as sums of rows of `_unit_torques`."""
        zero_row = torques.shape[0] - 1
        if not entries:
            return torques[:0]
        sums = [self._rows(joint, index) for joint, index in entries]
        total: Array | None = None
        for part in range(max(map(len, sums))):
            terms = [rows[part] if part < len(rows) else (zero_row, 0.0) for rows in sums]
            picked = torques[np.array([row for row, _ in terms])]
            factors = np.array([factor for _, factor in terms])
            if not np.all(factors == 1.0):
                picked = picked * jnp.asarray(factors, torques.dtype)[:, None]
            total = picked if total is None else total + picked
        assert total is not None
        return total

    def _rows(self, joint: int, index: int) -> list[tuple[int, float]]:
        """Rows of `_unit_torques`, and multiples, of which one entry of the regressor is made."""
        link, joints = _pairs(self.paths)
        zero_row = 10 * len(link) + len(self.joints)
        for motor, motor_index in self.motors:
            if motor_index == index:
                return [(10 * len(link) + motor, 1.0) if motor == joint else (zero_row, 1.0)]
        (body,) = [i for i, indices in enumerate(self.indices) if index in indices]
        if joint not in self.paths[body]:
            return [(zero_row, 1.0)]
        (pair,) = np.flatnonzero((link == body) & (joints == joint))
        column = self.indices[body].index(index)
        return [
            (10 * int(pair) + entry, row[column])
            for entry, row in enumerate(self.body[body])
            if row[column]
        ]


class _Bodies(NamedTuple):
    """Of every link, about its frame's origin and in its axes."""

    inertia: Float[Array, "links 3 3"]
    first: Float[Array, "links 3 1"]
    mass: Float[Array, " links"]


def _unit_torques_of_pair(states: States, pair: tuple[Array, Array, Array]) -> tuple[States, Array]:
    """A joint's torque by each of a link's (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), (10, samples)."""
    link, joint, turning = pair
    x, y, z, origin, w, wd, a = lax.dynamic_index_in_dim(states, link, keepdims=False)
    _, _, axis, pivot, *_ = lax.dynamic_index_in_dim(states, joint, keepdims=False)
    angular = turning * axis
    linear = turning * cross(axis, origin - pivot) + (1 - turning) * axis

    def along_axes(vector: Array) -> list[Array]:  # of the link
        return [jnp.sum(vector * along, axis=0) for along in (x, y, z)]

    # A moment of inertia about the link's x: torque (I wd + w x I w) along the joint's axis.
    turn, gain, rate, twist = (along_axes(x) for x in (angular, wd, w, cross(angular, w)))
    ten = [turn[i] * gain[i] + twist[i] * rate[i] for i in range(3)]
    ten += [
        turn[i] * gain[j] + turn[j] * gain[i] + twist[i] * rate[j] + twist[j] * rate[i]
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    # A first moment h: force wd x h + w x (w x h), moment h x a, both seen from h.
    ten += along_axes(cross(linear, wd) + cross(cross(linear, w), w) + cross(a, angular))
    ten.append(jnp.sum(linear * a, axis=0))
    return states, jnp.stack(ten)


def _pairs(paths: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Links and joints of all pairs in which the joint carries the link."""
    pairs = [(link, joint) for link, path in enumerate(paths) for joint in path]
    links, joints = np.array(pairs).T
    return links, joints


def _carries(paths: Sequence[Sequence[int]]) -> Float[np.ndarray, "joints links"]:
    """One where a joint carries a link."""
    links, joints = _pairs(paths)
    matrix = np.zeros((len(paths), len(paths)))
    matrix[joints, links] = 1.0
    return matrix


def _samples_last(x: Joints) -> Float[Array, "joints samples"]:
    return x.reshape(-1, x.shape[-1]).T

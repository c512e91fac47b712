import dataclasses
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ....codegen import CompiledProgram, Motion, StraightLine, Value, in_blocks
from ....derivation import BODY, Algebra, Coefficient
from ....manipulator import Joint
from .._term import (
    AbstractManipulatorTerm,
    Coefficients,
    Columns,
    Joints,
    Matrices,
    Regressor,
    Rows,
)
from ._link_motion import Bodies, Geometry, by_link, geometry_of, paths_of
from ._newton_euler import mass_matrix_of, samples_last, torque_of
from ._straight_line import (
    LinkedBodies,
    columns_code,
    mass_matrix_code,
    regressor_rows,
    torque_code,
)
from ._unit_torques import pairs_of, unit_torques
from ._unrolled import is_quicker_unrolled, unrolled


class RigidBodyRecursion(AbstractManipulatorTerm):
    """Newton-Euler over link parameters, for robots whose closed-form tables are large.

    Cost grows with the square of the number of joints, not with the number of monomials. It
    needs numeric lengths: then the torque is that of bodies which have the base parameters
    (`Algebra.unit_inertias`).

    It has two forms. Rolled, links are scanned over, and so are pairs of a link and a joint that
    carries it: compile time hardly grows with the number of joints, and robots of as many joints
    share a program. Unrolled, it is straight-line code in which right angles and zero lengths make
    most operations vanish: some times quicker, and it compiles for longer.

    **Attributes**

    - `body`: for every link, the matrix (10, coefficients of the link) from its coefficients to
      (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), as nested tuples.
    - `indices`: for every link, its coefficients.
    - `motors`: a joint and the coefficient of its motor's inertia, each.
    - `paths`: the joints that carry each link, from the base outwards.
    - `unrolled`: which form; None for the one that was measured to be quicker: unrolled on a GPU,
      and on a processor from a million samples, for robots of up to 12 joints.
    """

    body: tuple[tuple[tuple[float, ...], ...], ...] = eqx.field(static=True)
    joints: tuple[Joint, ...] = eqx.field(static=True)
    gravity: tuple[float, float, float] = eqx.field(static=True)
    indices: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    motors: tuple[tuple[int, int], ...] = eqx.field(static=True)
    paths: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")
    unrolled: bool | None = eqx.field(static=True, default=None)

    @classmethod
    def from_algebra(cls, algebra: Algebra, unrolled: bool | None = None) -> "RigidBodyRecursion":
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
            unrolled=unrolled,
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
        return _support(self.indices, self.motors, self.paths)

    @property
    def has_host_columns(self) -> bool:
        return True

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        ends = np.cumsum([len(support) for support in self.support])[:-1]
        if isinstance(q, np.ndarray):
            program = _program(self.linked_bodies, self.support)
            return tuple(np.split(program(q, np.asarray(qd), np.asarray(qdd)), ends))
        if self.is_unrolled(q, q.shape[::-1]):
            code = _columns(self.linked_bodies, self.support)
            return tuple(jnp.split(unrolled(code, None, q.T, qd.T, qdd.T), ends))
        return self._compiled_columns(q, qd, qdd)

    def write_columns(
        self, into: Sequence[Float[np.ndarray, "_ samples"]], q: Rows, qd: Rows, qdd: Rows
    ) -> None:
        rows = [row for of_joint in into for row in of_joint]
        _program(self.linked_bodies, self.support).write(
            rows, np.asarray(q), np.asarray(qd), np.asarray(qdd)
        )

    def entries(self, motion: Motion) -> Iterator[tuple[int, int, Value]]:
        """Joint, coefficient and value of the regressor's entries, as expressions."""
        for joint, row in enumerate(regressor_rows(motion, self.linked_bodies)):
            for index, value in row.items():
                yield joint, index, value

    @eqx.filter_jit
    def _compiled_columns(self, q: Any, qd: Any, qdd: Any) -> Columns:
        support = self.support
        entries = [(joint, index) for joint, indices in enumerate(support) for index in indices]

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries)

        ends = np.cumsum([len(indices) for indices in support])[:-1]
        return tuple(jnp.split(in_blocks(of_block, (q, qd, qdd)), ends))

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        if self.size == 0:
            return jnp.zeros((*q.shape, 0), q.dtype)
        if not self.is_unrolled(q, q.shape):
            return self._rolled_regressor(q, qd, qdd)
        entries = tuple(np.ndindex(len(self.joints), self.size))
        code = columns_code(self.linked_bodies, entries)
        return self._straight(code, None, q, qd, qdd).reshape(*q.shape, self.size)

    @eqx.filter_jit
    def _rolled_regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        n, p = len(self.joints), self.size
        entries = [(joint, index) for joint in range(n) for index in range(p)]

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries).T

        motion = (samples_last(q), samples_last(qd), samples_last(qdd))
        return in_blocks(of_block, motion, samples_first=True).reshape(*q.shape, p)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        if self.is_unrolled(q, q.shape):
            return self._straight(torque_code(self.linked_bodies), k, q, qd, qdd)
        return self._torque(k, q, qd, qdd, self.gravity)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        weightless = (0.0, 0.0, 0.0)
        if self.is_unrolled(q, q.shape):
            bodies = dataclasses.replace(self.linked_bodies, gravity=weightless)
            return self._straight(torque_code(bodies, accelerations=False), k, q, qd)
        return self._torque(k, q, qd, jnp.zeros_like(q), weightless)

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        if self.is_unrolled(q, q.shape):
            code = torque_code(self.linked_bodies, rates=False, accelerations=False)
            return self._straight(code, k, q)
        still = jnp.zeros_like(q)
        return self._torque(k, q, still, still, self.gravity)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        if self.is_unrolled(q, q.shape):
            matrices = self._straight(mass_matrix_code(self.linked_bodies), k, q)
            return matrices.reshape(*q.shape, q.shape[-1])
        return mass_matrix_of(self._geometry(q.dtype), self._bodies(k), q)

    def is_unrolled(self, q: Any, shape: tuple[int, ...]) -> bool:
        """Which form computes with positions of a shape (..., joints)."""
        if self.unrolled is not None:
            return self.unrolled
        return is_quicker_unrolled(q, shape)

    def _straight(
        self, code: StraightLine, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch outputs"]:
        """The outputs of straight-line code, last."""
        rows = unrolled(code, k, *(x.reshape(-1, x.shape[-1]) for x in motion))
        return rows.T.reshape(*motion[0].shape[:-1], len(code.outputs))

    @property
    def linked_bodies(self) -> LinkedBodies:
        """What straight-line code is made of."""
        return LinkedBodies(
            joints=self.joints,
            parents=tuple(path[-2] if len(path) > 1 else -1 for path in self.paths),
            gravity=self.gravity,
            body=self.body,
            indices=self.indices,
            motors=self.motors,
        )

    def _torque(
        self, k: Array, q: Array, qd: Array, qdd: Array, gravity: tuple[float, float, float]
    ) -> Array:
        g = np.array(gravity, q.dtype)
        return torque_of(self._geometry(q.dtype), g, self._bodies(k), q, qd, qdd)

    def _geometry(self, dtype: Any) -> Geometry:
        return geometry_of(self.joints, self.paths, np.dtype(dtype))

    def _bodies(self, k: Array) -> Bodies:
        """The coefficients by link, which are as many for every robot of so many joints."""
        index, body = by_link(self.body, self.indices, self.motors, self.size)
        # Behind the last one stands a zero. Outside of `jit` there is nothing to compile.
        xp = jnp if isinstance(k, Tracer) else np
        padded = xp.concatenate([xp.asarray(k, k.dtype), xp.zeros(1, k.dtype)])
        return Bodies(body.astype(k.dtype), padded[index])

    def _unit_torques(self, *motion: Any) -> Any:
        """Those of `unit_torques`, of samples last."""
        dtype = motion[0].dtype
        gravity = np.array(self.gravity, dtype)
        return unit_torques(self._geometry(dtype), gravity, self.paths, *motion)

    def _gathered(
        self, torques: Float[Array, "rows samples"], entries: list[tuple[int, int]]
    ) -> Float[Array, "_ samples"]:
        """Regressor entries (joint, coefficient) as sums of rows of `unit_torques`."""
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
        """Rows of `unit_torques`, and multiples, of which one entry of the regressor is made."""
        link, joints = pairs_of(self.paths)
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


@lru_cache(maxsize=256)
def _support(
    indices: tuple[tuple[int, ...], ...],
    motors: tuple[tuple[int, int], ...],
    paths: tuple[tuple[int, ...], ...],
) -> tuple[tuple[int, ...], ...]:
    """For each joint, the coefficients of the links whose path it is on, and of its motor."""
    carried = [
        [
            index
            for path, link in zip(paths, indices, strict=True)
            if joint in path
            for index in link
        ]
        for joint in range(len(paths))
    ]
    for joint, motor in motors:
        carried[joint].append(motor)
    return tuple(tuple(sorted(joint)) for joint in carried)


@lru_cache(maxsize=64)
def _columns(bodies: LinkedBodies, support: tuple[tuple[int, ...], ...]) -> StraightLine:
    """The columns of all joints, one behind the other."""
    entries = tuple((joint, index) for joint, row in enumerate(support) for index in row)
    return columns_code(bodies, entries)


@lru_cache(maxsize=64)
def _program(bodies: LinkedBodies, support: tuple[tuple[int, ...], ...]) -> CompiledProgram:
    """The same for NumPy's arrays."""
    code = _columns(bodies, support)
    return CompiledProgram(code.motion, tuple(code.outputs))

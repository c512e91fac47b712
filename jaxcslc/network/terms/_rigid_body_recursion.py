"""The rigid-body term by Newton and Euler's recursion, rolled or unrolled."""

import math
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc._environment import platform_of
from jaxcslc.codegen import Motion, StraightLine, in_blocks, motion_outputs
from jaxcslc.derivation import BODY, Algebra, Coefficient
from jaxcslc.manipulator import Joint

from ._expressed_bodies import AbstractRigidBody, code
from ._linked_bodies import RecursiveBodies
from ._rolled import (
    Bodies,
    Geometry,
    by_link,
    geometry_of,
    mass_matrix_of,
    pairs_of,
    paths_of,
    samples_last,
    torque_of,
    unit_torques,
)
from ._term import Coefficients, Joints, Rows


# Straight-line code of so many joints compiles within seconds; its operations grow with the square
# of the joints for the torque, with the third power for the regressor.
_MOST_JOINTS = 12
# On a processor it compiles for 2 to 4 s longer than the loop, and gains that in so many samples.
_MANY_SAMPLES = 1 << 20


class RigidBodyRecursion(AbstractRigidBody):
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
        return False

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return _support(self.indices, self.motors, self.paths)

    def expressed(self, motion: Motion) -> RecursiveBodies:
        parents = tuple(path[-2] if len(path) > 1 else -1 for path in self.paths)
        of_robot = self.joints, parents, self.gravity
        return RecursiveBodies(motion, *of_robot, self.body, self.indices, self.motors)

    def _column_rows(self, q: Rows, qd: Rows, qdd: Rows) -> Float[Array, "rows samples"]:
        if self.is_unrolled(q, q.shape[::-1]):
            return _unrolled(code(self, "columns"), None, q.T, qd.T, qdd.T)
        return self._compiled_columns(q, qd, qdd)

    @eqx.filter_jit
    def _compiled_columns(self, q: Any, qd: Any, qdd: Any) -> Float[Array, "rows samples"]:
        entries = [(joint, index) for joint, row in enumerate(self.support) for index in row]

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries)

        return in_blocks(of_block, (q, qd, qdd))

    @eqx.filter_jit
    def _rolled_regressor(
        self, q: Joints, qd: Joints, qdd: Joints
    ) -> Float[Array, "*batch values"]:
        entries = list(np.ndindex(len(self.joints), self.size))

        def of_block(*motion: Array) -> Array:
            return self._gathered(self._unit_torques(*motion), entries).T

        motion = (samples_last(q), samples_last(qd), samples_last(qdd))
        rows = in_blocks(of_block, motion, samples_first=True)
        return rows.reshape(*q.shape[:-1], len(entries))

    def _values(
        self, quantity: str, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch values"]:
        q = motion[0]
        if self.is_unrolled(q, q.shape):
            rows = _unrolled(code(self, quantity), k, *(x.reshape(-1, x.shape[-1]) for x in motion))
            return rows.T.reshape(*q.shape[:-1], len(rows))
        if k is None:
            return self._rolled_regressor(*motion)
        geometry, bodies = self._geometry(q.dtype), self._bodies(k)
        if quantity == "mass_matrix":
            return mass_matrix_of(geometry, bodies, q).reshape(*q.shape[:-1], -1)
        gravity = np.zeros(3) if quantity == "velocity" else np.array(self.gravity)
        still = [jnp.zeros_like(q)] * (3 - len(motion))
        return torque_of(geometry, gravity.astype(q.dtype), bodies, *motion, *still)

    def is_unrolled(self, q: Any, shape: tuple[int, ...]) -> bool:
        """Return whether the unrolled form computes with positions of a shape (..., joints)."""
        if self.unrolled is not None:
            return self.unrolled
        *batch, joints = shape
        if joints > _MOST_JOINTS:
            return False
        return platform_of(q) != "cpu" or math.prod(batch) >= _MANY_SAMPLES

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
        """Compute `unit_torques` of samples last."""
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


@partial(jax.jit, static_argnames=("expressed",))
def _unrolled(
    expressed: StraightLine,
    k: Float[Array, " coefficients"] | None,
    *motion: Float[Array, "samples joints"],
) -> Float[Array, "outputs samples"]:
    """The outputs of straight-line code for many samples of q, qd and qdd, as many as it needs.

    One array a quantity and joint, so that a compiler can keep all of a sample in registers.
    """

    def of_block(*rows: Array) -> Array:
        return jnp.stack(motion_outputs(expressed, k, *map(list, rows)))

    return in_blocks(of_block, tuple(x.T for x in motion))


@lru_cache(maxsize=256)
def _support(
    indices: tuple[tuple[int, ...], ...],
    motors: tuple[tuple[int, int], ...],
    paths: tuple[tuple[int, ...], ...],
) -> tuple[tuple[int, ...], ...]:
    """Return, for each joint, the coefficients of all links that it carries and of its motor."""
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

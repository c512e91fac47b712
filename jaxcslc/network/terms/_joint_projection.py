"""Projection of terms onto independent joints, for robots with joints that follow others.

Positions of all joints are q = S u + s; by virtual work, torques are S' times those of all
joints.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import Manipulator

from ._rigid_body import AbstractRigidBody
from ._term import AbstractManipulatorTerm, Coefficients, Columns, Joints, Regressor, Rows


AllJoints = Float[Array, "*batch all_joints"]


class JointProjection(eqx.Module):
    """Motion of a robot's joints by that of its independent joints: q = S u + s.

    u are positions of the joints that follow none. Virtual work gives their torques from those of
    all joints: S' tau.

    **Attributes**

    - `matrix`: S, (n, m), as nested tuples.
    - `offset`: s, (n,) [rad or m].

    >>> import jaxcslc as jc
    >>> JointProjection.of(jc.puma560()) is None  # no joint follows another
    True
    """

    matrix: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    offset: tuple[float, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Manipulator) -> "JointProjection | None":
        """Return a robot's projection, or None if none of its joints follows another."""
        mimics = () if robot.source is None else robot.source.mimics
        if not mimics:
            return None
        names, independent = robot.joint_names, robot.independent_joints
        matrix, offset = np.zeros((len(names), len(independent))), np.zeros(len(names))
        matrix[independent, range(len(independent))] = 1.0
        for mimic in mimics:
            follower = names.index(mimic.follower)
            matrix[follower] = mimic.multiplier * matrix[names.index(mimic.leader)]
            offset[follower] = mimic.offset
        return cls(tuple(tuple(row) for row in matrix.tolist()), tuple(offset.tolist()))

    @property
    def joint_count(self) -> int:
        """Number of independent joints, m."""
        return len(self.matrix[0])

    @property
    def shares(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """Joints that move with each independent joint, and by how much."""
        return tuple(
            tuple((joint, row[column]) for joint, row in enumerate(self.matrix) if row[column])
            for column in range(self.joint_count)
        )

    def positions(self, q: Any) -> Any:
        """Compute positions of all joints, (..., n), from independent ones, (..., m)."""
        # Shaped for JAX's strict rule of broadcasting.
        offset = np.array(self.offset, q.dtype).reshape((1,) * (q.ndim - 1) + (-1,))
        return q @ np.array(self.matrix, q.dtype).T + offset

    def velocities(self, qd: Any) -> Any:
        """Compute velocities of all joints, (..., n), from (..., m); also accelerations."""
        return qd @ np.array(self.matrix, qd.dtype).T


class ProjectedTerm(AbstractManipulatorTerm):
    """A term of all joints as one of the independent joints: Y(S u + s, S u', S u'') k, times S'.

    **Attributes**

    - `term`: of all joints, n.
    - `projection`: onto m independent ones.
    """

    term: AbstractRigidBody
    projection: JointProjection
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls, term: AbstractRigidBody, projection: JointProjection | None
    ) -> "AbstractRigidBody | ProjectedTerm":
        """Return the term itself where all joints are independent."""
        if projection is None:
            return term
        return cls(term=term, projection=projection, kind=term.kind, coefficients=term.coefficients)

    @property
    def parts(self) -> tuple[str, ...]:
        return self.term.parts

    @property
    def has_host_columns(self) -> bool:
        return self.term.has_host_columns

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        supports = self.term.support
        return tuple(
            tuple(sorted({i for joint, _ in shares for i in supports[joint]}))
            for shares in self.projection.shares
        )

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        positions, velocities = self.projection.positions, self.projection.velocities
        whole = self.term.columns(positions(q.T).T, velocities(qd.T).T, velocities(qdd.T).T)
        xp, supports = array_namespace(*whole), self.term.support
        rows: list[Any] = []
        for shares, support in zip(self.projection.shares, self.support, strict=True):
            total = xp.zeros((len(support), q.shape[1]), whole[0].dtype)
            for joint, share in shares:
                # Entries of this joint's columns among those of the sum.
                at = np.searchsorted(support, supports[joint])
                spread = np.zeros((len(support), len(supports[joint])), whole[0].dtype)
                spread[at, range(len(at))] = share
                total = total + spread @ whole[joint]
            rows.append(total)
        return tuple(rows)

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        whole = self.term.regressor(*self._all_motion(q, qd, qdd))
        return (whole.mT @ self._matrix(whole)).mT

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        whole = self.term.torque(k, *self._all_motion(q, qd, qdd))
        return whole @ self._matrix(whole)

    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        whole = self.term.part(quantity, k, *self._all_motion(*motion))
        projected = whole @ self._matrix(whole)
        return self._matrix(whole).T @ projected if quantity == "mass_matrix" else projected

    def _all_motion(self, q: Joints, *rates: Joints) -> list[AllJoints]:
        return [self.projection.positions(q), *map(self.projection.velocities, rates)]

    def _matrix(self, like: Any) -> Any:
        return jnp.asarray(self.projection.matrix, like.dtype)

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..._environment import array_namespace
from ...derivation import Coefficient
from ...manipulator import Manipulator
from ._input_term import AbstractFunctions, AbstractInputTerm
from ._joint_projection import ProjectedTerm
from ._rigid_body_recursion import RigidBodyRecursion
from ._rigid_body_tables import RigidBodyTables
from ._term import (
    AbstractManipulatorTerm,
    Coefficients,
    Columns,
    Joints,
    Matrices,
    Regressor,
    Rows,
)


LOAD = "load"
"""The kind of this friction, in a robot's friction model."""


# Solutions for signs of the load: one would do where it is the torque of the same equations.
_SIGN_STEPS = 4


class LoadFriction(AbstractInputTerm):
    """Dry friction that grows with the load of the gears: kl sign(qd) |rigid torque|.

    The rigid torque, M(q) qdd + V(q, qd) + G(q) of links and motors, is that of `load`, numbers of
    the term: so torque stays linear in kl, as it does in the magnitude of static friction for a
    fixed slope.

    **Attributes**

    - `rigid`: the term of links and motors, as the network has it.
    - `load`: (p,) its coefficients, a leaf; None before a fit.
    - `joints`: those that have such friction, from 0; `joint_count`: how many have torques.
    - `robot_joints`: which of the robot's they are; `robot_joint_count`: n.
    """

    rigid: RigidBodyTables | RigidBodyRecursion | ProjectedTerm
    load: Float[Array | np.ndarray, " inertial"] | None
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    robot_joints: tuple[int, ...] = eqx.field(static=True)
    robot_joint_count: int = eqx.field(static=True)

    @classmethod
    def all_of(
        cls,
        robot: Manipulator,
        rigid: RigidBodyTables | RigidBodyRecursion | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"] | None = None,
    ) -> "tuple[LoadFriction, ...]":
        """The term of the robot's joints whose friction model names the kind; none if none does."""
        independent, friction = robot.independent_joints, robot.friction_per_joint
        joints = tuple(i for i, joint in enumerate(independent) if LOAD in friction[joint])
        if not joints:
            return ()
        robot_joints = tuple(independent[i] for i in joints)
        coefficients = tuple(
            Coefficient(
                f"kl{joint + 1}",
                LOAD,
                f"friction of joint {joint + 1} in proportion to its load",
                "1",
                True,
            )
            for joint in robot_joints
        )
        term = cls(
            rigid=rigid,
            load=load,
            kind=LOAD,
            coefficients=coefficients,
            joints=joints,
            joint_count=len(independent),
            robot_joints=robot_joints,
            robot_joint_count=robot.joint_count,
        )
        return (term,)

    def with_load(self, load: Any) -> "LoadFriction":
        """With other coefficients of the rigid torque, (p,); None for none."""
        return dataclasses.replace(self, load=load)

    @property
    def keyword(self) -> str:
        return self.kind

    @property
    def parts(self) -> tuple[str, ...]:
        # No part of F(qd), which has neither position nor acceleration.
        return (LOAD,)

    @property
    def has_host_columns(self) -> bool:
        return self.rigid.has_host_columns and not isinstance(self.load, Tracer)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return self.joints

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(range(self.size))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (self.robot_joint_count,)

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        return (self.robot_joints,)

    @property
    def value_meaning(self) -> str:
        return "one a joint"

    @property
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        return np.zeros((self.size, self.joint_count, self.joint_count))

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        torque = functions.rigid_torque(self.rigid, self._load(), q, qd, qdd)
        return [functions.sign(qd[j]) * functions.absolute(torque[j]) for j in self.joints]

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        load, rows = self._load(), self.rigid.columns(q, qd, qdd)
        xp = array_namespace(*rows)
        load = xp.asarray(load, q.dtype)
        columns: list[Any] = []
        for joint, support in enumerate(self.rigid.support):
            if joint in self.joints:
                torque = load[np.array(support, int)] @ rows[joint]
                columns.append((xp.sign(qd[joint]) * xp.abs(torque))[None])
            else:
                columns.append(q[:0])
        return tuple(columns)

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        values = self._of_all_joints(q, qd, qdd)[..., np.array(self.joints)]
        eye = jnp.asarray(np.eye(self.joint_count)[:, list(self.joints)], q.dtype)
        shape = (*q.shape, len(self.joints))
        return jnp.broadcast_to(values[..., None, :], shape) * jnp.broadcast_to(eye, shape)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        values = self._of_all_joints(q, qd, qdd)
        return values * jnp.broadcast_to(self.factors(k), values.shape)

    def factors(self, k: Coefficients) -> Float[Array, " joints"]:
        """The coefficients of all joints, (n,), zero for those without such friction."""
        return jnp.zeros(self.joint_count, k.dtype).at[np.array(self.joints)].set(k)

    def on_the_left(
        self,
        factors: Float[Array, " joints"],
        q: Joints,
        qd: Joints,
        tau: Joints,
        mass: Matrices,
        bias: Joints,
    ) -> tuple[Matrices, Joints]:
        """Mass matrix and bias of equations that have this friction on their left, too.

        With the signs s of the load R(qdd) = A qdd + b of the solution, the friction D |R|,
        D = diag(kl sign(qd)), is D s (A qdd + b): linear in qdd. Where R is the rigid torque of the
        equations, each joint has R + D |R| = tau - (all else), and R the sign of the right-hand
        side while |kl| < 1: that of the solution without this friction, with which the search
        begins. Otherwise (a coupled shaft, other coefficients) each step may change some
        signs, until they are those of their solution.

        - `tau`: (..., n) torques; `mass`, `bias`: of M qdd + bias = tau without this friction.
        """
        load = jnp.asarray(self._load(), q.dtype)
        matrix = self.rigid.mass_matrix(load, q)
        start = self.rigid.torque(load, q, qd, jnp.zeros_like(q))
        weight = jnp.broadcast_to(factors, qd.shape) * jnp.sign(qd)

        def equations(signs: Joints) -> tuple[Matrices, Joints]:
            share = weight * signs
            return mass + share[..., :, None] * matrix, bias + share * start

        def signs_of(signs: Joints) -> Joints:
            left, right = equations(signs)
            qdd = jnp.linalg.solve(left, (tau - right)[..., None])
            return jnp.sign((matrix @ qdd)[..., 0] + start)

        signs = jax.lax.fori_loop(
            0, _SIGN_STEPS, lambda _, signs: signs_of(signs), jnp.zeros_like(q)
        )
        return equations(jax.lax.stop_gradient(signs))

    def _of_all_joints(self, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        load = jnp.asarray(self._load(), q.dtype)
        return jnp.sign(qd) * jnp.abs(self.rigid.torque(load, q, qd, qdd))

    def _load(self) -> Any:
        """**Raises** `ValueError` if the rigid torque is not known."""
        if self.load is None:
            raise ValueError(
                "friction 'load': the rigid torque is not known before a fit; expected a network"
                " `with_load(k)`, of the coefficients of links and motors"
            )
        return self.load

    # `jax.jit(network.torque)` looks the method up by its hash, and arrays have none.
    def __hash__(self) -> int:
        if self.load is None:
            return hash((self.coefficients, self.joints))
        if isinstance(self.load, Tracer):
            return id(self.load)
        values = np.asarray(self.load)
        return hash((self.coefficients, self.joints, values.shape, values.tobytes()))


class LoadedRigidBody(AbstractManipulatorTerm):
    """Links and motors with the friction that follows their torque, linear about coefficients.

    The torque R + kl sign(qd) |R| of a joint is, to first order, (1 + kl sign(qd R)) times the
    regressor of R: what a step of Gauss and Newton fits.

    **Attributes**

    - `rigid`: the term of links and motors.
    - `load`: (p,) the coefficients that signs are taken at; `factors`: (n,) kl of every joint.
    """

    rigid: RigidBodyTables | RigidBodyRecursion | ProjectedTerm
    load: Float[Array | np.ndarray, " inertial"]
    factors: Float[Array | np.ndarray, " joints"]
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        rigid: RigidBodyTables | RigidBodyRecursion | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"],
        factors: Float[Array | np.ndarray, " joints"],
    ) -> "LoadedRigidBody":
        """Under the names of the term."""
        return cls(
            rigid=rigid,
            load=load,
            factors=factors,
            kind=rigid.kind,
            coefficients=rigid.coefficients,
        )

    @property
    def parts(self) -> tuple[str, ...]:
        return self.rigid.parts

    @property
    def has_host_columns(self) -> bool:
        return self.rigid.has_host_columns

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return self.rigid.support

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        rows = self.rigid.columns(q, qd, qdd)
        xp = array_namespace(*rows)
        load, factors = (xp.asarray(x, q.dtype) for x in (self.load, self.factors))
        return tuple(
            of_joint
            * (1.0 + factors[j] * xp.sign(qd[j] * (load[np.array(support, int)] @ of_joint)))
            for j, (support, of_joint) in enumerate(zip(self.support, rows, strict=True))
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        return self.rigid.regressor(q, qd, qdd) * self._weights(q, qd, qdd)[..., None]

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        return self.rigid.torque(k, q, qd, qdd) * self._weights(q, qd, qdd)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        return self.rigid.mass_matrix(k, q)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        return self.rigid.velocity_term(k, q, qd)

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        return self.rigid.gravity_term(k, q)

    def _weights(self, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        torque = self.rigid.torque(jnp.asarray(self.load, q.dtype), q, qd, qdd)
        factors = jnp.broadcast_to(jnp.asarray(self.factors, q.dtype), qd.shape)
        return 1.0 + factors * jnp.sign(qd * torque)

    def __hash__(self) -> int:
        if isinstance(self.load, Tracer) or isinstance(self.factors, Tracer):
            return id(self.load)
        return hash(
            (self.coefficients, *(np.asarray(x).tobytes() for x in (self.load, self.factors)))
        )

"""Coulomb friction that grows with the rigid torque, alike or different for driving and braking.

`LoadFriction` is linear in its coefficients for a given rigid torque. `LoadedRigidBody` is the
linearised sum of links and such friction, as a Gauss-Newton step needs it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import Manipulator

from ._expressed_bodies import AbstractRigidBody
from ._input_term import HOST_FUNCTIONS, JAX_FUNCTIONS, AbstractFunctions, AbstractInputTerm
from ._joint_projection import ProjectedTerm
from ._term import AbstractManipulatorTerm, Coefficients, Columns, Joints, Matrices, Regressor, Rows


LOAD, DIRECTIONAL_LOAD = "load", "directional_load"
"""The kinds of this friction, in a robot's friction model."""
# What multiplies each coefficient: both directions of power, or that in which the joint drives its
# load (1) and that in which it brakes it (-1); symbols, and what the directions are called.
_SIDES = {LOAD: (0,), DIRECTIONAL_LOAD: (1, -1)}
_SYMBOLS = {LOAD: ("kl",), DIRECTIONAL_LOAD: ("kld", "klb")}
_DIRECTIONS = {LOAD: ("",), DIRECTIONAL_LOAD: (", where it drives it", ", where it brakes it")}


# Solutions for signs of the load: one would do where it is the torque of the same equations.
_SIGN_STEPS = 4


class LoadFriction(AbstractInputTerm):
    """Dry friction that grows with the load of the gears: kl sign(qd) |rigid torque|.

    Of the kind `"directional_load"`, with a coefficient for motion with the rigid torque, which
    drives, and one for motion against it, which brakes: gears that are pressed on other flanks, or
    that are not reversible, lose more one way.

    The rigid torque, M(q) qdd + V(q, qd) + G(q) of links and motors, is that of `load`, numbers of
    the term: so torque stays linear in kl, as it does in the magnitude of static friction for a
    fixed slope.

    **Attributes**

    - `rigid`: the term of links and motors, as the network has it.
    - `load`: (p,) its coefficients, a leaf; None before a fit.
    - `kind`: `"load"` or `"directional_load"`.
    - `coefficients`: of one symbol joint by joint, then of the next.
    - `joints`: those that have such friction, from 0; `joint_count`: how many have torques.
    - `robot_joints`: which of the robot's they are; `robot_joint_count`: n.
    """

    rigid: AbstractRigidBody | ProjectedTerm
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
        rigid: AbstractRigidBody | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"] | None = None,
    ) -> "tuple[LoadFriction, ...]":
        """The terms of both kinds, of the joints whose friction model names them."""
        return (*cls.of(LOAD, robot, rigid, load), *cls.of(DIRECTIONAL_LOAD, robot, rigid, load))

    @classmethod
    def of(
        cls,
        kind: str,
        robot: Manipulator,
        rigid: AbstractRigidBody | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"] | None = None,
    ) -> "tuple[LoadFriction, ...]":
        """The term of the robot's joints whose friction model names the kind; none if none does."""
        independent, friction = robot.independent_joints, robot.friction_per_joint
        joints = tuple(i for i, joint in enumerate(independent) if kind in friction[joint])
        if not joints:
            return ()
        robot_joints = tuple(independent[i] for i in joints)
        coefficients = tuple(
            Coefficient(
                f"{symbol}{joint + 1}",
                kind,
                f"friction of joint {joint + 1} in proportion to its load{direction}",
                "1",
                True,
            )
            for symbol, direction in zip(_SYMBOLS[kind], _DIRECTIONS[kind], strict=True)
            for joint in robot_joints
        )
        term = cls(
            rigid=rigid,
            load=load,
            kind=kind,
            coefficients=coefficients,
            joints=joints,
            joint_count=len(independent),
            robot_joints=robot_joints,
            robot_joint_count=robot.joint_count,
        )
        return (term,)

    def with_load(self, load: Any) -> "LoadFriction":
        """Return the term with other coefficients of the rigid torque, (p,); None for none."""
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
        return self.joints * len(self._sides)

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(range(self.size))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (self.robot_joint_count, *((2,) if len(self._sides) == 2 else ()))

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        if len(self._sides) == 1:
            return (self.robot_joints,)
        return self.robot_joints * 2, (*(0 for _ in self.joints), *(1 for _ in self.joints))

    @property
    def value_meaning(self) -> str:
        return "one a joint" if len(self._sides) == 1 else "driving and braking of each joint"

    @property
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        return np.zeros((self.size, self.joint_count, self.joint_count))

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        torque = functions.rigid_torque(self.rigid, self._load(), q, qd, qdd)
        return [
            _friction(functions, side, torque[j], qd[j])
            for side in self._sides
            for j in self.joints
        ]

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        load, rows = self._load(), self.rigid.columns(q, qd, qdd)
        xp = array_namespace(*rows)
        load, functions = xp.asarray(load, q.dtype), HOST_FUNCTIONS if xp is np else JAX_FUNCTIONS
        columns: list[Any] = []
        for joint, support in enumerate(self.rigid.support):
            if joint in self.joints:
                torque = load[np.array(support, int)] @ rows[joint]
                inputs = [_friction(functions, side, torque, qd[joint]) for side in self._sides]
                columns.append(xp.stack(inputs))
            else:
                columns.append(q[:0])
        return tuple(columns)

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        inputs = [x[..., np.array(self.joints)] for x in self._of_all_joints(q, qd, qdd)]
        eye = jnp.asarray(np.eye(self.joint_count)[:, list(self.joints)], q.dtype)
        shape = (*q.shape, len(self.joints))
        blocks = [
            jnp.broadcast_to(values[..., None, :], shape) * jnp.broadcast_to(eye, shape)
            for values in inputs
        ]
        return jnp.concatenate(blocks, axis=-1)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        by_side = k.reshape(len(self._sides), len(self.joints))
        every = jnp.zeros((len(self._sides), self.joint_count), k.dtype)
        every = every.at[:, np.array(self.joints)].set(by_side)
        values = self._of_all_joints(q, qd, qdd)
        terms = (x * jnp.broadcast_to(row, x.shape) for x, row in zip(values, every, strict=True))
        return sum(terms, jnp.zeros_like(q))

    def factors(self, k: Coefficients) -> Float[Array, "2 joints"]:
        """The coefficients of all joints where they drive their load and where they brake it,
        (2, n), zero for those without such friction."""
        by_side = jnp.broadcast_to(
            k.reshape(len(self._sides), len(self.joints)), (2, len(self.joints))
        )
        zeros = jnp.zeros((2, self.joint_count), by_side.dtype)
        return zeros.at[:, np.array(self.joints)].set(by_side)

    def on_the_left(
        self,
        factors: Float[Array, "2 joints"],
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

        def equations(signs: Joints) -> tuple[Matrices, Joints]:
            share = _share(factors, signs * jnp.sign(qd))
            return mass + share[..., :, None] * matrix, bias + share * start

        def signs_of(signs: Joints) -> Joints:
            left, right = equations(signs)
            qdd = jnp.linalg.solve(left, (tau - right)[..., None])
            return jnp.sign((matrix @ qdd)[..., 0] + start)

        signs = jax.lax.fori_loop(
            0, _SIGN_STEPS, lambda _, signs: signs_of(signs), jnp.zeros_like(q)
        )
        return equations(jax.lax.stop_gradient(signs))

    def _of_all_joints(self, q: Joints, qd: Joints, qdd: Joints) -> list[Joints]:
        load = jnp.asarray(self._load(), q.dtype)
        torque = self.rigid.torque(load, q, qd, qdd)
        return [_friction(JAX_FUNCTIONS, side, torque, qd) for side in self._sides]

    @property
    def _sides(self) -> tuple[int, ...]:
        return _SIDES[self.kind]

    def _load(self) -> Any:
        """**Raises** `ValueError` if the rigid torque is not known."""
        if self.load is None:
            raise ValueError(
                f"friction {self.kind!r}: the rigid torque is not known before a fit; expected a"
                " network `with_load(k)`, of the coefficients of links and motors"
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


def _friction(functions: AbstractFunctions, side: int, torque: Any, qd: Any) -> Any:
    """Return the factor of a coefficient: sign(qd) |torque|.

    With directional load, it is that of one sign of power only.
    """
    sign = functions.sign(qd)
    if side == 0:
        return sign * functions.absolute(torque)
    if side > 0:
        return sign * functions.positive(sign * torque)
    return -sign * functions.negative(sign * torque)


def _share(factors: Any, power: Any) -> Any:
    """Friction over rigid torque, for the sign of its power."""
    xp = array_namespace(power)
    driving, braking = (xp.broadcast_to(x, power.shape) for x in factors)
    return driving * (power > 0) - braking * (power < 0)


class LoadedRigidBody(AbstractManipulatorTerm):
    """Links and motors with the friction that follows their torque, linear about coefficients.

    The torque R + kl sign(qd) |R| of a joint is, to first order, (1 + kl sign(qd R)) times the
    regressor of R: what a step of Gauss and Newton fits. kl is that of the sign of the power qd R.

    **Attributes**

    - `rigid`: the term of links and motors.
    - `load`: (p,) the coefficients that signs are taken at; `factors`: (2, n) kl of
      every joint where it drives and where it brakes.
    """

    rigid: AbstractRigidBody | ProjectedTerm
    load: Float[Array | np.ndarray, " inertial"]
    factors: Float[Array | np.ndarray, "2 joints"]
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        rigid: AbstractRigidBody | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"],
        factors: Float[Array | np.ndarray, "2 joints"],
    ) -> "LoadedRigidBody":
        """Make the term of links, motors and load-dependent friction, named as `rigid` is."""
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
            * (1.0 + _share(factors[:, j], qd[j] * (load[np.array(support, int)] @ of_joint)))
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
        return 1.0 + _share(jnp.asarray(self.factors, q.dtype), qd * torque)

    def __hash__(self) -> int:
        if isinstance(self.load, Tracer) or isinstance(self.factors, Tracer):
            return id(self.load)
        return hash(
            (self.coefficients, *(np.asarray(x).tobytes() for x in (self.load, self.factors)))
        )

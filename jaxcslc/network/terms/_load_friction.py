"""Coulomb friction that grows with the rigid torque, alike or different for driving and braking.

`LoadFriction` is linear in its coefficients for a given rigid torque. `LoadedRigidBody` is the
linearised sum of links and such friction, as a Gauss-Newton step needs it.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import Manipulator

from ._input_term import AbstractFunctions
from ._joint_projection import ProjectedTerm
from ._joint_term import (
    DIRECTIONAL_LOAD,
    JOINT_LAWS,
    LOAD,
    AbstractJointTerm,
    JointLaw,
    joint_fields,
)
from ._rigid_body import AbstractRigidBody
from ._term import (
    AbstractManipulatorTerm,
    Coefficients,
    Columns,
    Joints,
    Matrices,
    Regressor,
    Rows,
    content_hash,
)


# Solutions for signs of the load: one would do where it is the torque of the same equations.
_SIGN_STEPS = 4


class LoadFriction(AbstractJointTerm):
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
    - `law` and others: see `AbstractJointTerm`.
    """

    rigid: AbstractRigidBody | ProjectedTerm
    load: Float[Array | np.ndarray, " inertial"] | None
    law: JointLaw
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    robot_joints: tuple[int, ...] = eqx.field(static=True)
    robot_joint_count: int = eqx.field(static=True)

    @classmethod
    def from_robot(
        cls,
        robot: Manipulator,
        rigid: AbstractRigidBody | ProjectedTerm,
        load: Float[Array | np.ndarray, " inertial"] | None = None,
    ) -> "tuple[LoadFriction, ...]":
        """The terms of both kinds, of the joints whose friction model names them."""
        laws = JOINT_LAWS[LOAD], JOINT_LAWS[DIRECTIONAL_LOAD]
        terms = (cls(rigid=rigid, load=load, law=law, **joint_fields(law, robot)) for law in laws)
        return tuple(term for term in terms if term.joints)

    def _needed(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> Sequence[Any]:
        return functions.rigid_torque(self.rigid, self._load(), q, qd, qdd)

    def _needed_of_all(self, q: Joints, qd: Joints, qdd: Joints) -> Joints | None:
        return self.rigid.torque(jnp.asarray(self._load(), q.dtype), q, qd, qdd)

    def factors(self, k: Coefficients) -> Float[Array, "2 joints"]:
        """The coefficients of all joints where they drive their load and where they brake it,
        (2, n), zero for those without such friction."""
        by_side = jnp.broadcast_to(k.reshape(-1, len(self.joints)), (2, len(self.joints)))
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
        matrix = self.rigid.part("mass_matrix", load, q)
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

    def _load(self) -> Any:
        """**Raises** `ValueError` if the rigid torque is not known."""
        if self.load is None:
            raise ValueError(
                f"friction {self.kind!r}: the rigid torque is not known before a fit; expected a"
                " network `with_load(k)`, of the coefficients of links and motors"
            )
        return self.load

    def __hash__(self) -> int:
        return content_hash(self.coefficients, self.joints, self.load)


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

    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        return self.rigid.part(quantity, k, *motion)

    def _weights(self, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        torque = self.rigid.torque(jnp.asarray(self.load, q.dtype), q, qd, qdd)
        return 1.0 + _share(jnp.asarray(self.factors, q.dtype), qd * torque)

    def __hash__(self) -> int:
        return content_hash(self.coefficients, self.load, self.factors)

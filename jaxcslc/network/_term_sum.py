"""Inverse dynamics of a robot as a sum of terms: M, V, G, friction, springs, forward dynamics."""

import abc
from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..manipulator import JointLimits, Manipulator
from ._linear_network import AbstractLinearNetwork, Vector
from .terms import AbstractManipulatorTerm, JointProjection, LoadFriction


Numbers = Float[Array | np.ndarray, "... joints"]
Entry = TypeVar("Entry")


class AbstractTermSum(AbstractLinearNetwork):
    """Inverse dynamics as a sum of terms, each linear in coefficients of its own.

    Positions, velocities and accelerations are (..., n) with any leading batch axes, in rad (or
    m), per s and per s²; torques are N m (or N). Every method is a pure function that can be
    jitted, vmapped and differentiated, in the precision of its inputs.

    **Attributes**

    - `terms`: the addends; `k` holds their coefficients one after the other.
    - `robot`: whose dynamics they are.
    """

    terms: eqx.AbstractVar[tuple[AbstractManipulatorTerm, ...]]

    @property
    @abc.abstractmethod
    def robot(self) -> Manipulator: ...

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.robot.name

    @property
    def output_kind(self) -> str:
        return "joint"

    @property
    def output_quantity(self) -> str:
        return "torque"

    @property
    def output_labels(self) -> tuple[str, ...]:
        """The joints' names, where the robot has such, or else `"1"` to `"n"`."""
        if self.robot.has_joint_names:
            return self.output_names
        return tuple(str(joint + 1) for joint in self.robot.independent_joints)

    @property
    def output_names(self) -> tuple[str, ...]:
        """The joints' names, or `"joint 1"` to `"joint n"`."""
        return self._of_independent(self.robot.joint_names)

    @property
    def output_units(self) -> tuple[str, ...]:
        """Units of the joints' torques."""
        return self._of_independent(self.robot.torque_units)

    @property
    def motion_count(self) -> int:
        """Number of columns of the motion: one per joint, except joints that follow others."""
        return len(self.robot.independent_joints)

    @property
    def joint_kinds(self) -> str:
        """Kinds of the joints that have torques, as in `"RRPRRR"`."""
        return "".join(self._of_independent(self.robot.kinds))

    @property
    def joint_limits(self) -> tuple[JointLimits, ...]:
        """Limits of each of these joints according to the robot's file."""
        return self._of_independent(self.robot.joint_limits)

    @property
    def friction_per_joint(self) -> tuple[tuple[str, ...], ...]:
        """The friction terms of each of these joints."""
        return self._of_independent(self.robot.friction_per_joint)

    def positions_of_all_joints(self, q: Numbers) -> Float[Array | np.ndarray, "... all_joints"]:
        """Positions of all the robot's joints, those included that follow others."""
        projection = JointProjection.of(self.robot)
        return q if projection is None else projection.positions(q)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        shape = (*q.shape, self.joint_count)
        return self._sum(self._of("mass"), k, lambda term, k: term.mass_matrix(k, q), shape)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        terms = self._of("velocity")
        return self._sum(terms, k, lambda term, k: term.velocity_term(k, q, qd), q.shape)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        terms = self._of("gravity")
        return self._sum(terms, k, lambda term, k: term.gravity_term(k, q), q.shape)

    def friction_term(self, k: Vector, qd: Numbers) -> Float[Array, "..."]:
        """F(qd): friction (Eqn. 2.5-3, 2.5-4) and torque offset, (..., n) [N m].

        Without what follows the load, which is no function of velocities alone.
        """
        k, qd = self._checked(k, qd)
        still = jnp.zeros_like(qd)
        terms = self._of("friction")
        return self._sum(terms, k, lambda term, k: term.torque(k, still, qd, still), qd.shape)

    def spring_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """S(q): torques of joint springs, stiffness times position, (..., n) [N m]."""
        k, q = self._checked(k, q)
        still = jnp.zeros_like(q)
        terms = self._of("spring")
        return self._sum(terms, k, lambda term, k: term.torque(k, q, still, still), q.shape)

    def forward_dynamics(
        self, k: Vector, q: Numbers, qd: Numbers, tau: Numbers
    ) -> Float[Array, "..."]:
        """Accelerations that torques `tau` (..., n) produce, (..., n) [rad/s²].

        Solves M qdd = tau - V - G - F - S. Not finite where M is singular, which it is for no
        possible mass distribution. Friction that follows the load depends on accelerations, by
        the sign of the load: the signs are searched for, which is exact at once where the load is
        that of `k`.
        """
        k, q, qd, tau = self._checked(k, q, qd, tau)
        still = jnp.zeros_like(q)
        plain = tuple(term for term in self.terms if not isinstance(term, LoadFriction))
        bias = self._sum(plain, k, lambda term, k: term.torque(k, q, qd, still), q.shape)
        mass = self.mass_matrix(k, q)
        for term in self.terms:
            if isinstance(term, LoadFriction):
                factors = term.factors(k[self.layout.of(term)])
                mass, bias = term.on_the_left(factors, q, qd, tau, mass, bias)
        return jnp.linalg.solve(mass, (tau - bias)[..., None])[..., 0]

    def without_friction(self, k: Vector) -> Float[Array, " coefficients"]:
        """The coefficients of the same robot without friction: those of friction set to zero.

        Springs and the inertia that coupled joints share stay.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> float(network.without_friction(jnp.ones(43)).sum())  # 6 viscous and 6 dry less
        31.0
        """
        mask = np.ones(self.size)
        mask[self.layout.friction] = 0.0
        k = jnp.asarray(k)
        return k * jnp.asarray(mask, k.dtype)

    def _of_independent(self, entries: Sequence[Entry]) -> tuple[Entry, ...]:
        """Select, from entries of all the robot's joints, those of the joints that have torques."""
        return tuple(entries[i] for i in self.robot.independent_joints)

    def _of(self, part: str) -> tuple[AbstractManipulatorTerm, ...]:
        """The terms that belong to a sum of the equation of motion."""
        return tuple(term for term in self.terms if part in term.parts)

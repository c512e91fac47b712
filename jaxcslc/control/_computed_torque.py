"""Computed-torque control (Eqn. 2.7-1), whole and in part."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._controller import (
    AbstractController,
    Joints,
    PerJoint,
    Reference,
    checked_coefficients,
    conditional_integration,
    error_gains,
    per_joint,
    required_velocity,
    saturated,
)


COMPENSATIONS: dict[str, tuple[str, ...]] = {
    "full": ("mass", "velocity", "gravity", "friction"),
    "no friction": ("mass", "velocity", "gravity"),
    "no velocity term": ("mass", "gravity", "friction"),
    "gravity only": ("gravity",),
    "nothing": (),
}
"""The terms of Eqn. 2.7-1 that each named choice of `compensation` uses. The thesis's references
compare them (2.7; Leahy and Saridis 1989)."""


class ComputedTorque(AbstractController):
    """Computed-torque control: inverse dynamics with feedback (Eqn. 2.7-1; Paul 1972).

        torque = M(q) a + V(q, qd) + G(q) + F        a = qdd_d + K_v (qd_d − qd) + K_p (q_d − q)

    `error_gains` gives K_p and K_v for a natural frequency and a damping ratio. With exact
    coefficients and measurements the error of each joint is an independent linear oscillator.
    Without the mass term, M(q) is replaced by its diagonal at one pose. An integral, K_i ∫ e dt in
    a, is an addition to the thesis's law: it removes the steady-state error of an inexact model.
    Anti-windup is `conditional_integration`. The state is the integral, (*batch, n).

    **Attributes**

    - `network`, `k`: (p,) the model; see `with_coefficients`.
    - `natural_frequency` [rad/s], `damping`, `integral_gain` [1/s³], `torque_limit` [N m or N]:
      (n,).
    - `friction_width`: (n,) [rad/s or m/s]; see `smooth_friction`.
    - `inertia`: (n,) the constant diagonal instead of M(q) [kg m² or kg].
    - `compensation`: the terms of Eqn. 2.7-1 that are used; static.
    - `friction_at`: which velocity friction is computed for, `"measured"` or `"reference"`; static.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Reference
    >>> network = jc.derive(jc.puma560())
    >>> k = network.coefficients_from(jc.puma560().links)
    >>> controller = ComputedTorque(network, k, natural_frequency=20.0)
    >>> q, qd = jnp.zeros(6), jnp.zeros(6)
    >>> torque, _ = controller.step(controller.begin(q), Reference.at_rest(q), q, 0.002, qd)
    >>> bool(jnp.allclose(torque, network.gravity_term(k, q)))
    True
    """

    network: CSLC
    k: Float[Array, " coefficients"]
    natural_frequency: Float[Array, " joints"]
    damping: Float[Array, " joints"]
    integral_gain: Float[Array, " joints"]
    torque_limit: Float[Array, " joints"]
    friction_width: Float[Array, " joints"]
    inertia: Float[Array, " joints"]
    compensation: tuple[str, ...] = eqx.field(static=True)
    friction_at: str = eqx.field(static=True)

    def __init__(
        self,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        natural_frequency: PerJoint,
        damping: PerJoint = 1.0,
        *,
        compensation: str | Sequence[str] = "full",
        integral_gain: PerJoint = 0.0,
        torque_limit: PerJoint = math.inf,
        friction_at: str = "measured",
        friction_width: PerJoint = 0.0,
        pose: Joints | None = None,
    ) -> None:
        """Make a controller of one robot; one number stands for all joints.

        **Arguments**

        - `network`, `k`: (p,) the dynamics.
        - `natural_frequency`, `damping`: of the error [rad/s], [1].
        - `compensation`: a key of `COMPENSATIONS`, or some of `"mass"`, `"velocity"`,
          `"gravity"`, `"friction"`.
        - `integral_gain`: K_i [1/s³]; the loop is stable below 2 ζ ω_n³.
        - `torque_limit`: of the drives [N m or N].
        - `friction_at`: `"measured"` as in Eqn. 2.7-1. `"reference"` compensates the friction of
          the desired motion: this breaks a joint at rest away, and is not affected by the sign
          errors of a velocity estimated from a quantised encoder.
        - `friction_width`: speed below which friction falls to zero linearly [rad/s or m/s].
        - `pose`: (n,) where the constant diagonal is computed, zeros if omitted [rad or m]. Only
          used without the mass term.

        **Raises** `ValueError`: an unknown option, or a wrong number of values or one out of range.
        """
        n = network.joint_count
        if isinstance(compensation, str):
            if compensation not in COMPENSATIONS:
                names = ", ".join(map(repr, COMPENSATIONS))
                raise ValueError(f"compensation is {compensation!r}; expected {names}")
            compensation = COMPENSATIONS[compensation]
        full = COMPENSATIONS["full"]
        for term in compensation:
            if term not in full:
                names = ", ".join(map(repr, full))
                raise ValueError(f"compensation has {term!r}; expected some of {names}")
        if friction_at not in ("measured", "reference"):
            raise ValueError(f"friction_at is {friction_at!r}; expected 'measured' or 'reference'")
        self.network, self.k = network, checked_coefficients(network, k)

        def values(name: str, argument: PerJoint) -> Float[Array, " joints"]:
            return jnp.asarray(per_joint(name, argument, n, 0.0))

        self.natural_frequency = values("natural_frequency", natural_frequency)
        self.damping = values("damping", damping)
        self.integral_gain = values("integral_gain", integral_gain)
        self.torque_limit = values("torque_limit", torque_limit)
        self.friction_width = values("friction_width", friction_width)
        self.compensation = tuple(term for term in full if term in compensation)
        self.friction_at = friction_at
        if "mass" in self.compensation:
            self.inertia = jnp.zeros(n)
        else:
            at = jnp.zeros(n) if pose is None else jnp.asarray(pose)
            self.inertia = jnp.diagonal(network.mass_matrix(self.k, at))

    def with_coefficients(
        self, k: Float[Array, " coefficients"], network: CSLC | None = None
    ) -> "ComputedTorque":
        """Return the controller with other coefficients, (p,), which may be traced.

        They are those of `network`, of as many joints, if it is given. The constant diagonal in
        place of M(q) does not change.
        """
        model = (self.network if network is None else network, k)
        return eqx.tree_at(lambda controller: (controller.network, controller.k), self, model)

    def begin(self, q: Joints) -> Joints:
        """Return the integral, zero."""
        return jnp.zeros_like(jnp.asarray(q))

    def step(
        self,
        state: Joints,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, Joints]:
        """Compute the torque command, as `AbstractController.step` describes."""
        q, qd = jnp.asarray(q), jnp.asarray(required_velocity(self, qd))
        shape = jnp.broadcast_shapes(q.shape, jnp.shape(reference.q))
        position, velocity = error_gains(self.natural_frequency, self.damping)
        position, velocity, integral = (
            jnp.broadcast_to(gain, shape) for gain in (position, velocity, self.integral_gain)
        )
        error = jnp.asarray(reference.q) - q
        acceleration = (
            jnp.asarray(reference.qdd)
            + velocity * (reference.qd - qd)
            + position * error
            + integral * state
        )
        torque = self._rigid(q, qd, acceleration)
        if "friction" in self.compensation:
            at = qd if self.friction_at == "measured" else jnp.asarray(reference.qd)
            torque = torque + smooth_friction(self.network, self.k, at, self.friction_width)
        state = conditional_integration(state, error * interval, torque, self.torque_limit)
        return saturated(torque, self.torque_limit), state

    def _rigid(self, q: Array, qd: Array, acceleration: Array) -> Array:
        """Return the torque of every term but friction."""
        k = self.network.without_friction(self.k)
        gravity = "gravity" in self.compensation
        velocity = qd if "velocity" in self.compensation else jnp.zeros_like(qd)
        if "mass" in self.compensation:
            torque = self.network.torque(k, q, velocity, acceleration)
            return torque if gravity else torque - self.network.gravity_term(k, q)
        torque = jnp.broadcast_to(self.inertia, acceleration.shape) * acceleration
        torque = torque + self.network.spring_term(k, q)
        if "velocity" in self.compensation:
            torque = torque + self.network.velocity_term(k, q, velocity)
        return torque + self.network.gravity_term(k, q) if gravity else torque


def smooth_friction(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    qd: Joints,
    width: Float[Array | np.ndarray, " joints"],
) -> Float[Array, "*batch joints"]:
    """Return friction F(qd) with its jump at zero velocity replaced by a straight line.

    Between −width and width friction is linear in the velocity, from F(−width) to F(width), for
    any friction model of the network. Where the width is zero it is F(qd).

    **Arguments**

    - `network`, `k`: (p,) the dynamics.
    - `qd`: (*batch, n) [rad/s or m/s].
    - `width`: (n,) [rad/s or m/s].

    **Returns** (*batch, n) [N m or N].

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import smooth_friction
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> network.names
    ('kB1', 'kv1', 'kd1')
    >>> k, width = jnp.array([1.0, 0.0, 3.0]), jnp.array([0.1])
    >>> [float(smooth_friction(network, k, jnp.array([v]), width)[0]) for v in (0.05, 0.2)]
    [1.5, 3.0]
    """
    qd = jnp.asarray(qd)
    width = jnp.broadcast_to(jnp.asarray(width, qd.dtype), qd.shape)
    within = jnp.abs(qd) < width
    share = jnp.where(within, 0.5 + 0.5 * qd / jnp.where(width > 0, width, 1.0), 1.0)
    # One joint's velocity is replaced at a time: friction of coupled joints depends on several.
    diagonal = jnp.broadcast_to(jnp.eye(qd.shape[-1], dtype=bool), (*qd.shape, qd.shape[-1]))

    def friction_at(ends: Array) -> Array:
        replaced = diagonal & within[..., None, :]
        velocities = jnp.where(replaced, ends[..., None, :], qd[..., None, :])
        return jnp.diagonal(network.friction_term(k, velocities), axis1=-2, axis2=-1)

    forwards, backwards = friction_at(width), friction_at(-width)
    return share * forwards + (1.0 - share) * backwards

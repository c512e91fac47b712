import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._controller import AbstractController
from ._gains import PerJoint, error_gains, per_joint
from ._limits import integrated, limited
from ._reference import Joints, Reference


COMPENSATIONS: dict[str, tuple[str, ...]] = {
    "full": ("mass", "velocity", "gravity", "friction"),
    "no friction": ("mass", "velocity", "gravity"),
    "no velocity term": ("mass", "gravity", "friction"),
    "gravity only": ("gravity",),
    "nothing": (),
}
"""How much of the dynamics is compensated, as the thesis's references compare (2.7; Leahy and
Saridis 1989): the terms of Eqn. 2.7-1 that take part, by the name of the choice."""


class ComputedTorque(AbstractController):
    """Computed torque: the arm's own dynamics invert the arm (Eqn. 2.7-1; Paul 1972).

        torque = M(q) a + V(q, qd) + G(q) + F        a = qdd_d + K_v (qd_d − qd) + K_p (q_d − q)

    With `error_gains` of a natural frequency and a damping ratio. Where coefficients and
    measurements are exact every joint's error is a linear oscillator of its own. Without the
    mass term, M(q) is a constant diagonal, the arm's own at one pose. An integral, K_i ∫ e dt in a,
    is an addition to the thesis's law; it takes out what a wrong model leaves at rest, and does
    not wind up against the torque limits (`integrated`). The state is the integral.

    **Attributes** are leaves, but for the words:

    - `network`, `k`: the model; `with_coefficients` goes on with others.
    - `natural_frequency` [rad/s], `damping`, `integral_gain` [1/s³], `torque_limit` [N m or N]:
      (n,).
    - `compensation`: the terms that take part.
    - `friction_at`: whose velocity friction is computed for, `"measured"` or `"reference"`.
    - `friction_width`: (n,) [rad/s or m/s]; see `smooth_friction`.
    - `inertia`: (n,) the constant diagonal [kg m² or kg].

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Reference
    >>> network = jc.derive(jc.puma560())
    >>> k = network.coefficients_from(jc.puma560().links)
    >>> controller = ComputedTorque(network, k, natural_frequency=20.0)
    >>> q, still = jnp.zeros(6), jnp.zeros(6)
    >>> torque, _ = controller.step(controller.begin(q), Reference.rest(q), q, still, 0.002)
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
        """Of one robot; what is one number is the same for every joint.

        **Arguments**

        - `network`, `k`: (p,) the dynamics.
        - `natural_frequency`, `damping`: of the error [rad/s], [1].
        - `compensation`: a key of `COMPENSATIONS`, or some of `"mass"`, `"velocity"`,
          `"gravity"`, `"friction"`.
        - `integral_gain`: K_i [1/s³]; below 2 ζ ω_n³, or the error grows.
        - `torque_limit`: of the drives [N m or N].
        - `friction_at`: `"measured"` as in Eqn. 2.7-1. `"reference"` compensates the friction of
          the motion that is wanted: it breaks a resting joint away, and does not follow the signs
          of a quantised encoder's noise.
        - `friction_width`: speed below which friction falls to zero linearly [rad/s or m/s].
        - `pose`: (n,) where the constant diagonal is taken; zeros if omitted. Used without the
          mass term only.

        **Raises**

        - `ValueError`: an unknown word, or numbers that are not one a joint or out of range.
        """
        n = network.joint_count
        if isinstance(compensation, str):
            if compensation not in COMPENSATIONS:
                raise ValueError(
                    f"compensation is {compensation!r}; expected {_listed(COMPENSATIONS)}"
                )
            compensation = COMPENSATIONS[compensation]
        full = COMPENSATIONS["full"]
        for term in compensation:
            if term not in full:
                raise ValueError(f"compensation has {term!r}; expected some of {_listed(full)}")
        if friction_at not in ("measured", "reference"):
            raise ValueError(f"friction_at is {friction_at!r}; expected 'measured' or 'reference'")
        self.network = network
        self.k = jnp.asarray(k)
        if self.k.shape != (network.size,):
            raise ValueError(f"k: expected shape ({network.size},), got {self.k.shape}")
        self.natural_frequency = per_joint("natural_frequency", natural_frequency, n, 0.0)
        self.damping = per_joint("damping", damping, n, 0.0)
        self.integral_gain = per_joint("integral_gain", integral_gain, n, 0.0)
        self.torque_limit = per_joint("torque_limit", torque_limit, n, 0.0)
        self.friction_width = per_joint("friction_width", friction_width, n, 0.0)
        self.compensation = tuple(term for term in full if term in compensation)
        self.friction_at = friction_at
        if "mass" in self.compensation:
            self.inertia = jnp.zeros(n)
        else:
            at = jnp.zeros(n) if pose is None else jnp.asarray(pose)
            self.inertia = jnp.diagonal(network.mass_matrix(self.k, at))

    def with_coefficients(self, k: Float[Array, " coefficients"]) -> "ComputedTorque":
        """The same controller with other coefficients, (p,), which may be traced.

        The constant diagonal that stands in for a mass term that is left out stays what it was.
        """
        return eqx.tree_at(lambda controller: controller.k, self, k)

    def with_network(self, network: CSLC, k: Float[Array, " coefficients"]) -> "ComputedTorque":
        """The same controller over another network of as many joints and its coefficients."""
        return eqx.tree_at(
            lambda controller: (controller.network, controller.k), self, (network, k)
        )

    def begin(self, q: Joints) -> Float[Array, "*batch joints"]:
        """The integral: zero."""
        return jnp.zeros_like(jnp.asarray(q))

    def step(
        self,
        state: Float[Array, "*batch joints"],
        reference: Reference,
        q: Joints,
        qd: Joints,
        interval: float | Array,
    ) -> tuple[Float[Array, "*batch joints"], Float[Array, "*batch joints"]]:
        """As the abstract method."""
        q, qd = jnp.asarray(q), jnp.asarray(qd)
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
        state = integrated(state, error * interval, torque, self.torque_limit)
        return limited(torque, self.torque_limit), state

    def _rigid(self, q: Array, qd: Array, acceleration: Array) -> Array:
        """Every term but friction."""
        k = self.network.without_friction(self.k)
        gravity = "gravity" in self.compensation
        turning = qd if "velocity" in self.compensation else jnp.zeros_like(qd)
        if "mass" in self.compensation:
            torque = self.network.torque(k, q, turning, acceleration)
            return torque if gravity else torque - self.network.gravity_term(k, q)
        torque = jnp.broadcast_to(self.inertia, acceleration.shape) * acceleration
        torque = torque + self.network.spring_term(k, q)
        if "velocity" in self.compensation:
            torque = torque + self.network.velocity_term(k, q, turning)
        return torque + self.network.gravity_term(k, q) if gravity else torque


def smooth_friction(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    qd: Joints,
    width: Float[Array | np.ndarray, " joints"],
) -> Float[Array, "*batch joints"]:
    """F(qd) without its jump at rest: between −width and width, what joins the two ends.

    A straight line in the speed, from F(−width) to F(width), whatever friction model the network
    has; where the width is zero, F(qd) itself.

    **Arguments**

    - `network`, `k`: (p,).
    - `qd`: (*batch, n) [rad/s or m/s].
    - `width`: (n,) [rad/s or m/s].

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import smooth_friction
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
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
    # One joint's speed at a time: coupled joints rub by each other's.
    own = jnp.broadcast_to(jnp.eye(qd.shape[-1], dtype=bool), (*qd.shape, qd.shape[-1]))

    def beside(ends: Array) -> Array:
        each = jnp.where(own & within[..., None, :], ends[..., None, :], qd[..., None, :])
        return jnp.diagonal(network.friction_term(k, each), axis1=-2, axis2=-1)

    forwards, backwards = beside(width), beside(-width)
    return share * forwards + (1.0 - share) * backwards


def _listed(words: Sequence[str] | dict[str, tuple[str, ...]]) -> str:
    return ", ".join(repr(word) for word in words)

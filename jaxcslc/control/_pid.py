import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._controller import AbstractController
from ._gains import PerJoint, per_joint
from ._gravity import Gravity
from ._limits import integrated, limited
from ._reference import Joints, Reference


class PID(AbstractController):
    """Proportional, integral and velocity feedback joint by joint, with or without gravity.

        torque = K_p e + K_i ∫ e dt + K_d (qd_d − qd) [+ G(q)]        e = q_d − q

    It knows nothing of the arm's inertia: gains are torques. With `abbreviated_gravity` it is the
    controller of the thesis's comparison trajectories (7.4.2). The integral does not wind up
    against the torque limit (`integrated`). The state is the integral.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import PID, Reference
    >>> pid = PID(2, position_gain=100.0, velocity_gain=10.0, torque_limit=[5.0, 50.0])
    >>> q, still = jnp.zeros(2), jnp.zeros(2)
    >>> torque, state = pid.step(pid.begin(q), Reference.rest(jnp.full(2, 0.1)), q, still, 0.002)
    >>> torque.tolist()
    [5.0, 10.0]
    """

    position_gain: Float[Array, " joints"]
    integral_gain: Float[Array, " joints"]
    velocity_gain: Float[Array, " joints"]
    torque_limit: Float[Array, " joints"]
    gravity: Gravity | None

    def __init__(
        self,
        joints: int,
        *,
        position_gain: PerJoint,
        velocity_gain: PerJoint,
        integral_gain: PerJoint = 0.0,
        torque_limit: PerJoint = math.inf,
        gravity: Gravity | None = None,
    ) -> None:
        """A controller of `joints` joints; gains and limits are one number, or one each.

        **Arguments**

        - `position_gain`: K_p [N m/rad or N/m].
        - `velocity_gain`: K_d [N m s/rad or N s/m].
        - `integral_gain`: K_i [N m/(rad s) or N/(m s)].
        - `torque_limit`: of the drives [N m or N].
        - `gravity`: what to compensate besides; nothing if omitted.

        **Raises**

        - `ValueError`: a wrong number of gains, or a negative one; names it and the joint.
        """
        self.position_gain = per_joint("position_gain", position_gain, joints, 0.0)
        self.integral_gain = per_joint("integral_gain", integral_gain, joints, 0.0)
        self.velocity_gain = per_joint("velocity_gain", velocity_gain, joints, 0.0)
        self.torque_limit = per_joint("torque_limit", torque_limit, joints, 0.0)
        self.gravity = gravity

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
        error, rate = jnp.asarray(reference.q - q), reference.qd - qd
        gains = (self.position_gain, self.integral_gain, self.velocity_gain)
        position, integral, velocity = (jnp.broadcast_to(gain, error.shape) for gain in gains)
        torque = position * error + integral * state + velocity * rate
        if self.gravity is not None:
            torque = torque + self.gravity.torque(q)
        state = integrated(state, error * interval, torque, self.torque_limit)
        return limited(torque, self.torque_limit), state

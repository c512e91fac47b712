"""Control barrier function that keeps a controller from driving joints past their limits."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._controller import (
    AbstractController,
    Joints,
    PerJoint,
    Reference,
    per_joint,
    required_velocity,
    saturated,
)


class JointLimitAvoidance(AbstractController):
    """Keeps a controller from driving joints past their limits, by a control barrier function.

    The model predicts the acceleration that the controller's torque causes. It is clipped, joint by
    joint, at the acceleration that brings the joint to the end of its range without overshoot:

        −2 r qd + r² (lowest − q)  ≤  qdd  ≤  −2 r qd + r² (highest − q)

    (a second-order control barrier, Nguyen and Sreenath 2016). Where no acceleration is clipped the
    controller's torque is passed on unchanged. Otherwise the torque is the model's for the clipped
    accelerations, within the drives' limits. A joint approaches its limit at the rate r. One that
    is too fast for its drive, or whose drive has to carry its weight, can still pass it: use a slow
    rate and a margin. While an acceleration is clipped, the controller's state is frozen, so that
    no integral winds up.

    **Attributes**

    - `controller`: the wrapped controller; its state is this one's.
    - `network`, `k`: (p,) the dynamics.
    - `position_range`: (n, 2) lowest and highest positions, infinite for no limit [rad or m].
    - `torque_limit`: (n,) [N m or N].
    - `rate`: (n,) r [1/s].

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, JointLimitAvoidance, Reference
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction(), lengths="numeric")
    >>> pid = PID(1, position_gain=100.0, velocity_gain=10.0)
    >>> k = jnp.array([2.0])
    >>> safe = JointLimitAvoidance(pid, network, k, [(-1.0, 1.0)], torque_limit=50.0, rate=10.0)
    >>> q, qd = jnp.array([0.9]), jnp.zeros(1)  # a tenth of a radian from the limit
    >>> torque, _ = safe.step(safe.begin(q), Reference.at_rest(jnp.array([2.0])), q, 0.002, qd)
    >>> round(float(torque[0]), 6)  # 2 kg m² times 10² / s² times 0.1 rad
    20.0
    """

    controller: AbstractController
    network: CSLC
    k: Float[Array, " coefficients"]
    position_range: Float[Array, "joints 2"]
    torque_limit: Float[Array, " joints"]
    rate: Float[Array, " joints"]

    def __init__(
        self,
        controller: AbstractController,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        position_range: Sequence[Sequence[float]] | Float[Array | np.ndarray, "joints 2"],
        *,
        torque_limit: PerJoint,
        rate: PerJoint = 8.0,
    ) -> None:
        """A controller that respects the joints' position limits.

        **Arguments** are the attributes; one number stands for all joints.

        **Raises**

        - `ValueError`: a wrong number of ranges, limits, rates or coefficients; a range that ends
          before it begins; a negative limit or rate.
        """
        n = network.joint_count
        self.controller, self.network, self.k = controller, network, jnp.asarray(k)
        if self.k.shape != (network.size,):
            raise ValueError(f"k: expected shape ({network.size},), got {self.k.shape}")
        ranges = np.asarray(position_range, float)
        if ranges.shape != (n, 2):
            raise ValueError(f"position_range: expected shape ({n}, 2), got {ranges.shape}")
        for joint, (low, high) in enumerate(ranges, start=1):
            if not low < high:
                raise ValueError(
                    f"position_range of joint {joint} is ({low:g}, {high:g}); expected the lowest"
                    " position before a higher one"
                )
        self.position_range = jnp.asarray(ranges)
        self.torque_limit = jnp.asarray(per_joint("torque_limit", torque_limit, n, 0.0))
        self.rate = jnp.asarray(per_joint("rate", rate, n, 1e-3))

    def begin(self, q: Joints) -> Any:
        """The wrapped controller's state."""
        return self.controller.begin(q)

    def step(
        self,
        state: Any,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Float[Array, "*batch joints"], Any]:
        """Compute a safe torque command, as `AbstractController.step` describes."""
        qd = required_velocity(self, qd)
        torque, after = self.controller.step(state, reference, q, interval, qd)
        q, qd = jnp.asarray(q), jnp.asarray(qd)
        low, high, rate = (
            jnp.broadcast_to(values, q.shape)
            for values in (self.position_range[:, 0], self.position_range[:, 1], self.rate)
        )
        damping = -2.0 * rate * qd
        least, most = damping + rate**2 * (low - q), damping + rate**2 * (high - q)
        acceleration = self.network.forward_dynamics(self.k, q, qd, torque)
        allowed = jnp.clip(acceleration, least, most)
        safe = saturated(self.network.torque(self.k, q, qd, allowed), self.torque_limit)
        clipped = jnp.any(allowed != acceleration, axis=-1, keepdims=True)

        def frozen(old: Any, new: Any) -> Any:
            return jnp.where(clipped, old, new) if new.shape == q.shape else new

        state = jax.tree_util.tree_map(frozen, state, after)
        return jnp.where(clipped, safe, torque), state

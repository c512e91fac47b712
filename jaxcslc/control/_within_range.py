from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._controller import AbstractController
from ._gains import PerJoint, per_joint
from ._limits import limited
from ._reference import Joints, Reference


class WithinRange(AbstractController):
    """A controller that is kept from driving joints out of their ranges, whatever it asks for.

    What a torque would do is the model's to say. The acceleration that the controller's torque
    brings about is cut off, joint by joint, at the one that would bring the joint to the end of
    its range without overshoot:

        −2 r qd + r² (lowest − q)  ≤  qdd  ≤  −2 r qd + r² (highest − q)

    (a second-order control barrier, Nguyen and Sreenath 2016). Where nothing has to be cut off the
    controller's torque goes through as it is; where something has, the torque is what the model
    needs for the accelerations that are left, within the drives' limits. A joint arrives at an end
    at the rate r: one that comes too fast for its drive, or whose drive is needed for its weight,
    can still pass it, so a slow rate and some margin are worth having. While something is cut off,
    the controller's state stays as it was: no integral winds up against the end of a range.

    **Attributes**

    - `controller`: what is kept within bounds; its state is this one's.
    - `network`, `k`: (p,) the dynamics.
    - `position_range`: (n, 2) lowest and highest positions [rad or m]; infinite for no end.
    - `torque_limit`: (n,) [N m or N].
    - `rate`: (n,) r [1/s].

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, Reference, WithinRange
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction(), lengths="numeric")
    >>> pid = PID(1, position_gain=100.0, velocity_gain=10.0)
    >>> ends = [(-1.0, 1.0)]
    >>> kept = WithinRange(pid, network, jnp.array([2.0]), ends, torque_limit=50.0, rate=10.0)
    >>> q, still = jnp.array([0.9]), jnp.zeros(1)  # a tenth of a radian from the end
    >>> torque, _ = kept.step(kept.begin(q), Reference.rest(jnp.array([2.0])), q, still, 0.002)
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
        """**Arguments** are the attributes.

        **Raises**

        - `ValueError`: ranges that are not one a joint, or end before they begin; coefficients that
          are not the network's; limits or rates that are negative or not one a joint.
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
        self.torque_limit = per_joint("torque_limit", torque_limit, n, 0.0)
        self.rate = per_joint("rate", rate, n, 1e-3)

    def begin(self, q: Joints) -> Any:
        """As the controller's."""
        return self.controller.begin(q)

    def step(
        self, state: Any, reference: Reference, q: Joints, qd: Joints, interval: float | Array
    ) -> tuple[Float[Array, "*batch joints"], Any]:
        """As the abstract method."""
        torque, after = self.controller.step(state, reference, q, qd, interval)
        q, qd = jnp.asarray(q), jnp.asarray(qd)
        low, high, rate = (
            jnp.broadcast_to(each, q.shape)
            for each in (self.position_range[:, 0], self.position_range[:, 1], self.rate)
        )
        drawn = -2.0 * rate * qd
        least, most = drawn + rate**2 * (low - q), drawn + rate**2 * (high - q)
        acceleration = self.network.forward_dynamics(self.k, q, qd, torque)
        allowed = jnp.clip(acceleration, least, most)
        kept = limited(self.network.torque(self.k, q, qd, allowed), self.torque_limit)
        cut = jnp.any(allowed != acceleration, axis=-1, keepdims=True)
        state = jax.tree_util.tree_map(
            lambda old, new: jnp.where(cut, old, new) if new.shape == q.shape else new, state, after
        )
        return jnp.where(cut, kept, torque), state

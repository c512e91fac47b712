from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..control import ComputedTorque, Loop, LoopState, LowPassChain, Reference
from ._estimator import PayloadEstimator, PayloadState


class CarryingState(NamedTuple):
    """What a `CarryingLoop` remembers."""

    loop: LoopState
    learning: PayloadState
    """`learning.estimate` is what is known of the payload."""
    body: Float[Array, "10"]
    """The payload that is compensated: it follows what is known without a jump."""


class CarryingLoop(eqx.Module):
    """Computed torque that learns its payload while it carries it (thesis 8.2.4).

    A `Loop` and a `PayloadEstimator` on the same readings: as soon as a payload has been found,
    its ten parameters are part of the model that the controller inverts, and they are none again
    once it has been put down. They fade in over `fade`, for a step in the model is a step in the
    torque.

    One robot at a time, (n,); `vmap` over several.

    **Attributes**

    - `controller`: its network and coefficients are the unloaded arm's, as the estimator's.
    - `estimator`: of the payload.
    - `filter`: of the error, as `Loop`'s.
    - `fade`: time over which the difference to what is known falls by a factor e [s].
    - `compensating`: 1 to compensate what is learnt, 0 to learn only.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Reference
    >>> from jaxcslc.payload import CarryingLoop, PayloadEstimator
    >>> network = jc.derive(jc.puma560())
    >>> k = network.coefficients_from(jc.puma560().links)
    >>> estimator = PayloadEstimator(network, k, noise=np.full(6, 1e-4))
    >>> loop = CarryingLoop(ComputedTorque(network, k, 20.0), estimator)
    >>> q = jnp.zeros(6)
    >>> torque, state = loop.step(loop.begin(q), Reference.rest(q), q, 0.002)
    >>> bool(state.learning.estimate.carrying)
    False
    """

    controller: ComputedTorque
    estimator: PayloadEstimator
    filter: LowPassChain
    fade: float
    compensating: float | Float[Array, ""]

    def __init__(
        self,
        controller: ComputedTorque,
        estimator: PayloadEstimator,
        *,
        filter: LowPassChain | None = None,
        fade: float = 0.05,
        compensating: float | Float[Array, ""] = 1.0,
    ) -> None:
        """**Raises** `ValueError` if controller and estimator have not the same coefficients."""
        arm_k = controller.k[controller.network.layout.unloaded]
        if arm_k.shape != estimator.k.shape:
            raise ValueError(
                f"the controller's network has {len(arm_k)} coefficients of the arm, the"
                f" estimator's {estimator.k.shape[0]}; expected the same network"
            )
        k = jnp.concatenate([arm_k, jnp.zeros(10)])
        controller = controller.with_network(estimator.network, k)
        self.controller, self.estimator = controller, estimator
        self.filter = Loop(controller).filter if filter is None else filter
        self.fade, self.compensating = fade, compensating

    def begin(self, q: Float[Array | np.ndarray, " joints"]) -> CarryingState:
        """The state before the first sample, without payload, the joints at rest at `q` (n,)."""
        loop = Loop(self.controller, self.filter)
        return CarryingState(loop.begin(q), self.estimator.begin(q), jnp.zeros(10))

    def step(
        self,
        state: CarryingState,
        reference: Reference,
        q: Float[Array | np.ndarray, " joints"],
        interval: float | Array,
    ) -> tuple[Float[Array, " joints"], CarryingState]:
        """The torque to ask for when encoders read `q`, and the state to go on with.

        Arguments and results as of `Loop.step`, for one robot.
        """
        known = state.learning.estimate
        wanted = jnp.where(known.carrying, known.body, jnp.zeros(10))
        body = wanted + (state.body - wanted) * jnp.exp(-interval / self.fade)
        k = self.controller.k.at[self.controller.network.layout.payload].set(
            self.compensating * body
        )
        loop = Loop(self.controller.with_coefficients(k), self.filter)
        torque, own = loop.step(state.loop, reference, q, interval)
        learning = self.estimator.step(state.learning, q, torque, interval)
        return torque, CarryingState(own, learning, body)

"""Computed-torque control with a payload that is identified on-line."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..control import (
    AbstractController,
    ComputedTorque,
    LowPassChain,
    OutputFeedback,
    OutputFeedbackState,
    Reference,
)
from ._change_detection import PayloadState
from ._estimator import PayloadEstimator


class PayloadCompensationState(NamedTuple):
    """The memory of a `PayloadCompensation` controller.

    **Attributes**

    - `feedback`: state of the feedback controller.
    - `estimator`: state of the estimator; `estimator.estimate` is the present estimate.
    - `body`: the compensated payload, (10,); it follows the estimate without a jump.
    """

    feedback: OutputFeedbackState
    estimator: PayloadState
    body: Float[Array, "10"]


class PayloadCompensation(AbstractController):
    """Computed-torque control that identifies and compensates a payload on-line (thesis 8.2.4).

    An `OutputFeedback` and a `PayloadEstimator` share the readings. When a payload has been
    detected, its ten parameters become part of the model that the controller inverts; when it has
    been put down they are zero again. They change gradually, since a step in the model is a step
    in the torque.

    One robot, (n,); `jax.vmap` over several.

    **Attributes**

    - `controller`: with the network and the coefficients of the unloaded arm, as the estimator.
    - `estimator`: of the payload.
    - `filter`: of the error, as `OutputFeedback`'s.
    - `time_constant`: of the transition to a new estimate [s].
    - `compensation_gain`: 1 to compensate the estimate, 0 to estimate only.

    >>> import jax, jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Reference
    >>> from jaxcslc.payload import PayloadCompensation, PayloadEstimator
    >>> network = jc.derive(jc.puma560())
    >>> k = network.coefficients_from(jc.puma560().links)
    >>> estimator = PayloadEstimator(network, k, noise=np.full(6, 1e-4))
    >>> controller = PayloadCompensation(ComputedTorque(network, k, 20.0), estimator)
    >>> q = jnp.zeros(6)
    >>> step = jax.jit(lambda *inputs: controller.step(*inputs))
    >>> torque, state = step(controller.begin(q), Reference.at_rest(q), q, 0.002)
    >>> bool(state.estimator.estimate.carrying)
    False
    """

    controller: ComputedTorque
    estimator: PayloadEstimator
    filter: LowPassChain
    time_constant: float
    compensation_gain: float | Float[Array, ""]

    def __init__(
        self,
        controller: ComputedTorque,
        estimator: PayloadEstimator,
        *,
        filter: LowPassChain | None = None,
        time_constant: float = 0.05,
        compensation_gain: float | Float[Array, ""] = 1.0,
    ) -> None:
        """A controller with payload compensation.

        **Arguments** are the attributes.

        **Raises**

        - `ValueError`: controller and estimator have different networks.
        """
        arm_k = controller.k[controller.network.layout.unloaded]
        if arm_k.shape != estimator.k.shape:
            raise ValueError(
                f"the controller's network has {len(arm_k)} coefficients of the arm, the"
                f" estimator's {estimator.k.shape[0]}; expected the same network"
            )
        k = jnp.concatenate([arm_k, jnp.zeros(10)])
        controller = controller.with_coefficients(k, estimator.network)
        self.controller, self.estimator = controller, estimator
        self.filter = OutputFeedback(controller).filter if filter is None else filter
        self.time_constant, self.compensation_gain = time_constant, compensation_gain

    def begin(self, q: Float[Array | np.ndarray, " joints"]) -> PayloadCompensationState:
        """The state before the first sample, without payload."""
        feedback = OutputFeedback(self.controller, self.filter)
        return PayloadCompensationState(feedback.begin(q), self.estimator.begin(q), jnp.zeros(10))

    def step(
        self,
        state: PayloadCompensationState,
        reference: Reference,
        q: Float[Array | np.ndarray, " joints"],
        interval: float | Array,
        qd: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, " joints"], PayloadCompensationState]:
        """Compute the torque command, as `AbstractController.step`, without measured velocities."""
        del qd
        estimate = state.estimator.estimate
        target = jnp.where(estimate.carrying, estimate.body, jnp.zeros(10))
        body = target + (state.body - target) * jnp.exp(-interval / self.time_constant)
        payload = self.controller.network.layout.payload
        k = self.controller.k.at[payload].set(self.compensation_gain * body)
        feedback = OutputFeedback(self.controller.with_coefficients(k), self.filter)
        torque, inner = feedback.step(state.feedback, reference, q, interval)
        estimator = self.estimator.step(state.estimator, q, torque, interval)
        return jnp.asarray(torque), PayloadCompensationState(inner, estimator, body)

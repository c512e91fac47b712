from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._controller import AbstractController, Joints, Reference
from ._low_pass import LowPassChain


class OutputFeedbackState(NamedTuple):
    """The memory of an `OutputFeedback` controller.

    **Attributes**

    - `error`: position error at the previous sample, (*batch, n) [rad or m].
    - `filter`: state of the filter on the error, (lags, *batch, n).
    - `controller`: state of the wrapped controller.
    """

    error: Float[Array, "*batch joints"]
    filter: Float[Array, "lags *batch joints"]
    controller: Any


class OutputFeedback(AbstractController):
    """Velocity estimation for a controller of an arm that has encoders, but no tachometers.

    The rate of the *error* is filtered, not that of the position: while the arm follows its path
    the filter then causes no delay. The controller gets qd_d minus the filtered rate of e as its
    velocity, and the reading as its position. Where a reading is lost (NaN) the error is kept
    from the sample before; a `FaultMonitor` ends the motion if too many are lost in a row.

    **Attributes**

    - `controller`: the controller that needs positions and velocities.
    - `filter`: of the error.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import PID, LowPassChain, OutputFeedback, Reference
    >>> pid = PID(1, position_gain=100.0, velocity_gain=10.0)
    >>> feedback = OutputFeedback(pid, LowPassChain(50.0, lags=2))
    >>> q, reference = jnp.zeros(1), Reference.at_rest(jnp.array([0.1]))
    >>> torque, state = feedback.step(feedback.begin(q), reference, q, 0.002)
    >>> bool(torque[0] > 10.0)
    True
    """

    controller: AbstractController
    filter: LowPassChain = LowPassChain(50.0, lags=2)

    def begin(self, q: Joints) -> OutputFeedbackState:
        """The state before the first sample, with the joints at rest where the path begins."""
        zero = jnp.zeros_like(jnp.asarray(q))
        return OutputFeedbackState(zero, self.filter.begin(zero), self.controller.begin(q))

    def step(
        self,
        state: OutputFeedbackState,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, OutputFeedbackState]:
        """As `AbstractController.step`; measured velocities are not used."""
        del qd
        error = jnp.asarray(reference.q - q)
        lost = jnp.isnan(error)
        error = jnp.where(lost, state.error, error)
        q = jnp.where(lost, reference.q - error, q)
        filtered = self.filter.step(state.filter, state.error, error, interval)
        estimate = reference.qd - self.filter.read(filtered).rate
        torque, inner = self.controller.step(state.controller, reference, q, interval, estimate)
        return torque, OutputFeedbackState(error, filtered, inner)

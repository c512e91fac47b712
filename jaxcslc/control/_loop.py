from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._controller import AbstractController
from ._low_pass import LowPassChain
from ._reference import Joints, Reference


class LoopState(NamedTuple):
    """What a loop remembers."""

    error: Float[Array, "*batch joints"]
    """Of position, at the sample before [rad or m]."""
    chain: Float[Array, "lags *batch joints"]
    """Of the filter on it."""
    controller: Any
    """The controller's own state."""


class Loop(eqx.Module):
    """A controller behind encoders: what a sample's readings become a torque by.

    An arm without tachometers has to find its velocities. The rate of the *error* is filtered
    rather than that of the position: along the path the filter then has nothing to delay, and the
    velocity handed to the controller is qd_d less the filtered rate of e. The position handed on
    is the reading; where none has come (NaN), the error is taken to be what it was. A `Guard`
    around the loop ends the motion if none comes for longer.

    **Attributes**

    - `controller`: of readings and velocities.
    - `filter`: of the error.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import PID, Loop, LowPassChain, Reference
    >>> loop = Loop(PID(1, position_gain=100.0, velocity_gain=10.0), LowPassChain(50.0, lags=2))
    >>> state = loop.begin(jnp.zeros(1))
    >>> torque, state = loop.step(state, Reference.rest(jnp.array([0.1])), jnp.zeros(1), 0.002)
    >>> bool(torque[0] > 10.0)
    True
    """

    controller: AbstractController
    filter: LowPassChain = LowPassChain(50.0, lags=2)

    def begin(self, q: Joints) -> LoopState:
        """The state before the first sample, the joints at rest where encoders read `q`, which is
        where the path begins; (*batch, n) [rad or m]."""
        none = jnp.zeros_like(jnp.asarray(q))
        return LoopState(none, self.filter.begin(none), self.controller.begin(q))

    def step(
        self, state: LoopState, reference: Reference, q: Joints, interval: float | Array
    ) -> tuple[Float[Array, "*batch joints"], LoopState]:
        """The torque to ask for when encoders read `q`, and the state to go on with.

        Arguments and results as of `AbstractController.step`, without velocities.
        """
        error = jnp.asarray(reference.q - q)
        lost = jnp.isnan(error)
        error = jnp.where(lost, state.error, error)
        q = jnp.where(lost, reference.q - error, q)
        chain = self.filter.step(state.chain, state.error, error, interval)
        qd = reference.qd - self.filter.read(chain).rate
        torque, own = self.controller.step(state.controller, reference, q, qd, interval)
        return torque, LoopState(error, chain, own)

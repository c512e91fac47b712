"""Feedback loops of the payload study: several robots in one, and a known payload."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC, LinkParameters
from jaxcslc.control import (
    AbstractController,
    ComputedTorque,
    OutputFeedback,
    OutputFeedbackState,
    Reference,
)


class LoopBatch(AbstractController):
    """Loops of several robots, alike but for their arrays, as one of (robots, joints).

    They are computed one after the other: under `vmap` every robot's `PayloadEstimator` would do at
    each sample what it does at every tenth.
    """

    loops: Any
    """One loop, whose arrays have a first axis of robots."""

    @classmethod
    def of(cls, loops: Sequence[Any]) -> "LoopBatch":
        def stacked(*leaves: Any) -> Any:
            return jnp.stack(leaves) if eqx.is_array(leaves[0]) else leaves[0]

        return cls(jax.tree_util.tree_map(stacked, *loops))

    def begin(self, q: Float[Array | np.ndarray, "robots joints"]) -> Any:
        """Return each robot's state."""
        arrays, static = eqx.partition(self.loops, eqx.is_array)

        def one(robot: Any) -> Any:
            loop, q = robot
            return eqx.combine(loop, static).begin(q)

        return jax.lax.map(one, (arrays, q))

    def step(
        self,
        state: Any,
        reference: Reference,
        q: Float[Array | np.ndarray, "robots joints"],
        interval: float | Array,
        qd: Float[Array | np.ndarray, "robots joints"] | None = None,
    ) -> tuple[Float[Array, "robots joints"], Any]:
        """Return each robot's torque and state."""
        del qd
        arrays, static = eqx.partition(self.loops, eqx.is_array)

        def one(robot: Any) -> Any:
            loop, *inputs = robot
            return eqx.combine(loop, static).step(*inputs, interval)

        return jax.lax.map(one, (arrays, state, reference, q))


class KnownPayloadLoop(AbstractController):
    """Computed torque with a known payload from one time to another."""

    loop: OutputFeedback
    body: Float[Array, "10"]
    start: Float[Array, ""]
    stop: Float[Array, ""]

    @classmethod
    def of(
        cls,
        controller: ComputedTorque,
        network: CSLC,
        body: LinkParameters | None = None,
        start: float = 0.0,
        stop: float = 0.0,
    ) -> "KnownPayloadLoop":
        """Return it from the arm's controller, and the arm's network with payload."""
        k = jnp.concatenate([controller.k, jnp.zeros(10)])
        links = [LinkParameters(0.0, jnp.zeros(3), jnp.zeros((3, 3)))] * network.joint_count
        ten = jnp.zeros(10)
        if body is not None:
            ten = network.coefficients_from(links, payload=body)[network.layout.payload]
        return cls(
            OutputFeedback(controller.with_coefficients(k, network)),
            ten,
            jnp.asarray(start),
            jnp.asarray(stop),
        )

    def begin(
        self, q: Float[Array | np.ndarray, " joints"]
    ) -> tuple[Float[Array, ""], OutputFeedbackState]:
        """Its clock, and the loop's state."""
        return jnp.zeros(()), self.loop.begin(q)

    def step(
        self,
        state: tuple[Float[Array, ""], OutputFeedbackState],
        reference: Reference,
        q: Float[Array | np.ndarray, " joints"],
        interval: float | Array,
        qd: Float[Array | np.ndarray, " joints"] | None = None,
    ) -> tuple[Float[Array, " joints"], tuple[Float[Array, ""], OutputFeedbackState]]:
        """Return what `OutputFeedback.step` returns."""
        del qd
        clock, inner = state
        carrying = (clock > self.start - 0.5 * interval) & (clock < self.stop - 0.5 * interval)
        controller = self.loop.controller
        assert isinstance(controller, ComputedTorque)
        k = controller.k.at[controller.network.layout.payload].set(
            jnp.where(carrying, self.body, 0.0)
        )
        loop = OutputFeedback(controller.with_coefficients(k), self.loop.filter)
        torque, inner = loop.step(inner, reference, q, interval)
        return jnp.asarray(torque), (clock + interval, inner)

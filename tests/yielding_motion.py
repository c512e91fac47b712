"""Motion of joints with pre-sliding friction by another integrator, for comparison."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC
from jaxcslc.friction import split_friction


State = tuple[Array, Array, Array]
"""Positions, velocities and states of contacts, (n,) each."""

# Of positions [rad or m], velocities and states, and as parts of them: the error of a step.
_MOTION_TOLERANCE = 1e-7


@eqx.filter_jit
def yielding_motion(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    lengths: Float[Array | np.ndarray, " joints"],
    start: tuple[Float[Array | np.ndarray, " joints"], ...],
    torque: Float[Array | np.ndarray, "intervals joints"],
    interval: float,
) -> tuple[Float[Array, "instants joints"], ...]:
    """Motion of joints whose dry friction yields before it slides, under torques that are held.

    **Arguments**

    - `network`: n joints, p coefficients; `k`: (p,).
    - `lengths`: (n,) of pre-sliding [rad or m]; of no account where a joint has no dry friction.
    - `start`: positions, velocities and states of contacts, (n,) each [rad, rad/s or m, m/s, 1].
    - `torque`: (intervals, n) [N m or N]; `interval`: its length [s].

    **Returns** these at the beginning of every interval and at the end, (intervals + 1, n).
    """
    others, friction, length = split_friction(network, jnp.asarray(k), lengths)

    def rates(t: Any, state: State, force: Array) -> State:
        del t
        q, qd, w = state
        acceleration = network.forward_dynamics(others, q, qd, force - friction * w)
        return qd, acceleration, (qd - jnp.abs(qd) * w) / length

    # One solution an interval: torque jumps between them, which no step may reach across.
    def through(state: State, force: Array) -> tuple[State, State]:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Tsit5(),
            t0=0.0,
            t1=interval,
            dt0=None,
            y0=state,
            args=force,
            stepsize_controller=diffrax.PIDController(
                rtol=_MOTION_TOLERANCE, atol=_MOTION_TOLERANCE
            ),
            throw=False,
        )
        assert solution.ys is not None
        solved = solution.result == diffrax.RESULTS.successful
        q, qd, w = (jnp.where(solved, x[-1], jnp.nan) for x in solution.ys)
        return (q, qd, w), (q, qd, w)

    q, qd, w = (jnp.asarray(x, float) for x in start)
    _, path = jax.lax.scan(through, (q, qd, w), jnp.asarray(torque))
    return tuple(jnp.concatenate([x[None], xs]) for x, xs in zip((q, qd, w), path, strict=True))

from collections.abc import Callable
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...network import CSLC
from ...network.terms import JointTerm
from ..friction import split_friction, state_after
from ._stick_slip import Friction, acceleration, through_stops


# Longest step of integration [s].
_LONGEST_STEP = 2e-3
# Speed at which friction of either direction is read off [rad/s or m/s].
_SLOWEST = 1e-9


State: TypeAlias = tuple[Array, Array, Array]
"""Positions, velocities and states of contacts, (starts, n) each."""


@eqx.filter_jit
def simulate(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    q: Float[Array | np.ndarray, "starts joints"],
    qd: Float[Array | np.ndarray, "starts joints"],
    torque: Float[Array | np.ndarray, "intervals starts joints"],
    interval: float,
    *,
    lengths: Float[Array | np.ndarray, " joints"] | None = None,
    contact: Float[Array | np.ndarray, "starts joints"] | None = None,
) -> Float[Array, "instants starts joints"]:
    """Motion under torques that are held for an interval each, without feedback.

    Midpoint rule, in stretches where a joint comes to rest within a step. A joint at rest sticks
    while friction need not exceed break-away, as the accelerations of all joints make it: one that
    moves can drag others along, and some stick because others do.
    A joint whose dry friction yields before it slides never sticks: its contact holds it.

    **Arguments**

    - `network`: n joints, p coefficients; `k`: (p,).
    - `q`, `qd`: positions and velocities to start from, (starts, n) [rad, rad/s or m, m/s].
    - `torque`: (intervals, starts, n) [N m or N].
    - `interval`: its length [s].
    - `lengths`: (n,) of pre-sliding [rad or m], 0 where dry friction follows the sign of velocity;
      None if it does everywhere.
    - `contact`: (starts, n) states of contacts to start from (`pre_sliding`); zeros if None.

    **Returns** positions at the beginning of each interval and at the end, (intervals + 1, starts,
    n). They are not finite where the model's mass matrix is that of no body.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification.prediction import simulate
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(pendulum.with_friction("dry"), lengths="numeric")
    >>> start, push = np.zeros((2, 1)), np.full((100, 2, 1), 1.5)
    >>> push[:, 1] = 0.4  # less than dry friction
    >>> path = simulate(network, np.array([2.0, 0.5]), start, start, push, 0.01)
    >>> np.round(path[-1, :, 0], 4).tolist()  # (1.5 - 0.5) / 2.0 / 2
    [0.25, 0.0]
    """
    advance = held_step(network, jnp.asarray(k), interval, lengths)

    def through(state: State, force: Array) -> tuple[State, Array]:
        after = advance(state, force)
        return after, after[0]

    start = jnp.asarray(q), jnp.asarray(qd), jnp.asarray(0 * q if contact is None else contact)
    _, path = jax.lax.scan(through, start, jnp.asarray(torque))
    return jnp.concatenate([start[0][None], path])


def held_step(
    network: CSLC,
    k: Array,
    interval: float,
    lengths: Float[Array | np.ndarray, " joints"] | None = None,
) -> Callable[[State, Array], State]:
    """The motion of one interval of `simulate`: from the state at its beginning and the torque that
    is held, (starts, n) each, to the state at its end.

    States of contacts change only where `lengths` says that friction has them. Along each half of a
    step they follow the path exactly. A contact is a spring of friction / length, as stiff as 1e5
    N m/rad on real arms, which the explicit rule would let vibrate ever more: so friction at the
    middle of a step is that of the implicit rule, to first order in the step's acceleration.
    """
    if network.load_terms:
        raise ValueError("simulation: knows no friction of kind 'load'; remove it")
    steps = max(1, int(np.ceil(interval / _LONGEST_STEP - 1e-9)))
    h = interval / steps
    others, dry, length = (
        (k, None, None) if lengths is None else split_friction(network, k, lengths)
    )

    def contact_after(w: Array, change: Array) -> Array:
        return w if length is None else state_after(w, change, length[None])

    def contact_torque(w: Array) -> Array | float:
        return 0.0 if dry is None else dry[None] * w

    def contact_stiffness(w: Array, sign: Array) -> Array | float:
        if dry is None or length is None:
            return 0.0
        return ((dry / length)[None] * (1.0 - sign * w))[:, :, None] * jnp.eye(w.shape[1])[None]

    def step(state: State, force: Array) -> State:
        q, qd, w = state
        friction = Friction(
            _joint_torque(network, others, q, jnp.full_like(qd, _SLOWEST)),
            _joint_torque(network, others, q, jnp.full_like(qd, -_SLOWEST)),
        )
        resting = friction.holds & (qd == 0.0)
        half_way = contact_after(w, 0.5 * h * qd)

        def drive_at(q: Array, qd: Array) -> Array:
            """Torque less all but inertia and friction of joints."""
            return force - _other_torque(network, others, q, qd) - contact_torque(half_way)

        def mass_at(q: Array, direction: Array) -> Array:
            stiffness = contact_stiffness(half_way, direction)
            return network.mass_matrix(k, q) + 0.25 * h**2 * stiffness

        resisting = jnp.where(resting, 0.0, _joint_torque(network, others, q, qd))
        drive = drive_at(q, qd)
        sign = jnp.where(qd == 0.0, jnp.sign(drive - resisting), jnp.sign(qd))
        mass = mass_at(q, sign)
        leaving = friction.directions(mass, drive - resisting, resting)
        sign = jnp.where(resting, leaving, sign)
        resisting = resisting + friction.leaving(leaving)
        first = acceleration(mass, drive - resisting, resting & (leaving == 0.0))
        # A contact is stiffer on the way back: by the stiffness of the way there, a joint that
        # turns would turn with more energy than it came with.
        back = sign * (qd + h * first) < 0.0
        middle = q + 0.5 * h * qd, qd + 0.5 * h * first
        mass, drive = mass_at(middle[0], jnp.where(back, -sign, sign)), drive_at(*middle)
        slides = jnp.where(
            friction.holds, sign * jnp.maximum(sign * middle[1], _SLOWEST), middle[1]
        )
        resisting = _joint_torque(network, others, middle[0], slides)
        moved, after = through_stops(mass, drive, resisting, friction, leaving, qd, h)
        return q + moved, after, contact_after(half_way, 0.5 * h * after)

    def advance(state: State, force: Array) -> State:
        return jax.lax.fori_loop(0, steps, lambda _, carry: step(carry, force), state)

    return advance


def _joint_torque(network: CSLC, k: Array, q: Array, qd: Array) -> Array:
    """Of friction laws and springs of single joints."""
    return _sum(network, k, (q, qd, jnp.zeros_like(q)), of_joints=True)


def _other_torque(network: CSLC, k: Array, q: Array, qd: Array) -> Array:
    """Of all else, without acceleration."""
    return _sum(network, k, (q, qd, jnp.zeros_like(q)), of_joints=False)


def _sum(network: CSLC, k: Array, motion: tuple[Array, ...], *, of_joints: bool) -> Array:
    total = jnp.zeros_like(motion[0])
    for term in network.terms:
        if isinstance(term, JointTerm) == of_joints:
            total = total + term.torque(k[network.layout.of(term)], *motion)
    return total

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..network import CSLC
from ._computed_torque import smooth_friction
from ._gains import PerJoint, per_joint
from ._low_pass import LowPassChain
from ._reference import Reference


FAULTS = ("none", "lost samples", "stuck encoder", "reversed torque")
"""What a `Guard` can find wrong with a joint, by its code."""

_NONE, _LOST, _STUCK, _REVERSED = range(4)
# Of the time that evidence of a reversed torque is weighed over.
_WEIGHED = 0.02  # s
# A healthy encoder shows a motion of this much; some counts of the coarsest.
_UNSEEN = 1e-3  # rad or m
_SLOW = 0.02  # rad/s or m/s
# Samples that read the same before a reading is looked at as stuck.
_ALIKE = 5


class GuardState(NamedTuple):
    """What a `Guard` remembers; arrays of (n,) but where it says otherwise."""

    fault: Int[Array, " joints"]
    """What was found first at each joint: a place in `FAULTS`."""
    found: Float[Array, " joints"]
    """When [s since `begin`]; −1 for never."""
    time: Float[Array, ""]
    """Since `begin` [s]."""
    stopping: Float[Array, ""]
    """Since the arm began to be brought to rest [s]; −1 as long as all is well."""
    origin: Float[Array, " joints"]
    """Where it was then."""
    speed: Float[Array, " joints"]
    """How fast it was then."""
    position: Float[Array, " joints"]
    """The latest reading, or what stood in for it."""
    torque: Float[Array, " joints"]
    """What was asked for upon it."""
    motion: Float[Array, "lags joints"]
    effort: Float[Array, "lags joints"]
    missing: Int[Array, " joints"]
    """Samples in a row that have not come."""
    alike: Int[Array, " joints"]
    """Samples in a row that read the same."""
    held: Float[Array, " joints"]
    """For how long a joint that should have moved has read the same [s]."""
    evidence: Float[Array, " joints"]
    """Of a reversed torque; 1 is proof."""
    loop: Any
    """What the guarded loop remembers."""


class Guard(eqx.Module):
    """A loop that is watched: faults are found and named, and the arm is brought to rest.

    The model that a controller inverts also says what a healthy arm does with a torque. The torque
    N that the motion needs (the network's, on readings filtered by a `LowPassChain`) is compared
    with the torque τ that was asked for, filtered alike:

    - **lost samples**: readings that are not numbers. A few in a row are bridged at the latest
      velocity; more than `allowed` are a fault.
    - **stuck encoder**: a reading that stays the same while |τ − N| is more than friction can
      hold (`breakaway`), for `patience`. A joint that is really held by something in its way looks
      the same. At rest below breakaway nothing is wrong with a stuck encoder yet.
    - **reversed torque**: N and τ of opposite signs. The evidence −4 N τ / friction², the
      difference of the squared errors of the two readings of the sign, less what small errors
      bring about, is summed up and falls back to zero while all is well (Page's CUSUM, 1954).

    The first fault ends the motion: from where it is the arm is slowed down uniformly within
    `stop` seconds and held. Joints without a reading follow the model alone, and then friction
    and gravity compensation hold them; a reversed drive is driven reversed. What was found stays.
    What comes later is named only if readings are lost: a fault shakes the other joints.

    One robot at a time, (n,); `vmap` over several.

    **Attributes**

    - `loop`: anything with `begin(q)` and `step(state, reference, q, interval)`, such as a `Loop`.
    - `network`, `k`: (p,) the dynamics.
    - `breakaway`: (n,) torque at which a resting joint moves for certain [N m or N].
    - `torque_limit`: (n,) [N m or N].
    - `filter`: of readings and torques; its delay is part of the time that finding takes.
    - `patience`: [s].
    - `stop`: [s].
    - `allowed`: lost samples in a row that are bridged.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, Guard, Loop, Reference
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot)
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    >>> guard = Guard(Loop(ComputedTorque(network, k, 20.0)), network, k, torque_limit=90.0)
    >>> q = jnp.zeros(6)
    >>> state, gone = guard.begin(q), q.at[2].set(jnp.nan)
    >>> for _ in range(7):
    ...     torque, state = guard.step(state, Reference.rest(q), gone, 0.002)
    >>> guard.report(state)
    ('joint 3: lost samples, found at 0.010 s',)
    """

    loop: Any
    network: CSLC
    k: Float[Array, " coefficients"]
    breakaway: Float[Array, " joints"]
    torque_limit: Float[Array, " joints"]
    filter: LowPassChain
    patience: float
    stop: float
    allowed: int = eqx.field(static=True)

    def __init__(
        self,
        loop: Any,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        *,
        torque_limit: PerJoint,
        breakaway: PerJoint | None = None,
        filter: LowPassChain | None = None,
        patience: float = 0.02,
        stop: float = 0.3,
        allowed: int = 5,
    ) -> None:
        """**Arguments**

        - as the attributes. `breakaway`, if omitted, is 1.6 times the friction of a very slow joint
          and a fiftieth of the torque limit; the filter has three lags of 30 Hz.

        **Raises**

        - `ValueError`: numbers that are not one a joint, negative, or no coefficients of the
          network's.
        """
        n = network.joint_count
        self.loop, self.network, self.k = loop, network, jnp.asarray(k)
        if self.k.shape != (network.size,):
            raise ValueError(f"k: expected shape ({network.size},), got {self.k.shape}")
        self.torque_limit = per_joint("torque_limit", torque_limit, n, 0.0)
        if breakaway is None:
            slow = [
                jnp.abs(network.friction_term(self.k, jnp.full(n, speed)))
                for speed in (1e-6, -1e-6)
            ]
            breakaway = 1.6 * jnp.maximum(*slow) + 0.02 * self.torque_limit
        self.breakaway = per_joint("breakaway", breakaway, n, 0.0)
        if not isinstance(self.breakaway, Tracer):
            each = np.asarray(self.breakaway)
            for joint in np.flatnonzero(~((each > 0) & np.isfinite(each))):
                raise ValueError(
                    f"breakaway of joint {joint + 1} is {each[joint]}; expected a finite torque"
                    " above 0"
                )
        self.filter = LowPassChain(30.0, lags=3) if filter is None else filter
        if self.filter.lags < 3:
            raise ValueError(f"filter has {self.filter.lags} lags; accelerations need 3 or more")
        for name, time in (("patience", patience), ("stop", stop)):
            if not time > 0:
                raise ValueError(f"{name} is {time} s; expected more than 0")
        if allowed < 0:
            raise ValueError(f"allowed is {allowed}; expected 0 or more samples")
        self.patience, self.stop, self.allowed = patience, stop, allowed

    def begin(self, q: Float[Array | np.ndarray, " joints"]) -> GuardState:
        """The state before the first sample, nothing wrong, the joints at rest at `q` (n,)."""
        q = jnp.asarray(q)
        none, zero, count = jnp.zeros_like(q), jnp.zeros((), q.dtype), jnp.zeros(q.shape, int)
        return GuardState(
            fault=count,
            found=none - 1.0,
            time=zero,
            stopping=zero - 1.0,
            origin=q,
            speed=none,
            position=q,
            torque=none,
            motion=self.filter.begin(q),
            effort=self.filter.begin(none),
            missing=count,
            alike=count,
            held=none,
            evidence=none,
            loop=self.loop.begin(q),
        )

    def step(
        self,
        state: GuardState,
        reference: Reference,
        q: Float[Array | np.ndarray, " joints"],
        interval: float | Array,
    ) -> tuple[Float[Array, " joints"], GuardState]:
        """The torque to ask for when encoders read `q`, and the state to go on with.

        - `q`: (n,); NaN where no reading has come.

        The rest as of `Loop.step`.
        """
        state = self._looked_at(state, jnp.asarray(q), interval)
        wrong = state.fault != _NONE
        blind = (state.fault == _LOST) | (state.fault == _STUCK)
        begins = jnp.any(wrong) & (state.stopping < 0)
        # A joint whose reading cannot be trusted is taken to be where it should be.
        rate = self.filter.read(state.motion).rate
        origin = jnp.where(blind, reference.q, state.position)
        speed = jnp.where(blind, reference.qd, rate)
        state = state._replace(
            origin=jnp.where(begins, origin, state.origin),
            speed=jnp.where(begins, speed, state.speed),
            stopping=jnp.where(
                state.stopping < 0, jnp.where(begins, 0.0, -1.0), state.stopping + interval
            ),
        )
        wanted = self._stopping(state, reference)
        seen = jnp.where(blind, wanted.q, state.position)
        torque, loop = self.loop.step(state.loop, wanted, seen, interval)
        torque = jnp.where(state.fault == _REVERSED, -torque, torque)
        torque = jnp.clip(torque, -self.torque_limit, self.torque_limit)
        return torque, state._replace(torque=torque, loop=loop)

    def report(self, state: GuardState) -> tuple[str, ...]:
        """What was found, in words, a line a joint. Not available under `jit`."""
        fault, found = np.asarray(state.fault), np.asarray(state.found)
        return tuple(
            f"joint {joint + 1}: {FAULTS[code]}, found at {found[joint]:.3f} s"
            for joint, code in enumerate(fault)
            if code != _NONE
        )

    def _looked_at(self, state: GuardState, q: Array, interval: float | Array) -> GuardState:
        """The state with a sample's readings taken in, and what they say is wrong."""
        lost: Bool[Array, " joints"] = jnp.isnan(q)
        rate = self.filter.read(state.motion).rate
        seen = jnp.where(lost, state.position + rate * interval, q)
        motion = self.filter.step(state.motion, state.position, seen, interval)
        effort = self.filter.step(
            state.effort, state.torque, state.torque, interval, hold="constant"
        )
        # Before the first sample the drives held the arm.
        first = state.time == 0
        still = jnp.zeros_like(seen)
        held_still = self.filter.begin(self._needed(seen, still, still))
        effort = jnp.where(first, held_still, effort)

        missing = jnp.where(lost, state.missing + 1, 0)
        alike = jnp.where(~lost & (q == state.position), state.alike + 1, 0)
        needed = self._needed(*self.filter.read(motion))
        asked = self.filter.read(effort).value
        pushed = (alike >= _ALIKE) & (jnp.abs(asked - needed) > self.breakaway)
        held = jnp.where(pushed, state.held + interval, 0.0)
        # Errors as large as friction are no evidence.
        scale = self.breakaway**2
        evidence = state.evidence + (-4.0 * needed * asked / scale - 1.0) * interval / _WEIGHED
        # A reading that has just got stuck looks like a collision, at its own joint and through
        # the mass matrix at others: what the motion seems to need then proves nothing.
        odd = jnp.any(alike * interval * jnp.abs(rate) > _UNSEEN)
        evidence = jnp.where(odd | (alike > 0), state.evidence, jnp.maximum(evidence, 0.0))

        code = jnp.where(
            missing > self.allowed,
            _LOST,
            jnp.where(
                held > self.patience,
                _STUCK,
                jnp.where(evidence > 1.0, _REVERSED, _NONE),
            ),
        )
        # What one joint does wrong shakes the others, but does not take their readings away.
        later = jnp.any(state.fault != _NONE)
        new = (state.fault == _NONE) & (code != _NONE) & (~later | (code == _LOST))
        return state._replace(
            fault=jnp.where(new, code, state.fault),
            found=jnp.where(new, state.time, state.found),
            time=state.time + interval,
            position=seen,
            motion=motion,
            effort=effort,
            missing=missing,
            alike=alike,
            held=held,
            evidence=evidence,
        )

    def _needed(self, q: Array, qd: Array, qdd: Array) -> Array:
        """The torque of a motion; at rest without friction, whose sign nobody knows there."""
        rigid = self.network.torque(self.network.without_friction(self.k), q, qd, qdd)
        width = jnp.full(qd.shape, _SLOW)
        return rigid + smooth_friction(self.network, self.k, qd, width)

    def _stopping(self, state: GuardState, reference: Reference) -> Reference:
        """The reference, or the way to rest: slower at a constant rate, then still."""
        passed = jnp.clip(state.stopping, 0.0, self.stop)
        left = 1.0 - passed / self.stop
        stopped = Reference(
            state.origin + state.speed * (passed - 0.5 * passed**2 / self.stop),
            state.speed * left,
            jnp.where(left > 0, -state.speed / self.stop, 0.0),
        )
        on = state.stopping < 0
        return Reference(
            jnp.where(on, reference.q, stopped.q),
            jnp.where(on, reference.qd, stopped.qd),
            jnp.where(on, reference.qdd, stopped.qdd),
        )

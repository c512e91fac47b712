"""Wrappers that protect an arm: a barrier at the ends of joints' ranges, and fault detection.

`JointLimitAvoidance` clips accelerations that would drive a joint past its limit. `FaultMonitor`
detects lost samples, stuck encoders and reversed torques, and brings the arm to rest.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..network import CSLC
from ._computed_torque import smooth_friction
from ._controller import (
    AbstractController,
    Joints,
    PerJoint,
    Reference,
    checked_coefficients,
    per_joint,
    required_velocity,
    saturated,
)
from ._velocity_estimation import LowPassChain


class JointLimitAvoidance(AbstractController):
    """Wrapper that keeps a controller from driving joints past their limits.

    It is a control barrier function.

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
    >>> network = jc.derive(jc.examples.turntable().with_friction(), lengths="numeric")
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
        """Make a controller that respects the joints' position limits.

        **Arguments** are the attributes; one number stands for all joints.

        **Raises** `ValueError`: a wrong number of ranges, limits, rates or coefficients; a range
        that ends before it begins; a negative limit or rate.
        """
        n = network.joint_count
        self.controller, self.network = controller, network
        self.k = checked_coefficients(network, k)
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
        """Return the wrapped controller's state."""
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


FAULTS = ("none", "lost samples", "stuck encoder", "reversed torque")
"""The faults that a `FaultMonitor` detects, by code."""

_NONE, _LOST, _STUCK, _REVERSED = range(4)
# Defaults of `scripts/studies/faults/study.py`, which counts false alarms and detection times.
_FILTER = LowPassChain(30.0, lags=3)  # of readings and torques; its delay delays detection
_DETECTION_TIME = 0.02  # for which a stuck encoder is observed before it is a fault [s]
_EVIDENCE_TIME = 0.02  # time constant of the evidence of a reversed torque [s]
_VISIBLE_MOTION = 1e-3  # that a working encoder shows: some ticks of the coarsest [rad or m]
_SLOW = 0.02  # below, friction at rest may have any sign [rad/s or m/s]
_EQUAL_READINGS = 5  # after which an encoder may be stuck
_STICTION, _MODEL_ERROR = 1.6, 0.02  # of breakaway: over friction, and of the torque limit
_VERY_SLOW = 1e-6  # where friction is nearly breakaway's [rad/s or m/s]


class FaultMonitorState(NamedTuple):
    """The memory of a `FaultMonitor`; arrays of (n,) unless said otherwise.

    **Attributes**

    - `fault`: the first fault of each joint, an index of `FAULTS`.
    - `detected`: when it was detected [s since `begin`]; −1 for never.
    - `time`: since `begin` [s]; a scalar.
    - `stopping`: since the stop began [s], or −1; a scalar.
    - `stop_position`, `stop_velocity`: where the stop began [rad or m], and how fast.
    - `position`: the latest reading, or its replacement.
    - `torque`: the latest torque command.
    - `motion`, `effort`: states of the filters on readings and on torques, (lags, n).
    - `lost`: consecutive readings that were lost.
    - `equal`: consecutive readings that were equal.
    - `blocked`: for how long a joint that should have moved has not changed its reading [s].
    - `evidence`: of a reversed torque; 1 triggers the fault.
    - `controller`: state of the monitored controller.
    """

    fault: Int[Array, " joints"]
    detected: Float[Array, " joints"]
    time: Float[Array, ""]
    stopping: Float[Array, ""]
    stop_position: Float[Array, " joints"]
    stop_velocity: Float[Array, " joints"]
    position: Float[Array, " joints"]
    torque: Float[Array, " joints"]
    motion: Float[Array, "lags joints"]
    effort: Float[Array, "lags joints"]
    lost: Int[Array, " joints"]
    equal: Int[Array, " joints"]
    blocked: Float[Array, " joints"]
    evidence: Float[Array, " joints"]
    controller: Any


class FaultMonitor(AbstractController):
    """Fault detection around a controller, which names faults and brings the arm to rest.

    The model of the controller also predicts how a healthy arm responds to a torque. The torque N
    that the motion requires (the network's, on readings filtered by a `LowPassChain`) is compared
    with the torque command τ, low-pass filtered by the same chain:

    - **lost samples**: readings that are NaN. A few in a row are extrapolated with the latest
      velocity; more than `allowed` are a fault.
    - **stuck encoder**: a reading does not change while |τ − N| exceeds `breakaway`, the most that
      friction can hold, for 0.02 s. A joint that is blocked by an obstacle looks the
      same. At rest, below breakaway, a stuck encoder cannot be detected yet.
    - **reversed torque**: N and τ have opposite signs. The evidence −4 N τ / friction² (the
      difference of the squared errors of the two hypotheses on the sign, less a margin for small
      errors) is accumulated and falls back to zero otherwise: Page's CUSUM test (1954).

    The first fault ends the motion: the arm decelerates uniformly within `stop_time` and is then
    held. Joints without valid readings follow the model alone; then friction and gravity
    compensation hold them. A reversed drive gets the reversed command. A fault stays recorded.
    Afterwards only lost readings are detected, since a fault disturbs the other joints.

    One robot, (n,); `jax.vmap` over several.

    **Attributes**

    - `controller`: the monitored controller, such as an `OutputFeedback`.
    - `network`, `k`: (p,) the dynamics.
    - `breakaway`: (n,) torque at which a joint at rest certainly moves [N m or N].
    - `torque_limit`: (n,) [N m or N].
    - `stop_time`: within which the arm is brought to rest [s].
    - `allowed`: consecutive lost samples that are extrapolated.

    >>> import jax, jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import ComputedTorque, FaultMonitor, OutputFeedback, Reference
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot)
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    >>> feedback = OutputFeedback(ComputedTorque(network, k, 20.0))
    >>> monitor = FaultMonitor(feedback, network, k, torque_limit=90.0)
    >>> q = jnp.zeros(6)
    >>> state, reading = monitor.begin(q), q.at[2].set(jnp.nan)
    >>> step = jax.jit(lambda *inputs: monitor.step(*inputs))
    >>> for _ in range(7):
    ...     torque, state = step(state, Reference.at_rest(q), reading, 0.002)
    >>> monitor.report(state)
    ('joint 3: lost samples, detected at 0.010 s',)
    """

    controller: AbstractController
    network: CSLC
    k: Float[Array, " coefficients"]
    breakaway: Float[Array, " joints"]
    torque_limit: Float[Array, " joints"]
    stop_time: float
    allowed: ClassVar[int] = 5

    def __init__(
        self,
        controller: AbstractController,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        *,
        torque_limit: PerJoint,
        breakaway: PerJoint | None = None,
        stop_time: float = 0.3,
    ) -> None:
        """Make a monitored controller.

        **Arguments** are the attributes. If omitted, `breakaway` is `_STICTION` (1.6) times the
        friction of a very slow joint plus 2 % of the torque limit.

        **Raises** `ValueError`: a wrong number of values or coefficients, or a value out of range.
        """
        n = network.joint_count
        self.controller, self.network = controller, network
        self.k = checked_coefficients(network, k)
        self.torque_limit = jnp.asarray(per_joint("torque_limit", torque_limit, n, 0.0))
        if breakaway is None:
            slow = jnp.full((2, n), _VERY_SLOW) * jnp.array([[1.0], [-1.0]])
            friction = jnp.max(jnp.abs(network.friction_term(self.k, slow)), axis=0)
            breakaway = _STICTION * friction + _MODEL_ERROR * self.torque_limit
        self.breakaway = jnp.asarray(per_joint("breakaway", breakaway, n, 0.0))
        if not isinstance(self.breakaway, Tracer):
            values = np.asarray(self.breakaway)
            for joint in np.flatnonzero(~((values > 0) & np.isfinite(values))):
                raise ValueError(
                    f"breakaway of joint {joint + 1} is {values[joint]}; expected a finite torque"
                    " above 0"
                )
        if not stop_time > 0:
            raise ValueError(f"stop_time is {stop_time} s; expected more than 0")
        self.stop_time = stop_time

    def begin(self, q: Joints) -> FaultMonitorState:
        """Return the state before the first sample, without faults."""
        q = jnp.asarray(q)
        zeros, zero, count = jnp.zeros_like(q), jnp.zeros((), q.dtype), jnp.zeros(q.shape, int)
        return FaultMonitorState(
            fault=count,
            detected=zeros - 1.0,
            time=zero,
            stopping=zero - 1.0,
            stop_position=q,
            stop_velocity=zeros,
            position=q,
            torque=zeros,
            motion=_FILTER.begin(q),
            effort=_FILTER.begin(zeros),
            lost=count,
            equal=count,
            blocked=zeros,
            evidence=zeros,
            controller=self.controller.begin(q),
        )

    def step(
        self,
        state: FaultMonitorState,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Float[Array, " joints"], FaultMonitorState]:
        """Compute the torque command as `AbstractController.step` does; lost readings are NaN.

        Measured velocities, where there are any, go to the controller; detection does not use them.
        """
        state = self._detected(state, jnp.asarray(q), interval)
        faulty = state.fault != _NONE
        blind = (state.fault == _LOST) | (state.fault == _STUCK)
        begins = jnp.any(faulty) & (state.stopping < 0)
        # A joint without a valid reading is assumed to follow its reference.
        rate = _FILTER.read(state.motion).rate
        position = jnp.where(blind, reference.q, state.position)
        velocity = jnp.where(blind, reference.qd, rate)
        state = state._replace(
            stop_position=jnp.where(begins, position, state.stop_position),
            stop_velocity=jnp.where(begins, velocity, state.stop_velocity),
            stopping=jnp.where(
                state.stopping < 0, jnp.where(begins, 0.0, -1.0), state.stopping + interval
            ),
        )
        target = self._stopping_reference(state, reference)
        reading = jnp.where(blind, target.q, state.position)
        torque, inner = self.controller.step(state.controller, target, reading, interval, qd)
        torque = jnp.where(state.fault == _REVERSED, -torque, torque)
        torque = jnp.clip(torque, -self.torque_limit, self.torque_limit)
        return torque, state._replace(torque=torque, controller=inner)

    def report(self, state: FaultMonitorState) -> tuple[str, ...]:
        """Return one line per faulty joint, with its fault. Not available under `jit`."""
        fault, detected = np.asarray(state.fault), np.asarray(state.detected)
        return tuple(
            f"joint {joint + 1}: {FAULTS[code]}, detected at {detected[joint]:.3f} s"
            for joint, code in enumerate(fault)
            if code != _NONE
        )

    def _detected(
        self, state: FaultMonitorState, q: Array, interval: float | Array
    ) -> FaultMonitorState:
        """Return the state after a sample's readings, with newly detected faults."""
        missing: Bool[Array, " joints"] = jnp.isnan(q)
        rate = _FILTER.read(state.motion).rate
        reading = jnp.where(missing, state.position + rate * interval, q)
        motion = _FILTER.step(state.motion, state.position, reading, interval)
        effort = _FILTER.step(state.effort, state.torque, state.torque, interval, hold="constant")
        # Before the first sample the drives held the arm.
        first = state.time == 0
        zeros = jnp.zeros_like(reading)
        effort = jnp.where(first, _FILTER.begin(self._required(reading, zeros, zeros)), effort)

        lost = jnp.where(missing, state.lost + 1, 0)
        equal = jnp.where(~missing & (q == state.position), state.equal + 1, 0)
        required = self._required(*_FILTER.read(motion))
        command = _FILTER.read(effort).value
        pushed = (equal >= _EQUAL_READINGS) & (jnp.abs(command - required) > self.breakaway)
        blocked = jnp.where(pushed, state.blocked + interval, 0.0)
        # Errors as large as friction are no evidence.
        scale = self.breakaway**2
        increment = (-4.0 * required * command / scale - 1.0) * interval / _EVIDENCE_TIME
        evidence = state.evidence + increment
        # A reading that just got stuck looks like a collision, at its joint and through the mass
        # matrix at others: the required torque is then no evidence.
        collision = jnp.any(equal * interval * jnp.abs(rate) > _VISIBLE_MOTION)
        evidence = jnp.where(collision | (equal > 0), state.evidence, jnp.maximum(evidence, 0.0))

        code = jnp.where(
            lost > self.allowed,
            _LOST,
            jnp.where(
                blocked > _DETECTION_TIME,
                _STUCK,
                jnp.where(evidence > 1.0, _REVERSED, _NONE),
            ),
        )
        # A fault disturbs the other joints, but does not take their readings away.
        later = jnp.any(state.fault != _NONE)
        new = (state.fault == _NONE) & (code != _NONE) & (~later | (code == _LOST))
        return state._replace(
            fault=jnp.where(new, code, state.fault),
            detected=jnp.where(new, state.time, state.detected),
            time=state.time + interval,
            position=reading,
            motion=motion,
            effort=effort,
            lost=lost,
            equal=equal,
            blocked=blocked,
            evidence=evidence,
        )

    def _required(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the torque of a motion; without friction at rest, where its sign is unknown."""
        rigid = self.network.torque(self.network.without_friction(self.k), q, qd, qdd)
        width = jnp.full(qd.shape, _SLOW)
        return rigid + smooth_friction(self.network, self.k, qd, width)

    def _stopping_reference(self, state: FaultMonitorState, reference: Reference) -> Reference:
        """Return the reference, or, after a fault, a uniform deceleration to rest."""
        elapsed = jnp.clip(state.stopping, 0.0, self.stop_time)
        remaining = 1.0 - elapsed / self.stop_time
        stopped = Reference(
            state.stop_position
            + state.stop_velocity * (elapsed - 0.5 * elapsed**2 / self.stop_time),
            state.stop_velocity * remaining,
            jnp.where(remaining > 0, -state.stop_velocity / self.stop_time, 0.0),
        )
        normal = state.stopping < 0
        return Reference(*(jnp.where(normal, *x) for x in zip(reference, stopped, strict=True)))

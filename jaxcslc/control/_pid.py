import math
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ._controller import AbstractController, Joints, Reference, namespace
from ._gains_and_limits import PerJoint, aligned, conditional_integration, per_joint, saturated
from ._gravity import AbstractPositionTorque


class PIDState(NamedTuple):
    """The memory of a `PID` controller.

    **Attributes**

    - `error`: position error at the previous sample, (*batch, n) [rad or m].
    - `rate`: filtered rate of the error, (*batch, n) [rad/s or m/s].
    - `integral`: integral of the error, (*batch, n) [rad s or m s].
    - `samples`: how many samples there have been, (*batch, 1).
    """

    error: Joints
    rate: Joints
    integral: Joints
    samples: Int[Array | np.ndarray, "*batch 1"]


class PID(AbstractController):
    """Independent PID control of each joint, with or without gravity compensation.

        torque = K_p e + K_i ∫ e dt + K_d ė [+ G(q)]        e = q_d − q

    Gains are torques: the controller has no model of the arm's inertia. Where velocities are
    measured or estimated, ė is qd_d − qd. Without them ė is the difference of two errors over the
    sampling interval, smoothed by a first-order low pass: without it, one encoder count at 2 ms
    would be worth 4 N m at joint 2 of the thesis's PUMA 560. With that and `sim.AbbreviatedGravity`
    this is the controller of the comparison trajectory (7.4.2), and with an integral gain of zero
    the PD controller of 7.2.3. Anti-windup is `conditional_integration`. The state is a `PIDState`.

    **Attributes**

    - `position_gain`, `integral_gain`, `velocity_gain`: (n,); see `__init__`.
    - `torque_limit`: (n,) [N m or N], or None where no joint has a limit.
    - `gravity`: the gravity compensation, or None.
    - `cutoff`: of the low pass [Hz].
    - `integration`: `"forward"` or `"backward"`.

    >>> import numpy as np
    >>> from jaxcslc.control import PID, Reference
    >>> pid = PID(2, position_gain=100.0, velocity_gain=10.0, torque_limit=[5.0, 50.0])
    >>> q, qd = np.zeros(2), np.zeros(2)
    >>> torque, state = pid.step(pid.begin(q), Reference.at_rest(np.full(2, 0.1)), q, 0.002, qd)
    >>> torque.tolist()
    [5.0, 10.0]
    """

    position_gain: Float[Array | np.ndarray, " joints"]
    integral_gain: Float[Array | np.ndarray, " joints"]
    velocity_gain: Float[Array | np.ndarray, " joints"]
    torque_limit: Float[Array | np.ndarray, " joints"] | None
    gravity: AbstractPositionTorque | None
    cutoff: float
    integration: str = eqx.field(static=True)

    def __init__(
        self,
        joints: int,
        *,
        position_gain: PerJoint,
        velocity_gain: PerJoint,
        integral_gain: PerJoint = 0.0,
        torque_limit: PerJoint = math.inf,
        gravity: AbstractPositionTorque | None = None,
        cutoff: float = 20.0,
        integration: str = "forward",
    ) -> None:
        """A controller of `joints` joints; gains and limits are one number, or one for each joint.

        **Arguments**

        - `position_gain`: K_p [N m/rad or N/m].
        - `velocity_gain`: K_d [N m s/rad or N s/m].
        - `integral_gain`: K_i [N m/(rad s) or N/(m s)].
        - `torque_limit`: of the drives [N m or N].
        - `gravity`: the gravity compensation; none if omitted.
        - `cutoff`: of the low pass on ė where no velocities are passed [Hz].
        - `integration`: Euler's rule for the integral. `"forward"` takes the errors up to the
          previous sample, `"backward"` those after the first sample and including this one.

        **Raises**

        - `ValueError`: a wrong number of gains, a negative one, or an unknown rule; names it and
          the joint.
        """
        self.position_gain = per_joint("position_gain", position_gain, joints, 0.0)
        self.integral_gain = per_joint("integral_gain", integral_gain, joints, 0.0)
        self.velocity_gain = per_joint("velocity_gain", velocity_gain, joints, 0.0)
        unlimited = isinstance(torque_limit, float) and math.isinf(torque_limit)
        limit = None if unlimited else per_joint("torque_limit", torque_limit, joints, 0.0)
        self.torque_limit = limit
        if not cutoff > 0:
            raise ValueError(f"cutoff is {cutoff}; expected more than 0 Hz")
        if integration not in ("forward", "backward"):
            raise ValueError(f"integration is {integration!r}; expected 'forward' or 'backward'")
        self.gravity, self.cutoff, self.integration = gravity, cutoff, integration

    @property
    def array_generic(self) -> bool:
        """Unless the gravity compensation needs JAX."""
        return self.gravity is None or self.gravity.array_generic

    def begin(self, q: Joints) -> PIDState:
        """At rest, without error."""
        xp = namespace(q)
        zero = xp.zeros_like(q)
        return PIDState(zero, zero, zero, xp.zeros((*zero.shape[:-1], 1), int))

    def step(
        self,
        state: PIDState,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, PIDState]:
        """As `AbstractController.step`."""
        error = reference.q - q
        xp = namespace(error, state.integral)
        interval = xp.asarray(interval, dtype=error.dtype)
        # No time has passed before the first sample.
        elapsed = xp.where(state.samples > 0, interval, xp.zeros_like(interval))
        if qd is None:
            weight = -xp.expm1(-2 * np.pi * self.cutoff * elapsed)
            rate = state.rate + weight * ((error - state.error) / interval - state.rate)
        else:
            rate = reference.qd - qd
        if self.integration == "forward":
            before, increment = state.integral, error * interval
            integral = before
        else:
            before, increment = state.integral, error * elapsed
            integral = before + increment
        torque = (
            aligned(self.position_gain, error) * error
            + aligned(self.integral_gain, error) * integral
            + aligned(self.velocity_gain, error) * rate
        )
        if self.gravity is not None:
            torque = torque + self.gravity.torque(q)
        if self.torque_limit is None:
            integral = before + increment
        else:
            integral = conditional_integration(before, increment, torque, self.torque_limit)
            torque = saturated(torque, self.torque_limit)
        return torque, PIDState(error, rate, integral, state.samples + 1)

"""PID control and gravity compensation (thesis 7.4)."""

import abc
import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..network import CSLC
from ._controller import (
    AbstractController,
    Joints,
    PerJoint,
    Reference,
    aligned,
    conditional_integration,
    namespace,
    per_joint,
    saturated,
)


# Gravity's columns are compared at this many random poses: a column that vanishes at all of them
# vanishes everywhere.
_POSES = 7
_ZERO = 1e-12


class AbstractPositionTorque(abc.ABC):
    """A torque that depends on joint positions alone, such as gravity or a repulsive potential.

    **Attributes**

    - `array_generic`: whether `torque` computes NumPy results from NumPy arrays; see
      `AbstractController.array_generic`.
    """

    array_generic: ClassVar[bool] = False

    @abc.abstractmethod
    def torque(self, q: Joints) -> Joints:
        """Return the torque, (*batch, n) [N m or N], at positions `q`, (*batch, n) [rad or m].

        NumPy or JAX arrays.
        """


class Gravity(eqx.Module, AbstractPositionTorque):
    """Gravity compensation with a network's gravity term G(q) (Eqn. 2.4-7).

    **Attributes**

    - `network`, `k`: (p,) the dynamics.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import Gravity
    >>> network = jc.derive(jc.puma560())
    >>> gravity = Gravity(network, network.coefficients_from(jc.puma560().links))
    >>> gravity.torque(jnp.zeros(6)).shape
    (6,)
    """

    network: CSLC
    k: Float[Array, " coefficients"]

    @classmethod
    def of_joints(
        cls,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        joints: Sequence[int],
    ) -> "Gravity":
        """Make the compensation of some joints, by the coefficients that act on no other joint.

        For joints 2 and 3 of the PUMA 560 these are all but k₂ᴳ, that of the wrist: the
        abbreviated gravity compensation of the thesis's PID controller (7.4), which the thesis
        does not print. `sim.AbbreviatedGravity` computes the same from link parameters.

        **Arguments**

        - `network`, `k`: (p,) the dynamics.
        - `joints`: counted from 1.

        **Raises**

        - `ValueError`: there is no such joint.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> from jaxcslc.control import Gravity
        >>> network = jc.derive(jc.puma560())
        >>> gravity = Gravity.of_joints(network, jnp.ones(43), joints=(2, 3))
        >>> [name for name, value in zip(network.names, gravity.k) if value]
        ['kG1', 'kG3', 'kG4', 'kG5']
        """
        n = network.joint_count
        for joint in joints:
            if not 1 <= joint <= n:
                raise ValueError(f"joints: there is no joint {joint}; expected 1 to {n}")
        poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, n))
        with jax.ensure_compile_time_eval():  # also where `k` is traced
            columns = np.asarray(
                jax.jacobian(lambda k: network.gravity_term(k, poses))(jnp.zeros(network.size))
            )
        acts = np.max(np.abs(columns), axis=0) > _ZERO  # (n, p)
        others = np.delete(acts, [joint - 1 for joint in joints], axis=0)
        mask = acts.any(axis=0) & ~others.any(axis=0)
        k = jnp.asarray(k)
        return cls(network, jnp.where(jnp.asarray(mask), k, jnp.zeros_like(k)))

    def torque(self, q: Joints) -> Joints:
        """G(q), the torque that holds the arm still."""
        return self.network.gravity_term(self.k, q)


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
        """Make a controller of `joints` joints; gains and limits are one number, or one per joint.

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
        """True unless the gravity compensation needs JAX."""
        return self.gravity is None or self.gravity.array_generic

    def begin(self, q: Joints) -> PIDState:
        """Return the state at rest, without error."""
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
        """Compute the torque command, as `AbstractController.step` describes."""
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
        forward = self.integration == "forward"
        increment = error * (interval if forward else elapsed)
        integral = state.integral if forward else state.integral + increment
        torque = (
            aligned(self.position_gain, error) * error
            + aligned(self.integral_gain, error) * integral
            + aligned(self.velocity_gain, error) * rate
        )
        if self.gravity is not None:
            torque = torque + self.gravity.torque(q)
        if self.torque_limit is None:
            integral = state.integral + increment
        else:
            limit = self.torque_limit
            integral = conditional_integration(state.integral, increment, torque, limit)
            torque = saturated(torque, limit)
        return torque, PIDState(error, rate, integral, state.samples + 1)

"""Base class of controllers, the reference, PID control and gravity compensation (thesis 7.4)."""

import abc
import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .._environment import array_namespace
from ..network import CSLC


Joints = Float[Array | np.ndarray, "*batch joints"]


class Reference(NamedTuple):
    """The desired motion at one instant: q_d, its velocity and its acceleration (2.7.1).

    **Attributes**

    - `q`: desired positions, (*batch, n) [rad or m].
    - `qd`: desired velocities, (*batch, n) [rad/s or m/s].
    - `qdd`: desired accelerations, (*batch, n) [rad/s² or m/s²].

    >>> import numpy as np
    >>> from jaxcslc.control import Reference
    >>> Reference.at_rest(np.zeros(2)).qdd
    array([0., 0.])
    """

    q: Joints
    qd: Joints
    qdd: Joints

    @classmethod
    def at_rest(cls, q: Joints) -> "Reference":
        """Make the reference of an arm that is to stand still at `q`, (*batch, n) [rad or m]."""
        return cls(q, 0 * q, 0 * q)


class AbstractController(eqx.Module):
    """A discrete-time controller: once a sample, from reference and measurement to torque.

    Every controller, from a single PID law to a monitored adaptive one, has these two methods, so
    that controllers can wrap each other and the simulator runs all of them alike.

    A controller is an immutable pytree: gains and coefficients are leaves, and `jax.vmap` over a
    stack of controllers runs several robots side by side. Its memory is a state, a pytree of
    arrays of constant shapes, that each step takes and returns. Methods are pure and take any
    leading batch axes, NumPy or JAX arrays: a step works in a loop around hardware or C MuJoCo, in
    `jax.lax.scan`, and under MJX.

    To add a controller, subclass this and implement `begin` and `step`.
    """

    @property
    def array_generic(self) -> bool:
        """True if `step` computes NumPy results from NumPy arrays.

        A simulator calls such a controller as it is. Any other one it compiles first.
        """
        return False

    @abc.abstractmethod
    def begin(self, q: Joints) -> Any:
        """Return the state before the first sample, with the joints at rest.

        **Arguments**

        - `q`: measured positions, (*batch, n) [rad or m].

        **Returns** the state, a pytree of arrays.
        """

    @abc.abstractmethod
    def step(
        self,
        state: Any,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, Any]:
        """Compute the torque command until the next sample.

        **Arguments**

        - `state`: as `begin` or the previous step returned it.
        - `reference`: the desired motion at this sample.
        - `q`: measured positions, (*batch, n) [rad or m].
        - `interval`: time since the previous sample, one number [s].
        - `qd`: measured or estimated velocities, (*batch, n) [rad/s or m/s]; None for an arm
          without tachometers. `OutputFeedback` estimates them for a controller that needs them.

        **Returns** the torque, (*batch, n) [N m or N], and the state for the next step.

        **Raises** `ValueError`: the controller needs velocities and got none.
        """


def required_velocity(controller: AbstractController, qd: Joints | None) -> Joints:
    """Return velocities that a controller needs. **Raises** `ValueError` without them."""
    if qd is None:
        name = type(controller).__name__
        raise ValueError(f"{name}: no velocities; pass qd, or wrap it in OutputFeedback")
    return qd


def checked_coefficients(
    network: CSLC, k: Float[Array | np.ndarray, " coefficients"]
) -> Float[Array, " coefficients"]:
    """Return coefficients as JAX's array. **Raises** `ValueError` for another network's."""
    k = jnp.asarray(k)
    if k.shape != (network.size,):
        raise ValueError(f"k: expected shape ({network.size},), got {k.shape}")
    return k


PerJoint = float | Sequence[float] | Float[Array | np.ndarray, " joints"]


def error_gains(
    natural_frequency: PerJoint, damping: PerJoint
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return gains that make each joint's error a linear oscillator: K_p = ω_n², K_v = 2 ζ ω_n.

    The two formulas after Eqn. 2.7-1 (numbered 2.6-2 in print), from Leahy and Saridis (1989): a
    perfectly compensated arm then has e'' + K_v e' + K_p e = 0 at every joint.

    **Arguments**

    - `natural_frequency`: ω_n [rad/s].
    - `damping`: ζ, 1 for the fastest decay without overshoot.

    **Returns** K_p [1/s²] and K_v [1/s].

    >>> from jaxcslc.control import error_gains
    >>> [float(gain) for gain in error_gains(20.0, 1.0)]
    [400.0, 40.0]
    """
    frequency, ratio = jnp.asarray(natural_frequency, float), jnp.asarray(damping, float)
    return frequency**2, 2.0 * ratio * frequency


def per_joint(
    name: str, values: PerJoint, joints: int, least: float
) -> Float[Array | np.ndarray, " joints"]:
    """Return one value per joint, from one for all or a sequence.

    JAX arrays stay JAX's; everything else becomes a float64 NumPy array. **Raises** `ValueError`
    for a wrong number of values, or one below `least`; traced values are not checked.
    """
    xp = jnp if isinstance(values, jax.Array) else np
    numbers = xp.asarray(values, float)
    if numbers.ndim > 1 or numbers.shape not in ((), (joints,)):
        raise ValueError(f"{name}: expected one number or {joints}, got shape {numbers.shape}")
    numbers = xp.broadcast_to(numbers, (joints,))
    if isinstance(numbers, Tracer):
        return numbers
    wrong = np.flatnonzero(~(np.asarray(numbers) >= least))
    if wrong.size:
        value = float(np.asarray(numbers)[wrong[0]])
        raise ValueError(f"{name} of joint {wrong[0] + 1} is {value}; expected {least:g} or more")
    return numbers if isinstance(numbers, jax.Array) else numbers.copy()


def aligned(
    values: Float[Array | np.ndarray, " joints"], like: Joints
) -> Float[Array | np.ndarray, "..."]:
    """Return values per joint with the type and number of axes of another array, (*batch, n).

    JAX can be configured to refuse promotion of ranks and types. NumPy's values stay as they are.
    """
    of_numpy = isinstance(like, np.ndarray) and isinstance(values, np.ndarray)
    if of_numpy and like.dtype == values.dtype:
        return values
    shape = (1,) * (like.ndim - 1) + values.shape
    return array_namespace(like, values).asarray(values.reshape(shape), dtype=like.dtype)


def saturated(torque: Joints, limit: Float[Array | np.ndarray, " joints"]) -> Joints:
    """Return torque commands, (*batch, n), clipped at the drives' limits, (n,) [N m or N]."""
    limit = aligned(limit, torque)
    return array_namespace(torque, limit).clip(torque, -limit, limit)


def conditional_integration(
    integral: Joints,
    increment: Joints,
    torque: Joints,
    limit: Float[Array | np.ndarray, " joints"],
) -> Joints:
    """Advance an integral by one sample, with anti-windup.

    While the torque command of a joint exceeds its limit, increments that would push it further
    into saturation are left out: otherwise overshoot has to undo them (Åström and Hägglund 1995,
    3.5).

    **Arguments**

    - `integral`, `increment`: of the error, (*batch, n).
    - `torque`: the command before it is clipped, (*batch, n) [N m or N].
    - `limit`: (n,) [N m or N].

    **Returns** the new integral, (*batch, n).

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import conditional_integration
    >>> increment, torque = jnp.array([0.1, 0.1, -0.1]), jnp.array([5.0, 20.0, 20.0])
    >>> conditional_integration(jnp.zeros(3), increment, torque, jnp.full(3, 9.0)).tolist()
    [0.1, 0.0, -0.1]
    """
    limit = aligned(limit, torque)
    xp = array_namespace(integral, increment, torque, limit)
    outward = (xp.abs(torque) > limit) & (torque * increment > 0)
    return xp.where(outward, integral, integral + increment)


# Gravity's columns are compared at this many random poses: a column that vanishes at all of them
# vanishes everywhere. Below the latter it is rounding, in the units of a coefficient's factor.
_POSES, _ZERO = 7, 1e-12


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

        **Raises** `ValueError`: there is no such joint.

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

        **Raises** `ValueError`: a wrong number of gains, a negative one, or an unknown rule; names
        it and the joint.
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
        xp = array_namespace(q)
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
        xp = array_namespace(error, state.integral)
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

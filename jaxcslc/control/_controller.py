"""Base class of controllers, the reference, and parts they share: gains, saturation."""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

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

        **Raises**

        - `ValueError`: the controller needs velocities and got none.
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


def namespace(*arrays: Any) -> Any:
    """Return `jax.numpy` if any of the arrays is JAX's, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np


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
    xp = namespace(values)
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
    return namespace(like, values).asarray(values.reshape(shape), dtype=like.dtype)


def saturated(torque: Joints, limit: Float[Array | np.ndarray, " joints"]) -> Joints:
    """Return torque commands, (*batch, n), clipped at the drives' limits, (n,) [N m or N]."""
    limit = aligned(limit, torque)
    return namespace(torque, limit).clip(torque, -limit, limit)


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
    xp = namespace(integral, increment, torque, limit)
    outward = (xp.abs(torque) > limit) & (torque * increment > 0)
    return xp.where(outward, integral, integral + increment)

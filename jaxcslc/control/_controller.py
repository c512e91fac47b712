import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


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
        """The reference of an arm that is to stand still at `q`, (*batch, n) [rad or m]."""
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
        """Whether `step` computes NumPy results from NumPy arrays.

        A simulator calls such a controller as it is. Any other one it compiles first.
        """
        return False

    @abc.abstractmethod
    def begin(self, q: Joints) -> Any:
        """The state before the first sample, with the joints at rest.

        **Arguments**

        - `q`: measured positions, (*batch, n) [rad or m].

        **Returns**

        The state, a pytree of arrays.
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
        """The torque command until the next sample.

        **Arguments**

        - `state`: as `begin` or the previous step returned it.
        - `reference`: the desired motion at this sample.
        - `q`: measured positions, (*batch, n) [rad or m].
        - `interval`: time since the previous sample, one number [s].
        - `qd`: measured or estimated velocities, (*batch, n) [rad/s or m/s]; None for an arm
          without tachometers. `OutputFeedback` estimates them for a controller that needs them.

        **Returns**

        The torque, (*batch, n) [N m or N], and the state for the next step.

        **Raises**

        - `ValueError`: the controller needs velocities and got none.
        """


def required_velocity(controller: AbstractController, qd: Joints | None) -> Joints:
    """Velocities that a controller cannot do without.

    **Raises**

    - `ValueError`: there are none.
    """
    if qd is None:
        name = type(controller).__name__
        raise ValueError(f"{name}: no velocities; pass qd, or wrap it in OutputFeedback")
    return qd


def namespace(*arrays: Any) -> Any:
    """`jax.numpy` if any of the arrays is JAX's, else `numpy`."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np

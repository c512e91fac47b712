import abc
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from ._reference import Joints, Reference


class AbstractController(eqx.Module):
    """What asks torque of the drives, once a sample, from where the arm is and where it should be.

    A controller is an immutable pytree: its gains and coefficients are leaves, so that `jax.vmap`
    over a stack of controllers runs as many loops side by side. What it remembers is a state that
    it hands out and is handed back, arrays whose shapes stay the same. Every method is pure and
    takes any leading batch axes, NumPy's arrays or JAX's; a step can stand in a loop around C
    MuJoCo, in a `jax.lax.scan`, and under MJX.
    """

    @abc.abstractmethod
    def begin(self, q: Joints) -> Any:
        """The state before the first sample, the joints at rest at `q` (*batch, n) [rad or m]."""

    @abc.abstractmethod
    def step(
        self, state: Any, reference: Reference, q: Joints, qd: Joints, interval: float | Array
    ) -> tuple[Float[Array, "*batch joints"], Any]:
        """The torque to ask for until the next sample, and the state to go on with.

        **Arguments**

        - `state`: as the step before left it.
        - `reference`: where the joints should be now.
        - `q`, `qd`: where they are and how fast they move, (*batch, n) [rad and rad/s, or m].
        - `interval`: since the step before [s]; one number.

        **Returns** torque (*batch, n) [N m or N] within the controller's limits, and the state.
        """

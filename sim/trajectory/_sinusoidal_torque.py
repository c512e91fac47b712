"""Open-loop excitation by sinusoidal torques, as of the thesis's training trajectory."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from jaxcslc.control import AbstractController, AbstractPositionTorque, Reference
from sim.trajectory._arrays import namespace, spread


Joints = Float[Array | np.ndarray, "*batch joints"]


class SinusoidalTorque(AbstractController):
    """Open-loop excitation: a sinusoidal torque at each joint, with gravity compensated (7.4.1).

    The controller of the thesis's training trajectory. There is no feedback: the machine decides
    on the motion, which is roughly sinusoidal where the inertia of each joint outweighs the
    coupling. The reference is ignored. Samples are equally spaced. The state counts them,
    (*batch, 1).

    **Attributes**

    - `amplitude`: (n,) [N m or N].
    - `period`: (n,) [s].
    - `phase`: (n,) [rad]. At 3π/2 a joint that starts at rest swings to one side and back.
    - `gravity`: gravity compensation, or None.
    - `repulsion`: torques that keep the arm away from obstacles, such as `Repulsion`.

    >>> import numpy as np
    >>> import sim
    >>> from jaxcslc.control import Reference
    >>> controller = sim.SinusoidalTorque(np.array([2.0]), np.array([0.8]), np.array([1.5 * np.pi]))
    >>> q = np.zeros(1)
    >>> torque, state = controller.step(controller.begin(q), Reference.at_rest(q), q, 0.002)
    >>> torque.tolist(), state.tolist()
    ([-2.0], [1])
    """

    amplitude: Float[Array | np.ndarray, " joints"]
    period: Float[Array | np.ndarray, " joints"]
    phase: Float[Array | np.ndarray, " joints"]
    gravity: AbstractPositionTorque | None = None
    repulsion: tuple[AbstractPositionTorque, ...] = ()

    @property
    def array_generic(self) -> bool:
        """True unless gravity compensation or repulsion need JAX."""
        parts = self.repulsion if self.gravity is None else (self.gravity, *self.repulsion)
        return all(part.array_generic for part in parts)

    def begin(self, q: Joints) -> Int[Array | np.ndarray, "*batch 1"]:
        """Return zero samples."""
        xp = namespace(q)
        return xp.zeros((*q.shape[:-1], 1), int)

    def step(
        self,
        state: Int[Array | np.ndarray, "*batch 1"],
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, Any]:
        """Compute the torque command, as `AbstractController.step` describes."""
        del reference, qd  # open loop
        xp = namespace(q)
        time = state.astype(q.dtype) * xp.asarray(interval, dtype=q.dtype)
        angle = 2 * np.pi * time / spread(self.period, q)
        torque = spread(self.amplitude, q) * xp.sin(angle + spread(self.phase, q))
        if self.gravity is not None:
            torque = torque + self.gravity.torque(q)
        for repulsion in self.repulsion:
            torque = torque + repulsion.torque(q)
        return torque, state + 1

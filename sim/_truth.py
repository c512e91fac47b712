from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxcslc.motion import Recording


class Truth(eqx.Module):
    """What no real machine tells: its state at each sample of a recording, just after it.

    At each sample the rigid links' equation holds with what is written here (Eqns. 2.5-2, 2.5-6),

    `M(position) acceleration + V(position, velocity) + G(position) + friction = torque`.

    ```python
    >>> import sim
    >>> _, truth = sim.simulate(sim.puma560(), sim.training(samples=5))
    >>> truth.velocity[0]
    array([0., 0., 0., 0., 0., 0.])

    ```
    """

    time: Float[np.ndarray, " samples"]
    """[s]."""

    position: Float[np.ndarray, "samples joints"]
    """Before the encoders [rad or m]."""

    velocity: Float[np.ndarray, "samples joints"]
    """[rad/s or m/s]."""

    acceleration: Float[np.ndarray, "samples joints"]
    """The one that begins with the torque of this row: it jumps at each sample, as the torque
    does [rad/s² or m/s²]."""

    torque: Float[np.ndarray, "samples joints"]
    """What the drives give from this sample to the next [N m or N]."""

    friction: Float[np.ndarray, "samples joints"]
    """What friction takes of it [N m or N]: Eqn. 2.5-4 where the joint slides; whatever keeps it
    still where it sticks; within one step of the integrator before it stops or turns, whatever
    stops it."""


class SimulatedRecording(NamedTuple):
    """A recording as the machine's computer would have made it, and the truth beside it."""

    recording: Recording
    """Encoder readings, and the torques demanded upon them."""

    truth: Truth

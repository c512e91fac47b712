from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxcslc.recordings import Recording


class Truth(eqx.Module):
    """True state of the machine at each sample of a recording, just after it.

    At each sample these values satisfy the links' equation (Eqn. 2.5-2 without the motors) and
    that of the rotors:

    `M'(position) acceleration + V(position, velocity) + G(position) + link_friction = transmitted`

    `motor_inertia * rotor_acceleration + friction - link_friction + transmitted = torque`

    Without a flexible transmission, rotors move as links do, and the sum of the two is

    `M(position) acceleration + V(position, velocity) + G(position) + friction = torque`.

    >>> import sim
    >>> _, truth = sim.simulate(sim.puma560(), sim.training(samples=5))
    >>> truth.velocity[0]
    array([0., 0., 0., 0., 0., 0.])
    """

    time: Float[np.ndarray, " samples"]
    """[s]."""

    position: Float[np.ndarray, "samples joints"]
    """Of the links [rad or m]."""

    velocity: Float[np.ndarray, "samples joints"]
    """Of the links [rad/s or m/s]."""

    acceleration: Float[np.ndarray, "samples joints"]
    """Of the links: the one that begins with the torque of this row. Where rotor and link are one
    body it jumps at each sample, as the torque does [rad/s² or m/s²]."""

    torque: Float[np.ndarray, "samples joints"]
    """Torque of the drives just after this sample [N m or N]."""

    friction: Float[np.ndarray, "samples joints"]
    """Friction torque [N m or N]: Eqn. 2.5-4 where the joint slides; the torque that balances the
    others where it sticks; within one step of the integrator before it stops or reverses, the
    torque that stops it."""

    rotor_position: Float[np.ndarray, "samples joints"]
    """Before the encoders, at the joint [rad or m]."""

    rotor_velocity: Float[np.ndarray, "samples joints"]
    """At the joint [rad/s or m/s]."""

    rotor_acceleration: Float[np.ndarray, "samples joints"]
    """At the joint [rad/s² or m/s²]."""

    link_friction: Float[np.ndarray, "samples joints"]
    """The part of `friction` that acts on the link [N m or N]."""

    transmitted: Float[np.ndarray, "samples joints"]
    """Torque through the gears from rotor to link [N m or N]."""

    apart: Bool[np.ndarray, "samples joints"]
    """Whether the gears are apart: whether the joint is experiencing backlash (2.5.3)."""

    carried: Float[np.ndarray, " samples"]
    """Mass of the loads that the last link carries (`Trajectory.loads`) [kg]."""

    lost: Bool[np.ndarray, "samples joints"]
    """Whether the controller got NaN instead of a reading (`Trajectory.faults`)."""


class SimulatedRecording(NamedTuple):
    """A recording as the machine's computer would make it, and the true state."""

    recording: Recording
    """Encoder readings, and the torques demanded in response."""

    truth: Truth

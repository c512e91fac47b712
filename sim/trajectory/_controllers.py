import abc
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import Manipulator

from ..machine import MachineError
from ._arrays import Array, clock, namespace, spread
from ._paths import AbstractPath
from ._repulsion import AbstractRepulsion


class AbstractController(abc.ABC):
    """What demands torque of the drives, once a sample, knowing the encoders and the clock.

    A controller is immutable; what it remembers is a state that it hands out and is handed back:
    a pytree of arrays whose shapes stay the same. Every method takes any leading batch axes, and
    arrays of NumPy or of JAX, tracers included, so that a loop over the samples can be a
    `jax.lax.scan`.
    """

    @abc.abstractmethod
    def begin(self, position: Float[Array, "*batch joints"]) -> Any:
        """The state before the first sample, the joints at rest at `position` [rad or m]."""

    @abc.abstractmethod
    def demand(
        self, state: Any, time: float | Array, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch joints"], Any]:
        """The torque demanded at `time` [s] when the encoders read `position` [rad or m], held
        until the next sample [N m or N], and the state to go on with. The time is one number, or
        one a row, (*batch, 1)."""


@dataclass(frozen=True, eq=False)
class AbbreviatedGravity:
    """The PUMA 560's gravity compensation of 7.4: joints 2 and 3 without the wrist's terms.

    τ₂ = A c₂ + B s₂ + C c₂₃ + D s₂₃ and τ₃ = C c₂₃ + D s₂₃: the gravity term of Appendix B.3
    without k₂ᴳ, the one coefficient that makes it depend on the wrist; zero for the other joints.
    The thesis does not print it: this reading of "abbreviated" is a reconstruction.

    ```python
    >>> import numpy as np
    >>> import jaxcslc
    >>> import sim
    >>> gravity = sim.AbbreviatedGravity.of(jaxcslc.puma560())
    >>> gravity.torque(np.zeros(6)).round(2)
    array([  0.  , -36.99,   0.25,   0.  ,   0.  ,   0.  ])

    ```
    """

    upper_arm: tuple[float, float]
    """A and B: factors of c₂ and s₂ [N m]."""

    forearm: tuple[float, float]
    """C and D: factors of c₂₃ and s₂₃ [N m]."""

    @classmethod
    def of(cls, robot: Manipulator) -> "AbbreviatedGravity":
        """The compensation for a PUMA's links; the wrist's masses count at the wrist's centre.

        **Raises**

        - `MachineError`: the robot is no PUMA, or has no link parameters.
        """
        links = robot.links
        twists = [round(float(np.degrees(joint.alpha)), 6) for joint in robot.joints]
        upright = robot.gravity[0] == 0 == robot.gravity[1]
        if links is None or robot.kinds != "RRRRRR" or twists != [0, -90, 0, 90, -90, 90]:
            raise MachineError(
                f"robot {robot.name!r}: this gravity compensation is the PUMA 560's; expected six"
                " revolute joints with twists 0, -90, 0, 90, -90, 90 degrees and link parameters"
            )
        if not upright:
            raise MachineError(
                f"robot {robot.name!r}: gravity is {robot.gravity}; expected it along the z axis"
            )
        length = robot.length_values()
        a2, a3, d4 = length["a2"], length["a3"], length["d4"]
        mass = [float(link.mass) for link in links]
        x2, y2, _ = (float(value) for value in links[1].centre_of_gravity)
        x3, y3, _ = (float(value) for value in links[2].centre_of_gravity)
        z4 = float(links[3].centre_of_gravity[2])
        g = robot.gravity[2]
        wrist = mass[4] + mass[5]
        return cls(
            upper_arm=(
                g * (mass[1] * x2 + (mass[2] + mass[3] + wrist) * a2),
                -g * mass[1] * y2,
            ),
            forearm=(
                g * (mass[2] * x3 + (mass[3] + wrist) * a3),
                -g * (mass[2] * y3 - mass[3] * (d4 + z4) - wrist * d4),
            ),
        )

    def torque(self, position: Float[Array, "*batch joints"]) -> Float[Array, "*batch joints"]:
        """The compensation at joint positions [rad], [N m]."""
        xp = namespace(position)
        q2, q23 = position[..., 1], position[..., 1] + position[..., 2]
        forearm = self.forearm[0] * xp.cos(q23) + self.forearm[1] * xp.sin(q23)
        upper_arm = self.upper_arm[0] * xp.cos(q2) + self.upper_arm[1] * xp.sin(q2) + forearm
        none = xp.zeros_like(q2)
        return xp.stack([none, upper_arm, forearm, none, none, none], axis=-1)


@dataclass(frozen=True, eq=False)
class SinusoidalTorque(AbstractController):
    """The training trajectory's controller (7.4.1): a sinusoid a joint, gravity compensated.

    Nothing pulls the joints back to a path. What motion results is up to the machine; it is
    roughly sinusoidal as long as each joint's own inertia outweighs the rest.
    """

    amplitude: Float[np.ndarray, " joints"]
    """[N m or N]."""

    period: Float[np.ndarray, " joints"]
    """[s]."""

    phase: Float[np.ndarray, " joints"]
    """[rad]. At 3π/2, a joint that starts at rest swings to one side of its start and back."""

    gravity: AbbreviatedGravity | None = None
    repulsion: tuple[AbstractRepulsion, ...] = ()

    def begin(self, position: Float[Array, "*batch joints"]) -> Any:
        """Nothing: this controller has no memory."""
        del position
        return ()

    def demand(
        self, state: Any, time: float | Array, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch joints"], Any]:
        """As the abstract method."""
        angle = 2 * np.pi * clock(time, position) / spread(self.period, position)
        wave = namespace(position).sin(angle + spread(self.phase, position))
        torque = spread(self.amplitude, position) * wave
        if self.gravity is not None:
            torque = torque + self.gravity.torque(position)
        for repulsion in self.repulsion:
            torque = torque + repulsion.torque(position)
        return torque, state


class PIDState(NamedTuple):
    """What a PID controller remembers; arrays of shape (*batch, joints), and the time's."""

    origin: Array
    """Where the path begins [rad or m]."""
    error: Array
    """Position error at the sample before [rad or m]."""
    rate: Array
    """Filtered rate of the error [rad/s or m/s]."""
    integral: Array
    """Integral of the error [rad s or m s]."""
    time: Array
    """Of the sample before [s]; shape (*batch, 1)."""


@dataclass(frozen=True, eq=False)
class PID(AbstractController):
    """The comparison trajectory's controller (7.4.2): PID along a path, gravity compensated.

    With an integral gain of zero it is the PD controller of 7.2.3. The machine has no tachometers,
    so the rate of the error is the difference of two readings over a sample interval, smoothed by
    a first-order low pass: without it, one count at 2 ms would be worth 4 N m at joint 2.
    """

    path: AbstractPath
    """Where the joints should be, from where the encoders find the arm at first."""

    position_gain: Float[np.ndarray, " joints"]
    """[N m/rad or N/m]."""

    integral_gain: Float[np.ndarray, " joints"]
    """[N m/(rad s) or N/(m s)]."""

    velocity_gain: Float[np.ndarray, " joints"]
    """[N m s/rad or N s/m]."""

    gravity: AbbreviatedGravity | None = None

    cut_off: float = 20.0
    """Of the low pass on the rate [Hz]."""

    def begin(self, position: Float[Array, "*batch joints"]) -> PIDState:
        """At rest where the encoders say, without error."""
        zero = namespace(position).zeros_like(position)
        return PIDState(position, zero, zero, zero, clock(0.0, position))

    def demand(
        self, state: PIDState, time: float | Array, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch joints"], PIDState]:
        """As the abstract method."""
        xp = namespace(position)
        now = clock(time, position)
        error = self.path.position(now, state.origin) - position
        # No time has passed at the first sample, and the error has no rate yet.
        interval = now - state.time
        weight = -xp.expm1(-2 * np.pi * self.cut_off * interval)
        rate = (error - state.error) / xp.where(interval > 0, interval, 1.0)
        rate = state.rate + weight * (rate - state.rate)
        integral = state.integral + error * interval
        torque = (
            spread(self.position_gain, position) * error
            + spread(self.integral_gain, position) * integral
            + spread(self.velocity_gain, position) * rate
        )
        if self.gravity is not None:
            torque = torque + self.gravity.torque(position)
        return torque, PIDState(state.origin, error, rate, integral, now)

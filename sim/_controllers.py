import abc
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import Manipulator

from ._machine import MachineError


class AbstractController(abc.ABC):
    """What demands torque of the drives, once a sample, knowing the encoders and the clock.

    A controller is immutable; what it remembers is a state that it hands out and is handed back.
    Every method takes any leading batch axes.
    """

    @abc.abstractmethod
    def begin(self, position: Float[np.ndarray, "*batch joints"]) -> Any:
        """The state before the first sample, the joints at rest at `position` [rad or m]."""

    @abc.abstractmethod
    def demand(
        self, state: Any, time: float, position: Float[np.ndarray, "*batch joints"]
    ) -> tuple[Float[np.ndarray, "*batch joints"], Any]:
        """The torque demanded at `time` [s] when the encoders read `position` [rad or m], held
        until the next sample [N m or N], and the state to go on with."""


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

    def torque(
        self, position: Float[np.ndarray, "*batch joints"]
    ) -> Float[np.ndarray, "*batch joints"]:
        """The compensation at joint positions [rad], [N m]."""
        q2, q23 = position[..., 1], position[..., 1] + position[..., 2]
        forearm = self.forearm[0] * np.cos(q23) + self.forearm[1] * np.sin(q23)
        torque = np.zeros(position.shape)
        torque[..., 1] = self.upper_arm[0] * np.cos(q2) + self.upper_arm[1] * np.sin(q2) + forearm
        torque[..., 2] = forearm
        return torque


@dataclass(frozen=True, eq=False)
class Repulsion:
    """The safety measure of 7.4.1: a torque away from the ends of each joint's range.

    It is `strength` at an end and falls by a factor e every `width` inside it: vanishingly small
    through most of the range. The thesis gives neither its form nor its size.

    ```python
    >>> import numpy as np
    >>> from sim import Repulsion
    >>> repulsion = Repulsion(np.array([[-1.0, 1.0]]), strength=np.array([50.0]))
    >>> [float(repulsion.torque(np.array([q])).round(3)[0]) for q in (-1.0, -0.5, 0.0)]
    [50.0, 0.002, 0.0]

    ```
    """

    position_range: Float[np.ndarray, "joints 2"]
    """Lowest and highest position of each joint [rad or m]."""

    strength: Float[np.ndarray, " joints"]
    """Torque at either end [N m or N]; beyond it, it grows no more than threefold."""

    width: float = 0.05
    """[rad or m]."""

    def torque(
        self, position: Float[np.ndarray, "*batch joints"]
    ) -> Float[np.ndarray, "*batch joints"]:
        """The repulsion at joint positions [rad or m], [N m or N]."""
        above = (self.position_range[:, 0] - position) / self.width
        below = (position - self.position_range[:, 1]) / self.width
        return self.strength * (np.exp(np.minimum(above, 1.0)) - np.exp(np.minimum(below, 1.0)))


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
    repulsion: Repulsion | None = None

    def begin(self, position: Float[np.ndarray, "*batch joints"]) -> Any:
        """Nothing: this controller has no memory."""
        del position

    def demand(
        self, state: Any, time: float, position: Float[np.ndarray, "*batch joints"]
    ) -> tuple[Float[np.ndarray, "*batch joints"], Any]:
        """As the abstract method."""
        wave = self.amplitude * np.sin(2 * np.pi * time / self.period + self.phase)
        torque = np.broadcast_to(wave, position.shape)
        if self.gravity is not None:
            torque = torque + self.gravity.torque(position)
        if self.repulsion is not None:
            torque = torque + self.repulsion.torque(position)
        return torque, state


class PIDState(NamedTuple):
    """What a PID controller remembers; every array has shape (*batch, joints)."""

    origin: np.ndarray
    """Where the path begins [rad or m]."""
    error: np.ndarray
    """Position error at the sample before [rad or m]."""
    rate: np.ndarray
    """Filtered rate of the error [rad/s or m/s]."""
    integral: np.ndarray
    """Integral of the error [rad s or m s]."""
    time: float
    """Of the sample before [s]."""


@dataclass(frozen=True, eq=False)
class PID(AbstractController):
    """The comparison trajectory's controller (7.4.2): PID along a path, gravity compensated.

    The path is a `minimum_jerk` motion in joint space from where the encoders find the arm to
    `end`. The machine has no tachometers, so the rate of the error is the difference of two
    readings over a sample interval, smoothed by a first-order low pass: without it, one count at
    2 ms would be worth 4 N m at joint 2.
    """

    end: Float[np.ndarray, " joints"]
    """Where the path ends [rad or m]."""

    duration: float
    """Of the path [s]; afterwards its end is held."""

    position_gain: Float[np.ndarray, " joints"]
    """[N m/rad or N/m]."""

    integral_gain: Float[np.ndarray, " joints"]
    """[N m/(rad s) or N/(m s)]."""

    velocity_gain: Float[np.ndarray, " joints"]
    """[N m s/rad or N s/m]."""

    gravity: AbbreviatedGravity | None = None

    cut_off: float = 20.0
    """Of the low pass on the rate [Hz]."""

    def begin(self, position: Float[np.ndarray, "*batch joints"]) -> PIDState:
        """At rest where the encoders say, without error."""
        zero = np.zeros(position.shape)
        return PIDState(position, zero, zero, zero, 0.0)

    def demand(
        self, state: PIDState, time: float, position: Float[np.ndarray, "*batch joints"]
    ) -> tuple[Float[np.ndarray, "*batch joints"], PIDState]:
        """As the abstract method."""
        path = state.origin + (self.end - state.origin) * minimum_jerk(time / self.duration)
        error = path - position
        rate, integral = state.rate, state.integral
        interval = time - state.time
        if interval > 0:
            integral = integral + error * interval
            weight = -np.expm1(-2 * np.pi * self.cut_off * interval)
            rate = rate + weight * ((error - state.error) / interval - rate)
        torque = (
            self.position_gain * error + self.integral_gain * integral + self.velocity_gain * rate
        )
        if self.gravity is not None:
            torque = torque + self.gravity.torque(position)
        return torque, PIDState(state.origin, error, rate, integral, time)


def minimum_jerk(s: float) -> float:
    """The quintic from 0 at s = 0 to 1 at s = 1 that starts and ends at rest, unaccelerated.

    Of all such motions it has the least mean square jerk (Flash and Hogan 1985). Before and after
    it stays at 0 and at 1.

    ```python
    >>> from sim import minimum_jerk
    >>> minimum_jerk(-1.0), minimum_jerk(0.5), minimum_jerk(2.0)
    (0.0, 0.5, 1.0)

    ```
    """
    s = min(max(s, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))

"""Drive of a joint with a position servo: its parameters, their names and units.

The servo follows a commanded position. Its torque acts through a gear on the joint:

     command --> delay --> dead zone --> gain, damping, integral --> torque limit --> torque
                              ^                                                          |
     encoder (steps, offset) -+------- motor side <-- play --> joint side <-- friction <-+

`_simulation` integrates these equations. `_fit` estimates the parameters.
"""

import dataclasses
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ServoDrive:
    """A position servo and the friction of its joint, in units of the joint side.

    With reading r = q + `offset`, delayed command c and error e = c - r, of which `dead_zone` is
    taken off, the servo's torque is

        gain * e + integral * (time integral of e) + damping * (lead * dc/dt - dq/dt)

    within the limits of torque and speed. Friction of the joint is

        viscous * dq/dt + sign(dq/dt) * (coulomb + load_friction * |load|
            + static * exp(-(dq/dt / stribeck)^2))

    where the load is the torque of the links that the gear carries. At rest, friction takes
    whatever value up to that level keeps the joint at rest.

    **Attributes**

    - `gain`: torque per position error [N m/rad].
    - `damping`: torque per velocity, of the D gain and the motor's back-EMF [N m s/rad].
    - `integral`: torque per time integral of the error [N m/(rad s)].
    - `lead`: part of the command's velocity that `damping` acts on: 0 for damping of the motion
      alone, 1 for a derivative of the error.
    - `delay`: from the command's time stamp to its effect [s].
    - `dead_zone`: position error up to which the servo applies no torque [rad].
    - `torque_limit`: largest torque of the servo [N m].
    - `speed_limit`: no-load speed, at which the back-EMF leaves no torque [rad/s].
    - `offset`: reading of the encoder minus the joint angle of the robot's file [rad].
    - `encoder_step`: resolution of the readings; 0 if they are not rounded [rad].
    - `armature`: inertia of the motor, seen at the joint [kg m²].
    - `coulomb`: Coulomb friction [N m].
    - `viscous`: viscous friction [N m s/rad].
    - `static`: breakaway friction above `coulomb` [N m].
    - `stribeck`: velocity at which that excess has fallen to 1/e [rad/s].
    - `load_friction`: friction per torque of the load.
    - `play`: total play of the gear [rad].
    - `low`, `high`: ends of travel, as readings [rad].

    `damping` and `viscous` have the same effect while the torque limit is not reached. A fit that
    cannot separate them puts their sum into `damping`.

    Sources: Dynamixel and Feetech servos have such a control law in position mode; friction that
    depends on the load is model M3 of the BAM paper (Duclusaud et al., 2025, arXiv:2410.08650).

    >>> from jaxcslc.servo import ServoDrive
    >>> drive = ServoDrive(gain=10.0, damping=0.5, coulomb=0.1, delay=0.04)
    >>> drive.scaled(2.0).gain, drive.scaled(2.0).delay
    (20.0, 0.04)
    """

    gain: float
    damping: float = 0.0
    integral: float = 0.0
    lead: float = 0.0
    delay: float = 0.0
    dead_zone: float = 0.0
    torque_limit: float = math.inf
    speed_limit: float = math.inf
    offset: float = 0.0
    encoder_step: float = 0.0
    armature: float = 0.0
    coulomb: float = 0.0
    viscous: float = 0.0
    static: float = 0.0
    stribeck: float = 0.1
    load_friction: float = 0.0
    play: float = 0.0
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if math.isnan(value):
                raise ValueError(f"{field.name}: expected a number, got {value}")
            if field.name not in _SIGNED and value < 0.0:
                raise ValueError(f"{field.name}: expected at least 0, got {value}")
            if field.name not in _UNBOUNDED and math.isinf(value):
                raise ValueError(f"{field.name}: expected a finite number, got {value}")
        if self.gain == 0.0:
            raise ValueError("gain: expected more than 0, got 0")
        if self.stribeck == 0.0:
            raise ValueError("stribeck: expected more than 0, got 0")
        if not self.low < self.high:
            raise ValueError(f"low: expected less than high, {self.high}, got {self.low}")

    def scaled(self, factor: float) -> "ServoDrive":
        """Return the drive with all torques and inertias multiplied by `factor`.

        With the masses of the links multiplied by it too, the arm moves as before.
        """
        return dataclasses.replace(self, **{x: factor * getattr(self, x) for x in TORQUES})


TORQUES = (
    "gain",
    "damping",
    "integral",
    "torque_limit",
    "armature",
    "coulomb",
    "viscous",
    "static",
)
"""Parameters that are proportional to the unit of torque."""

DRIVE_UNITS = {
    "gain": "N m/rad",
    "damping": "N m s/rad",
    "integral": "N m/(rad s)",
    "lead": "1",
    "delay": "s",
    "dead_zone": "rad",
    "torque_limit": "N m",
    "speed_limit": "rad/s",
    "offset": "rad",
    "encoder_step": "rad",
    "armature": "kg m²",
    "coulomb": "N m",
    "viscous": "N m s/rad",
    "static": "N m",
    "stribeck": "rad/s",
    "load_friction": "1",
    "play": "rad",
    "low": "rad",
    "high": "rad",
}
"""Unit of each parameter of a `ServoDrive`."""

_SIGNED = {"offset", "low", "high"}
_UNBOUNDED = {"torque_limit", "speed_limit", "low", "high"}

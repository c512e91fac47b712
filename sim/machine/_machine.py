"""A simulated machine: its robot, drives, encoders, friction and all disturbances."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxcslc.manipulator import LinkParameters, Manipulator
from sim.machine._bodies import MachineError, possible_links, tilted_links


@dataclass(frozen=True)
class Machine:
    """A simulated manipulator: rigid links, drives, friction and disturbances.

    `robot` has what the identification determines: geometry, gravity, true link parameters and
    motor inertias. Every other field is a disturbance or a limit, with one value a joint; each
    can be switched on or off alone, with `dataclasses.replace(machine, ...)` and the value below
    marked *off*. An empty tuple is *off* for every joint.

    A joint with finite `stiffness` has two degrees of freedom: its motor's rotor, on which the
    encoder is mounted, and its link. Friction is divided between them. Quantities of a rotor are
    expressed at the joint, after the gear reduction.

    **Raises** `MachineError`: naming the field and the joint of a value that no machine can have.

    >>> import dataclasses
    >>> import sim
    >>> smooth = dataclasses.replace(sim.puma560(), dry=(0.0,) * 6, static=(0.0,) * 6)
    >>> smooth.static
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """

    robot: Manipulator
    """Geometry, gravity and true link parameters, motor inertias included."""

    viscous: tuple[float, ...]
    """k^v of Eqn. 2.5-4 [N m s/rad, or N s/m for a prismatic joint]. Off: 0."""

    dry: tuple[float, ...]
    """k^d of Eqn. 2.5-4 [N m or N]. Off: 0, and `static` 0 with it."""

    static: tuple[float, ...]
    """k^s of Eqn. 2.5-4, the torque at which a resting joint breaks away [N m or N]; at least
    `dry`. Off: equal to `dry`, which leaves a joint that sticks but breaks away at `dry`."""

    static_velocity: tuple[float, ...]
    """γ of Eqn. 2.5-4: the speed over which friction falls from `static` to `dry` by a factor e
    [rad/s or m/s]; positive."""

    encoder_resolution: tuple[float, ...]
    """What one count of the encoder means at the joint (7.1) [rad or m]. Off: 0."""

    maximum_torque: tuple[float, ...]
    """Largest magnitude of the drive's torque; larger demands are clipped [N m or N].
    Off: `math.inf`."""

    position_range: tuple[tuple[float, float], ...]
    """Lowest and highest position of each joint [rad or m]. There are no stops: a
    controller should keep within these limits, and a simulation that leaves them is an error.
    Off: `(-math.inf, math.inf)`."""

    stiffness: tuple[float, ...] = ()
    """Of each joint's transmission, at the joint [N m/rad or N/m] (2.5.3). Off: `math.inf`, rotor
    and link one body."""

    backlash: tuple[float, ...] = ()
    """b, how far the link can move freely while its rotor stands still [rad or m] (2.5.3); needs
    a finite `stiffness`, for it is a spring that begins where the gears meet. Off: 0."""

    transmission_damping: tuple[float, ...] = ()
    """Of each transmission, between rotor and link [N m s/rad or N s/m]. MuJoCo's tendon damps
    inside the dead band too, as oil between the teeth would. Off: 0."""

    link_share: tuple[float, ...] = ()
    """Part of a joint's friction that acts on its link; the remainder acts on its rotor (^lF and
    ^mF of 2.5.3); from 0 to 1. Without a transmission it makes no difference. Off: 0."""

    asymmetry: tuple[float, ...] = ()
    """a: friction is 1 + a times the above when the joint moves forwards, 1 - a times when it
    moves backwards; between -1 and 1. Off: 0."""

    linear_torque: tuple[float, ...] = ()
    """Limit of linearity (7.2.3): more demand than this brings less torque than demanded, and
    never more than `maximum_torque` [N m or N]. Off: `math.inf`."""

    tilt: tuple[float, ...] = ()
    """By how much each link's principal axes are turned, about the direction (1, 1, 1) of its
    frame, while the principal-axis substitution supposes them parallel to the frame's (7.2.1)
    [rad]. Off: 0."""

    timing_jitter: float = 0.0
    """How far, either way, an encoder is read before or after the sample's time; drawn uniformly
    from the seed, at each sample once for all joints [s]. Off: 0."""

    torque_delay: float = 0.0
    """Time from a sample until the drives apply its demand [s]; less than the
    sample interval. Off: 0."""

    start_spread: float = 5e-4
    """Largest distance of a joint's initial position from the trajectory's start [rad or m];
    drawn uniformly from the seed. Off: 0."""

    time_step: float = 5e-4
    """Largest step of the simulation's integrator [s]; a transmission needs shorter ones.

    Over the comparison trajectory, halving the default changes no encoder reading by more than one
    count, and none by more than 0.001 counts where readings are not quantised. The training
    trajectory runs open loop for 6.6 s and accumulates the errors of each stick and slip: there a
    halving moves joints 1 to 3 by 1 to 4 counts, the wrist by 10 to 15."""

    def __post_init__(self) -> None:
        if self.robot.links is None:
            raise MachineError(
                f"robot {self.robot.name!r} has no link parameters; a machine needs its masses"
            )
        for name, off in OFF.items():
            if not getattr(self, name):
                object.__setattr__(self, name, (off,) * self.joint_count)
        for name in ("viscous", "dry", "static", "encoder_resolution", "backlash"):
            self._check(name, lambda value: 0 <= value < math.inf, "zero or more")
        self._check("transmission_damping", lambda value: 0 <= value < math.inf, "zero or more")
        self._check("static_velocity", lambda value: 0 < value < math.inf, "more than zero")
        for name in ("maximum_torque", "stiffness", "linear_torque"):
            self._check(name, lambda value: value > 0, "more than zero")
        self._check("link_share", lambda value: 0 <= value <= 1, "from 0 to 1")
        self._check("asymmetry", lambda value: -1 < value < 1, "more than -1 and less than 1")
        self._check("tilt", math.isfinite, "a number")
        self._check_friction()
        self._check_ranges()
        self._check_transmission()
        for name in ("start_spread", "timing_jitter", "torque_delay"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise MachineError(f"{name} is {value}; expected zero or more")
        if not 0 < self.time_step < math.inf:
            raise MachineError(f"time_step is {self.time_step}; expected more than zero")
        for i, link in enumerate(self.robot.links, start=1):
            if not float(link.motor_inertia) >= 0:
                raise MachineError(
                    f"motor_inertia of joint {i} is {link.motor_inertia}; expected zero or more"
                )
        # Raises for parameters that no rigid body can have.
        possible_links(self.robot, self.robot.links)

    @property
    def joint_count(self) -> int:
        return self.robot.joint_count

    @functools.cached_property
    def links(self) -> tuple[LinkParameters, ...]:
        """True link parameters: those of `robot`, their principal axes turned by `tilt`.

        The principal-axis substitution neglects the resulting products of inertia;
        a network without it (`inertia="full"`) has true coefficients from these parameters, and
        one with it from their moments alone.
        """
        assert self.robot.links is not None
        if not any(self.tilt):
            return self.robot.links
        return tilted_links(possible_links(self.robot, self.robot.links), self.tilt)

    @property
    def flexible(self) -> tuple[bool, ...]:
        """Joints that have a rotor and a link that move apart."""
        return tuple(stiffness < math.inf for stiffness in self.stiffness)

    def _check_friction(self) -> None:
        for i, (static, dry) in enumerate(zip(self.static, self.dry, strict=True), start=1):
            if static < dry:
                raise MachineError(
                    f"static of joint {i} is {static}; expected no less than its dry, {dry}"
                )

    def _check_ranges(self) -> None:
        ranges = tuple((float(low), float(high)) for low, high in self.position_range)
        object.__setattr__(self, "position_range", ranges)
        self._check_count("position_range", ranges)
        for i, (low, high) in enumerate(ranges, start=1):
            if not low < high:
                raise MachineError(
                    f"position_range of joint {i} is ({low}, {high});"
                    " expected the lowest position before a higher one"
                )

    def _check_transmission(self) -> None:
        assert self.robot.links is not None
        for i, (stiffness, backlash, (low, high), link) in enumerate(
            zip(self.stiffness, self.backlash, self.position_range, self.robot.links, strict=True),
            start=1,
        ):
            if self.linear_torque[i - 1] < self.maximum_torque[i - 1] == math.inf:
                raise MachineError(
                    f"linear_torque of joint {i} is {self.linear_torque[i - 1]:g} and its"
                    " maximum_torque infinite; expected a finite one, for the drive to approach"
                )
            if backlash > high - low:
                raise MachineError(
                    f"backlash of joint {i} is {backlash:g}; expected no more than its position"
                    f" range, {high - low:.4g}"
                )
            if stiffness == math.inf and backlash > 0:
                raise MachineError(
                    f"backlash of joint {i} is {backlash:g} and its stiffness infinite; expected a"
                    " finite stiffness, for the gears to meet"
                )
            if stiffness < math.inf and not float(link.motor_inertia) > 0:
                raise MachineError(
                    f"motor_inertia of joint {i} is {link.motor_inertia}; expected more than zero"
                    " of a rotor behind a transmission of finite stiffness"
                )

    def _check_count(self, name: str, values: Sequence[object]) -> None:
        if len(values) != self.joint_count:
            raise MachineError(
                f"{name} has {len(values)} values; expected {self.joint_count}, one a joint"
            )

    def _check(self, name: str, allowed: Callable[[float], bool], expected: str) -> None:
        values = tuple(float(value) for value in getattr(self, name))
        object.__setattr__(self, name, values)
        self._check_count(name, values)
        for i, value in enumerate(values, start=1):
            if not allowed(value):
                raise MachineError(f"{name} of joint {i} is {value}; expected {expected}")


# What switches a disturbance of the joints off: the value of every joint if a field is left empty.
OFF = {
    "stiffness": math.inf,
    "backlash": 0.0,
    "transmission_damping": 0.0,
    "link_share": 0.0,
    "asymmetry": 0.0,
    "linear_torque": math.inf,
    "tilt": 0.0,
}

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jaxcslc.manipulator import Manipulator


class MachineError(ValueError):
    """A machine, or a trajectory for one, that cannot exist.

    The message is one line: which field and joint, what was found and what was expected.
    """


@dataclass(frozen=True)
class Machine:
    """A manipulator as it stands on the floor: the rigid links and what disturbs them.

    `robot` says what the identification is about: geometry, gravity, true link parameters and
    motor inertias. Every other field is a disturbance or a limit, with one value a joint; each
    can be switched off alone, with `dataclasses.replace(machine, ...)` and the value given here
    as *off*.

    **Raises**

    - `MachineError`: naming the field and the joint of a value that no machine can have.

    ```python
    >>> import dataclasses
    >>> import sim
    >>> smooth = dataclasses.replace(sim.puma560(), dry=(0.0,) * 6, static=(0.0,) * 6)
    >>> smooth.static
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    ```
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
    """Largest magnitude of torque that the drive gives; it clips what is beyond [N m or N].
    Off: `math.inf`."""

    position_range: tuple[tuple[float, float], ...]
    """Lowest and highest position of each joint [rad or m]. There are no stops: these are what a
    controller is told to keep away from, and what a simulation is refused for leaving.
    Off: `(-math.inf, math.inf)`."""

    start_spread: float = 5e-4
    """How far, either way, a joint may rest from where a trajectory says it starts [rad or m];
    drawn uniformly from the seed. Off: 0."""

    time_step: float = 5e-4
    """Largest step of the simulation's integrator [s].

    Over the comparison trajectory, halving the default changes no encoder reading by more than one
    count, and none by more than 0.001 counts where readings are not quantised. The training
    trajectory runs open loop for 6.6 s and adds up what each stick and slip is off by: there a
    halving moves joints 1 to 3 by 1 to 4 counts, the wrist by 10 to 15."""

    def __post_init__(self) -> None:
        if self.robot.links is None:
            raise MachineError(
                f"robot {self.robot.name!r} has no link parameters; a machine needs its masses"
            )
        for name in ("viscous", "dry", "static", "encoder_resolution"):
            self._check(name, lambda value: 0 <= value < math.inf, "zero or more")
        self._check("static_velocity", lambda value: 0 < value < math.inf, "more than zero")
        self._check("maximum_torque", lambda value: value > 0, "more than zero")
        for i, (static, dry) in enumerate(zip(self.static, self.dry, strict=True), start=1):
            if static < dry:
                raise MachineError(
                    f"static of joint {i} is {static}; expected no less than its dry, {dry}"
                )
        ranges = tuple((float(low), float(high)) for low, high in self.position_range)
        object.__setattr__(self, "position_range", ranges)
        self._check_count("position_range", ranges)
        for i, (low, high) in enumerate(ranges, start=1):
            if not low < high:
                raise MachineError(
                    f"position_range of joint {i} is ({low}, {high});"
                    " expected the lowest position before a higher one"
                )
        if not 0 <= self.start_spread < math.inf:
            raise MachineError(f"start_spread is {self.start_spread}; expected zero or more")
        if not 0 < self.time_step < math.inf:
            raise MachineError(f"time_step is {self.time_step}; expected more than zero")

    @property
    def joint_count(self) -> int:
        return self.robot.joint_count

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

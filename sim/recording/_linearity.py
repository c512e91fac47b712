"""Linearity of a motor: mean demand against suspended mass (Fig. 7.2-2)."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxcslc.control import PID
from jaxcslc.manipulator import LinkParameters, puma560 as puma560_robot
from sim.engine._simulate import simulate
from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.trajectory._paths import Oscillation
from sim.trajectory._torques import AbbreviatedGravity
from sim.trajectory._trajectories import FLANGE, Trajectory


# Friction torque of a brake [N m]: more than any weight on the arm exerts.
_BRAKE = 1e4
# The first oscillation is a settling time of the controller, and is not measured.
_SETTLING = 1
_INTERVAL = 0.002  # s, as in 7.4


@dataclass(frozen=True, eq=False)
class MotorLinearity:
    """Mean demand against suspended mass (Fig. 7.2-2), and the line of a linear motor.

    The line is the least-squares fit to every measurement but the heaviest. A motor beyond its
    limit of linearity needs more demand a torque, which puts the heaviest above the line.
    """

    joint: int
    """Counted from 1."""

    mass: Float[np.ndarray, " measurements"]
    """Suspended from the flange [kg], ascending."""

    torque: Float[np.ndarray, " measurements"]
    """Mean torque demanded over whole oscillations, positive against gravity [N m]."""

    slope: float
    """Of the line [N m/kg]: gravity times the lever."""

    intercept: float
    """Of the line [N m]: the torque of the arm alone."""

    @classmethod
    def of(
        cls,
        joint: int,
        mass: Float[np.ndarray, " measurements"],
        torque: Float[np.ndarray, " measurements"],
    ) -> "MotorLinearity":
        """The fit to measurements, in any order."""
        order = np.argsort(mass, kind="stable")
        mass, torque = mass[order], torque[order]
        slope, intercept = np.polyfit(mass[:-1], torque[:-1], 1)
        return cls(joint, mass, torque, float(slope), float(intercept))

    @property
    def residual(self) -> Float[np.ndarray, " measurements"]:
        """Distance of each measurement above the line [N m]."""
        return self.torque - (self.intercept + self.slope * self.mass)

    @property
    def scatter(self) -> float:
        """Standard deviation of the measurements that the line was fitted to [N m]; NaN for two,
        through which a line always goes."""
        fitted = self.residual[:-1]
        degrees_of_freedom = fitted.size - 2
        return (
            math.sqrt(float(fitted @ fitted) / degrees_of_freedom)
            if degrees_of_freedom
            else math.nan
        )

    @property
    def excess(self) -> float:
        """Distance of the heaviest measurement above the line [N m]."""
        return float(self.residual[-1])


def motor_linearity(
    machine: Machine,
    *,
    joint: int = 2,
    masses: Sequence[float | int] = (0, 0, 0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5),
    posture: Sequence[float] = (0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0),
    amplitude: float = 0.1,
    period: float = 2.0,
    swings: int = 3,
    position_gain: float = 10000.0,
    velocity_gain: float = 114.0,
    seed: int = 0,
    progress: Callable[[Iterable[float | int]], Iterable[float | int]] | None = None,
) -> MotorLinearity:
    """The experiment of 7.2.3 on a PUMA 560: is a motor's torque linear in its demand?

    Every other joint is locked, the arm points straight out, weights hang from the flange, and a
    PD controller with the abbreviated gravity compensation makes the joint oscillate about the
    horizontal, so that friction averages out. The measurement is the demand, power expressed as
    torque, as on the real machine.

    The thesis gives no masses, gains or motion. The defaults are choices: masses that take joint
    2's mean demand from 46 to 86 N m, beyond the 55 N m of the training trajectory, and
    the gains of 7.4.2. The compensation does not include the weight; the PD controller balances it,
    which lowers the mean position by mass times gravity times lever over `position_gain`, 4 mrad
    with the heaviest.

    **Arguments**

    - `machine`: a PUMA 560.
    - `joint`: the joint of the tested motor, counted from 1.
    - `masses`: one measurement each [kg]; three or more different ones.
    - `posture`: the mean position [rad]. Gravity's torque should not change much about it.
    - `amplitude`, `period`: of the oscillation [rad], [s].
    - `swings`: how many whole periods are averaged, after one for settling.
    - `position_gain`, `velocity_gain`: of the controller [N m/rad], [N m s/rad].
    - `seed`: of the first measurement; every other takes the next.
    - `progress`: wraps the iteration over the masses, such as `tqdm`.

    **Raises**

    - `MachineError`: no such joint, too few different masses for a line, or no oscillation.
    - `SimulationError`: a joint leaves its range.

    >>> import sim
    >>> result = sim.motor_linearity(
    ...     sim.puma560(), masses=(0, 1, 2), swings=1, period=0.5, amplitude=0.03
    ... )
    >>> round(result.slope), abs(result.excess) < 0.05
    (9, True)
    """
    if not 1 <= joint <= machine.joint_count:
        raise MachineError(f"joint is {joint}; expected one from 1 to {machine.joint_count}")
    if bad := [mass for mass in masses if not 0 <= mass < math.inf]:
        raise MachineError(f"masses have {bad[0]}; expected zero or more")
    if len(set(masses)) < 3:
        raise MachineError(
            f"masses have {len(set(masses))} different values; expected three or more, for a line"
            " and a heaviest beside it"
        )
    if swings < 1:
        raise MachineError(f"swings is {swings}; expected one or more")
    still = np.array(posture, dtype=np.float64)
    moving = (np.arange(1, still.size + 1) == joint).astype(np.float64)
    controller = PID(
        still.size,
        position_gain=position_gain * moving,
        integral_gain=0.0 * moving,
        velocity_gain=velocity_gain * moving,
        gravity=AbbreviatedGravity.of(puma560_robot()),
        integration="backward",
    )
    trajectory = Trajectory(
        "motor linearity",
        still - amplitude * moving,
        controller,
        samples=round((_SETTLING + swings) * period / _INTERVAL),
        sample_interval=_INTERVAL,
        path=Oscillation(still, amplitude * moving, period),
    )
    locked = _locked(machine, joint)
    measured = round(swings * period / _INTERVAL)
    torque = np.array(
        [
            simulate(_laden(locked, mass), trajectory, seed=seed + number)
            .recording.torque[-measured:, joint - 1]
            .mean()
            for number, mass in enumerate(masses if progress is None else progress(masses))
        ]
    )
    return MotorLinearity.of(
        joint, np.array(masses, dtype=np.float64), np.sign(torque.sum()) * torque
    )


def _locked(machine: Machine, joint: int) -> Machine:
    """A machine whose other joints are all locked by brakes on motors and links."""

    def instead(values: tuple[float, ...], locked: float) -> tuple[float, ...]:
        return tuple(v if i == joint else locked for i, v in enumerate(values, start=1))

    return dataclasses.replace(
        machine,
        dry=instead(machine.dry, _BRAKE),
        static=instead(machine.static, _BRAKE),
        stiffness=instead(machine.stiffness, math.inf),
        backlash=instead(machine.backlash, 0.0),
        transmission_damping=instead(machine.transmission_damping, 0.0),
    )


def _laden(machine: Machine, mass: float | int) -> Machine:
    """A machine with a point mass at the centre of its flange."""
    links = machine.robot.links
    assert links is not None  # a machine has links
    if mass == 0:
        return machine
    hand = links[-1]
    hand_mass = float(hand.mass)
    flange = np.array([0.0, 0.0, FLANGE])
    centre = (hand_mass * np.asarray(hand.centre_of_gravity) + mass * flange) / (hand_mass + mass)
    inertia = np.asarray(hand.inertia, dtype=np.float64)
    for part, at in ((hand_mass, np.asarray(hand.centre_of_gravity)), (mass, flange)):
        r = at - centre
        inertia = inertia + part * (r @ r * np.eye(3) - np.outer(r, r))
    laden = LinkParameters(hand_mass + mass, centre, inertia, hand.motor_inertia)
    robot = dataclasses.replace(machine.robot, links=(*links[:-1], laden))
    return dataclasses.replace(machine, robot=robot)

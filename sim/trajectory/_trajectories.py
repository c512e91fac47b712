"""Trajectories: tasks of a simulation, and those of the thesis's experiment."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxcslc.control import PID, AbstractController
from jaxcslc.manipulator import Manipulator, puma560 as puma560_robot
from sim.machine._bodies import MachineError
from sim.machine._events import Fault, Load
from sim.machine._puma560 import puma560
from sim.trajectory._kinematics import Hand
from sim.trajectory._paths import AbstractPath, MinimumJerk
from sim.trajectory._torques import AbbreviatedGravity, HandRepulsion, Repulsion, SinusoidalTorque


# The PUMA 560 around the frames of Fig. 2.6-3, in metres; not in the thesis. Frame 0 is at the
# height of the shoulder. Column and flange are as commonly published; the trunk is a choice that
# contains the column and the volume that the upper arm's rear end sweeps, and permits the upright
# arm. The hand cannot reach the upper arm: at either end of joint 3's range, the flange is
# still 0.24 m or more from its middle line.
_FLOOR = -0.6718
FLANGE = 0.05625
"""Distance of the PUMA 560's flange from its wrist centre [m]."""
_TRUNK_RADIUS = 0.25
_TRUNK_TOP = 0.2
# See `adjusted_training`.
_ADJUSTED_AMPLITUDE = (-28.69, -25.46, 23.33, -8.02, 10.2, -11.79)  # N m
_ADJUSTED_START = (0.62, -1.55, 1.23, 0.39, 0.11, 0.18)  # rad


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The task of a simulation: start, controller, desired path, duration, loads and faults."""

    name: str

    start: Float[np.ndarray, " joints"]
    """Joint positions at time 0, at rest [rad or m]."""

    controller: AbstractController

    samples: int
    """How many samples are recorded, the first at time 0."""

    sample_interval: float = 0.002
    """Between samples; the demand is updated at each of them and constant in between [s] (7.4)."""

    loads: tuple[Load, ...] = ()
    """Bodies that the last link carries, with times."""

    faults: tuple[Fault, ...] = ()
    """Faults of encoders and drives, with times."""

    path: AbstractPath | None = None
    """The desired motion, from the first encoder readings; None to stay there."""

    per_machine: bool = False
    """Whether each machine has its controller. Every array in `controller` then has a
    leading axis of machines, and each controller gets one machine's readings, (joints,). Otherwise
    one controller gets those of all machines, (machines, joints)."""

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise MachineError(
                f"trajectory {self.name!r} has {self.samples} samples; expected some"
            )
        if not self.sample_interval > 0:
            raise MachineError(
                f"trajectory {self.name!r} has a sample interval of {self.sample_interval} s;"
                " expected more than zero"
            )


def training(
    *,
    samples: int = 3300,
    amplitude: tuple[float, ...] = (25.0, 13.0, 14.0, 8.0, 10.0, 14.0),
    period: tuple[float, ...] = (4.1, 2.7, 1.7, 1.1, 0.7, 0.5),
    start: tuple[float, ...] = (0.4, -1.2, 0.3, 0.0, 0.0, 0.0),
    robot: Manipulator | None = None,
) -> Trajectory:
    """The PUMA 560's training trajectory of 7.4.1: sinusoidal torques, open loop.

    Sinusoids of phase 3π/2, from rest at (0.4, −1.2, 0.3, 0, 0, 0) rad, with the abbreviated
    gravity compensation and repulsions: from the ends of the joints' ranges, and of the flange from
    the floor and from the trunk. The last two periods are restored from a damaged scan; the last
    amplitude is reconstructed (the scan's 60 N m cannot be), and so are form and size of the
    repulsions. With the defaults, the flange keeps 0.9 m from the floor and 0.25 m from the
    trunk, where their repulsion is a hundredth of a newton metre.

    **Arguments**

    - `samples`: how many, 2 ms apart; 6.6 s as in the thesis.
    - `amplitude`: of each joint's torque [N m]. The thesis changes these between trials.
    - `period`: of each joint's torque [s]. Different prime multiples of 0.1 s keep
        configurations from being repeated.
    - `start`: joint positions at rest [rad].
    - `robot`: whose gravity is compensated; Armstrong's PUMA 560 if omitted, as in the thesis. That
        of PUMA A (`puma_a`) differs enough to let joint 3 run into the end of its range after two
        seconds.

    >>> import sim
    >>> trajectory = sim.training()
    >>> trajectory.samples, trajectory.start
    (3300, array([ 0.4, -1.2,  0.3,  0. ,  0. ,  0. ]))
    """
    machine = puma560()
    return Trajectory(
        "training",
        np.array(start),
        SinusoidalTorque(
            np.array(amplitude),
            np.array(period),
            np.full(6, 1.5 * np.pi),
            gravity=AbbreviatedGravity.of(machine.robot if robot is None else robot),
            repulsion=(
                Repulsion(np.array(machine.position_range), np.array(machine.maximum_torque)),
                HandRepulsion(
                    Hand.of(machine.robot, (0.0, 0.0, FLANGE)), _FLOOR, _TRUNK_RADIUS, _TRUNK_TOP
                ),
            ),
        ),
        samples,
    )


def adjusted_training(*, samples: int = 3300) -> Trajectory:
    """The training trajectory of 7.4.1 after trials, in which joints sweep most of their ranges.

    The thesis adjusts the amplitudes between trials until each joint sweeps the majority of its
    range. The amplitudes that it prints move joint 3 of the simulated machines through a third of
    its range, and joint 6 through a seventh. These are from several searches by trials on the
    simulated PUMA A and B, with Armstrong's gravity, of the kind of
    `scripts/studies/puma560/trials.py`, which says what they sweep: 59 % for joint 2 of PUMA A, and
    more than 60 % elsewhere. Start and signs were adjusted too, and joint 5's amplitude by hand.
    Joint 6 has a period of 1.3 s: at the thesis's 0.5 s, with 14 N m of the 17 N m at which its
    motor ceases to be linear, it sweeps a seventh. Repelled from the end of its range, joint 2
    comes as near as 0.03 rad. No demand exceeds what a motor was seen to be linear up to (7.2.3).

    **Arguments**

    - `samples`: how many, 2 ms apart; 6.6 s as in the thesis.

    >>> import sim
    >>> sim.adjusted_training().start
    array([ 0.62, -1.55,  1.23,  0.39,  0.11,  0.18])
    """
    return training(
        samples=samples,
        amplitude=_ADJUSTED_AMPLITUDE,
        period=(4.1, 2.7, 1.7, 1.1, 0.7, 1.3),
        start=_ADJUSTED_START,
    )


def comparison(*, duration: float = 2.5) -> Trajectory:
    """The PUMA 560's comparison trajectory of 7.4.2: from rest to rest, every joint by 90°.

    From (0, −π/2, π/2, 0, 0, 0) to (−π/2, 0, 0, π/2, π/2, π/2) rad under PID control with the
    thesis's gains and the abbreviated gravity compensation. The thesis does not give the shape of
    the path: minimum jerk is a reconstruction that reproduces the reported torques, and so is the
    sixth integral gain.

    **Arguments**

    - `duration`: from rest to rest [s]. The recording ends with it.

    >>> import sim
    >>> sim.comparison().samples
    1251
    """
    right = np.pi / 2
    interval = 0.002
    return Trajectory(
        "comparison",
        np.array([0.0, -right, right, 0.0, 0.0, 0.0]),
        PID(
            6,
            position_gain=np.array([4000.0, 10000.0, 2000.0, 500.0, 310.0, 300.0]),
            integral_gain=np.full(6, 5.0),
            velocity_gain=np.array([80.0, 114.0, 25.0, 25.0, 12.0, 17.0]),
            gravity=AbbreviatedGravity.of(puma560_robot()),
            integration="backward",
        ),
        samples=round(duration / interval) + 1,
        sample_interval=interval,
        path=MinimumJerk(np.array([-right, 0.0, 0.0, right, right, right]), duration),
    )

"""Simulation of servo arms: positions from commands, and loads of one joint of a moving arm.

`servo.c` has the equations. `simulate` moves a whole arm. `JointLoads` has the torques and
inertias that a joint carries while the others move as recorded, for `_fit`.
"""

import ctypes
import dataclasses
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..codegen import INTEGERS, LONG, CArray, CFunction
from ..manipulator import LinkParameters, Manipulator, RobotError, fixed_together, link_poses
from ..recordings import as_float
from ._drive import DRIVE_UNITS, ServoDrive


LONGEST_STEP = 0.00125
"""Longest step of a simulation of gears without play [s]."""
# With play. Steps of 1.25 ms err by up to 0.2 mrad there, half of the rounding of a 12-bit encoder.
# Estimates of drives then differ by several standard errors.
_STEP_WITH_PLAY = 0.0005
# Sweeps over the joints until velocities change by no more [rad/s]: the matrix is positive
# definite, and armatures make its diagonal large. Six joints take about eight sweeps.
_SWEEPS = 200
_TOLERANCE = 1e-9

_STATES = CArray("samples joints")
_COLUMN = CArray("samples")


@dataclass(frozen=True)
class _Arm:
    """Arguments of C that describe the links."""

    parents: np.ndarray
    slides: np.ndarray
    placement: np.ndarray
    body: np.ndarray
    gravity: np.ndarray

    kinds = (
        CArray("joints", INTEGERS),
        CArray("joints", INTEGERS),
        CArray("joints placement"),
        CArray("joints body"),
        CArray("three"),
    )

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        return self.parents, self.slides, self.placement, self.body, self.gravity


@cache
def _function(name: str) -> CFunction:
    source = Path(__file__).with_name("servo.c").read_text("utf-8")
    arguments: dict[str, tuple[Any, ...]] = {
        "simulate_arm": (
            *_Arm.kinds,
            CArray("joints parameters"),
            _COLUMN,
            _STATES,
            _STATES,
            CArray("two joints"),
            CArray("samples joints", written=True),
            *[LONG] * 4,
            ctypes.c_double,
        ),
        "simulate_joint": (
            *[_COLUMN] * 4,
            CArray("samples four"),
            CArray("sets parameters"),
            CArray("two"),
            CArray("sets samples", written=True),
            *[LONG] * 3,
        ),
        "inverse_dynamics": (
            *_Arm.kinds,
            *[_STATES] * 3,
            CArray("samples joints", written=True),
            CArray("samples joints joints", written=True, optional=True),
            LONG,
            LONG,
        ),
    }
    return CFunction(source, name, arguments[name])


def _arm(robot: Manipulator) -> _Arm:
    """**Raises** `RobotError` for a robot without masses or lengths."""
    if robot.links is None:
        raise RobotError(
            f"robot {robot.name!r} has no masses; expected mass, centre and inertia of each link"
        )
    n = robot.joint_count
    poses = np.asarray(link_poses(robot, np.zeros(n)))
    parents = np.array(robot.parents)
    steps = [
        pose if parent < 0 else np.linalg.solve(poses[parent], pose)
        for pose, parent in zip(poses, parents, strict=True)
    ]
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return _Arm(
        parents,
        np.array([kind == "P" for kind in robot.kinds], int),
        np.array([np.append(T[:3, :3], T[:3, 3]) for T in steps]),
        np.array(
            [
                [link.mass, *link.centre_of_gravity, *np.asarray(link.inertia)[rows, columns]]
                for link in robot.links
            ],
            float,
        ),
        np.array(robot.gravity, float),
    )


def with_payload(robot: Manipulator, payload: LinkParameters | None) -> Manipulator:
    """Return the robot with a body fixed to its last link, in that link's frame."""
    if payload is None or robot.links is None:
        return robot
    *others, last = robot.links
    return dataclasses.replace(robot, links=(*others, fixed_together([last, payload])))


def inverse_dynamics(
    robot: Manipulator,
    position: Float[np.ndarray, "samples joints"],
    velocity: Float[np.ndarray, "samples joints"],
    acceleration: Float[np.ndarray, "samples joints"],
) -> tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples joints joints"]]:
    """Return torques and mass matrices of the links, without motors and friction."""
    torque = np.empty(position.shape)
    mass = np.empty((*position.shape, position.shape[1]))
    _function("inverse_dynamics")(
        *_arm(robot).arguments, position, velocity, acceleration, torque, mass, *position.shape
    )
    return torque, mass


def drive_rows(drives: Sequence[ServoDrive]) -> Float[np.ndarray, "joints parameters"]:
    """Return the drives' parameters as C takes them."""
    return np.array([astuple(drive) for drive in drives], float).reshape(-1, len(DRIVE_UNITS))


def substeps(time: Float[np.ndarray, " samples"], longest: float) -> int:
    """Return the number of steps in an interval between samples."""
    return max(1, int(np.ceil(float(np.median(np.diff(time))) / longest - 1e-9)))


def command_integral(
    time: Float[np.ndarray, " samples"], command: Float[np.ndarray, "*columns"]
) -> Float[np.ndarray, "*columns"]:
    """Return the time integral of a held command."""
    steps = np.diff(time).reshape(-1, *[1] * (command.ndim - 1)) * command[:-1]
    return np.concatenate([np.zeros_like(command[:1]), np.cumsum(steps, axis=0)])


def simulate(
    robot: Manipulator,
    drives: Sequence[ServoDrive],
    time: ArrayLike,
    command: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike | None = None,
    *,
    longest_step: float | None = None,
) -> Float[np.ndarray, "samples joints"]:
    """Simulate an arm of servos open loop: readings of its encoders for a commanded motion.

    Readings are not rounded. The command is held between samples. Before the first sample it has
    the first sample's value.

    **Arguments**

    - `robot`: its links with masses.
    - `drives`: one per joint.
    - `time`: instants of the samples, shape `(samples,)` [s].
    - `command`: commanded positions, shape `(samples, joints)` [rad or m].
    - `position`: readings at the first sample, shape `(joints,)` [rad or m].
    - `velocity`: at the first sample, shape `(joints,)`; zero if omitted [rad/s or m/s].
    - `longest_step`: of the integration [s]; by default `LONGEST_STEP`, and 0.5 ms for gears with
      play.

    **Returns** positions, shape `(samples, joints)`.

    **Raises**

    - `RobotError`: a robot without masses.
    - `ValueError`: shapes that disagree, or a joint without armature where the gear has play.
    - `OSError`: no C compiler.

    >>> import dataclasses
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import LinkParameters
    >>> from jaxcslc.servo import ServoDrive, simulate
    >>> rod = LinkParameters(1.0, np.array([0.2, 0.0, 0.0]), 0.01 * np.eye(3))
    >>> arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    >>> drive = ServoDrive(gain=50.0, damping=5.0, armature=0.1, coulomb=0.2)
    >>> time = np.linspace(0.0, 2.0, 101)
    >>> position = simulate(arm, [drive], time, np.full((101, 1), 0.5), [0.0])
    >>> bool(0.4 < position[-1, 0] < 0.5)  # the rod's weight
    True
    """
    times, commands = as_float("time", time, 1), as_float("command", command, 2)
    joints = robot.joint_count
    if len(drives) != joints:
        raise ValueError(f"{len(drives)} drives; expected {joints}, one per joint")
    if commands.shape != (times.size, joints):
        raise ValueError(f"command has shape {commands.shape}; expected ({times.size}, {joints})")
    start = np.zeros((2, joints))
    start[0] = position
    if velocity is not None:
        start[1] = velocity
    for i, drive in enumerate(drives, start=1):
        if drive.play > 0.0 and drive.armature == 0.0:
            raise ValueError(f"joint {i}: a gear with play needs an armature above 0")
    if longest_step is None:
        longest_step = _STEP_WITH_PLAY if any(drive.play for drive in drives) else LONGEST_STEP
    out = np.empty((times.size, joints))
    _function("simulate_arm")(
        *_arm(robot).arguments,
        drive_rows(drives),
        times,
        commands,
        command_integral(times, commands),
        start,
        out,
        times.size,
        joints,
        substeps(times, longest_step),
        _SWEEPS,
        _TOLERANCE,
    )
    return out


@dataclass(frozen=True)
class JointLoads:
    """Load and inertia of one joint while the other joints move in a given way.

    The torque of the links is `torque[:, 0] + torque[:, 1] * cos(q) + torque[:, 2] * sin(q)` for
    position q of the joint: gravity on a turning joint is sinusoidal in its own position. The
    torque of the other joints' accelerations comes on top.

    **Attributes**

    - `torque`: shape `(samples, 4)`, the last column of the other joints' accelerations [N m].
    - `inertia`: of the links that the joint moves [kg m²]; it does not depend on q.
    """

    torque: Float[np.ndarray, "samples 4"]
    inertia: Float[np.ndarray, " samples"]

    def torque_at(self, q: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Return the torque of the links where the joint has position q."""
        a, b, c, d = self.torque.T
        return a + b * np.cos(q) + c * np.sin(q) + d

    def scaled(self, factor: float) -> "JointLoads":
        """Return the loads of links whose masses are multiplied by `factor`."""
        return JointLoads(factor * self.torque, factor * self.inertia)

    def less(self, other: "JointLoads") -> "JointLoads":
        """Return the difference of two loads, which is that of their bodies."""
        return JointLoads(self.torque - other.torque, self.inertia - other.inertia)


def joint_loads(
    robot: Manipulator,
    position: Float[np.ndarray, "samples joints"],
    velocity: Float[np.ndarray, "samples joints"],
    acceleration: Float[np.ndarray, "samples joints"],
) -> list[JointLoads]:
    """Return the loads of every joint, the others moving as given."""
    zero = np.zeros_like(position)
    total, mass = inverse_dynamics(robot, position, velocity, acceleration)
    gravity, _ = inverse_dynamics(robot, position, zero, zero)
    loads: list[JointLoads] = []
    for i, kind in enumerate(robot.kinds):
        inertia = np.ascontiguousarray(mass[:, i, i])
        accelerated = np.einsum("sj,sj->s", mass[:, i], acceleration)
        torque = np.zeros((position.shape[0], 4))
        torque[:, 0] = total[:, i] - accelerated
        torque[:, 3] = accelerated - inertia * acceleration[:, i]
        if kind == "R":
            turned = position.copy()
            turned[:, i] += 0.5 * np.pi
            quarter = inverse_dynamics(robot, turned, zero, zero)[0][:, i]
            c, s = np.cos(position[:, i]), np.sin(position[:, i])
            torque[:, 1] = gravity[:, i] * c - quarter * s
            torque[:, 2] = gravity[:, i] * s + quarter * c
            torque[:, 0] -= gravity[:, i]
        loads.append(JointLoads(torque, inertia))
    return loads


def simulate_joint(
    loads: JointLoads,
    rows: Float[np.ndarray, "sets parameters"],
    time: Float[np.ndarray, " samples"],
    command: Float[np.ndarray, " samples"],
    start: Float[np.ndarray, "2"],
    *,
    longest_step: float = LONGEST_STEP,
) -> Float[np.ndarray, "sets samples"]:
    """Simulate one joint for several sets of parameters, as `simulate` does.

    - `rows`: parameters in the order of `ServoDrive`.
    - `start`: reading and velocity at the first sample.
    """
    out = np.empty((len(rows), time.size))
    _function("simulate_joint")(
        time,
        command,
        command_integral(time, command),
        loads.inertia,
        loads.torque,
        rows,
        start,
        out,
        time.size,
        len(rows),
        substeps(time, longest_step),
    )
    return out

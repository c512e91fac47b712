"""Simulation of servo arms: positions from commands, and loads of one joint of a moving arm.

`joint.c` has the equations of a servo's joint, `arm.c` those of joints that links couple. Equations
of the links are the network's recursion, as C of each robot. `simulate` moves a whole arm.
`JointLoads` has the torques and inertias that a joint carries while the others move as recorded,
for `_fit`.
"""

import ctypes
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from functools import cache, lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..bodies import bodies_of
from ..codegen import LONG, CArray, CFunction, KernelText, Motion
from ..derivation import BODY
from ..manipulator import Joint, LinkParameters, Manipulator, RobotError, fixed_together
from ..network import newton_euler
from ..recordings import as_float
from ._drive import DRIVE_UNITS, ServoDrive
from ._table import Table


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


# Torques and the mass matrix of links: from ten numbers of each, as `BODY`, and a motion.
_RIGID_BODIES = """typedef double real;

static void rigid_bodies(const double *body, const double *q, const double *qd, const double *qdd,
                         double *torque, double *mass) {{
{statements}
}}
"""


def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text("utf-8")


@lru_cache(maxsize=32)
def _arm_text(
    joints: tuple[Joint, ...], parents: tuple[int, ...], gravity: tuple[float, float, float]
) -> str:
    """Return C of a robot: the recursion over its links' expressions, its drives, and both."""
    motion, none = Motion(len(joints)), [0.0] * len(joints)
    recursion = newton_euler(motion, joints, parents, gravity)
    numbers = iter(motion.graph.inputs("body", len(BODY) * len(joints)))
    bodies = [list(islice(numbers, len(BODY))) for _ in joints]
    torque = recursion.torque(bodies, none, motion.qd, motion.qdd)
    mass = [x for row in recursion.mass_matrix(bodies, none) for x in row]
    outputs = [
        (value, f"{array}[{i}] = {{0}};")
        for array, values in (("torque", torque), ("mass", mass))
        for i, value in enumerate(motion.values(values))
    ]
    statements = KernelText(motion.graph, lambda x: x.text or None).statements(outputs)
    rigid_bodies = _RIGID_BODIES.format(statements="\n".join(statements))
    return _text("joint.c") + rigid_bodies + _text("arm.c")


@cache
def _joint_function() -> CFunction:
    arguments = (
        *[_COLUMN] * 4,
        CArray("samples four"),
        CArray("sets parameters"),
        CArray("two"),
        CArray("sets samples", written=True),
        *[LONG] * 3,
    )
    return CFunction(_text("joint.c"), "simulate_joint", arguments)


_OF_ARM: dict[str, tuple[Any, ...]] = {
    "simulate_arm": (
        CArray("joints body"),
        CArray("joints parameters"),
        _COLUMN,
        _STATES,
        _STATES,
        CArray("two joints"),
        CArray("joints body"),
        ctypes.c_double,
        CArray("samples joints", written=True),
        *[LONG] * 4,
        ctypes.c_double,
    ),
    "inverse_dynamics": (
        CArray("joints body"),
        *[_STATES] * 3,
        CArray("samples joints", written=True),
        CArray("samples joints joints", written=True),
        LONG,
        LONG,
    ),
}


def _arm_function(name: str, robot: Manipulator) -> Callable[..., None]:
    """Return a C function of a robot, its bodies passed.

    **Raises** `RobotError` for a robot without masses or lengths.
    """
    if robot.links is None:
        raise RobotError(
            f"robot {robot.name!r} has no masses; expected mass, centre and inertia of each link"
        )
    robot.length_values()  # says which has none
    source = _arm_text(robot.joints, tuple(robot.parents), tuple(robot.gravity))
    return CFunction(source, name, _OF_ARM[name]).bound(bodies_of(robot.links))


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
    _arm_function("inverse_dynamics", robot)(
        position, velocity, acceleration, torque, mass, *position.shape
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
    table: Table | None = None,
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
    - `table`: on which the hand may lean. A hand that begins below it does not go lower.
    - `longest_step`: of the integration [s]; by default `LONGEST_STEP`, and 0.5 ms for gears with
      play.

    **Returns** positions, shape `(samples, joints)`.

    **Raises**

    - `RobotError`: a robot without masses, or a table that does not fit it.
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
    point, height = np.zeros((joints, len(BODY))), np.inf
    if table is not None:
        point = table.weight(robot)
        # A recording that begins below was made on a lower table.
        readings = start[:1] - [drive.offset for drive in drives]
        height = max(0.0, float(table.heights(robot, readings)[0]))
    out = np.empty((times.size, joints))
    _arm_function("simulate_arm", robot)(
        drive_rows(drives),
        times,
        commands,
        command_integral(times, commands),
        start,
        point,
        height,
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
    _joint_function()(
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

"""MuJoCo models of arms of position servos, and replay of recorded commands in MuJoCo.

The file is the robot's, with the drives of a fit; read with `_drive` and `_recording`.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._scratch import unfinished
from ..manipulator import Manipulator, RobotError, mujoco_spec
from ._drive import ServoDrive
from ._recording import ServoRecording
from ._simulation import inverse_dynamics, simulate
from ._table import Table


TIMESTEP = 0.001
"""Time step of the models [s]: a twentieth of the usual interval of commands."""

# MuJoCo's Coulomb friction is a constraint that gives way: a joint that rests under a load creeps.
# With the largest impedance that MuJoCo allows, 0.9999, it creeps by some 0.1 mrad/s.
_IMPEDANCE = 0.9999
# Smallest time constant of constraints that MuJoCo allows, in time steps (`refsafe`).
_STIFFEST = 2.0
# For what MuJoCo has not: a part of the largest plausible friction, and of the drive's damping.
# Where their search starts, their bounds, steps of differences, and iterations. Steps are large:
# friction makes positions rough.
_START, _LOWEST, _HIGHEST = np.array([0.5, 0.85]), np.array([0.0, 0.5]), np.array([1.5, 1.0])
_STEPS, _ITERATIONS = np.array([0.2, -0.1]), 3
_MATCHED = 40.0  # s of recordings, over which they are compared
_CONTACT = 0.001  # radius of the sphere that leans on the table [m]
_RADIUS = 0.008  # of the rods that show links, with which nothing collides [m]


@dataclass(frozen=True)
class WrittenServoArm:
    """A MuJoCo model of an arm of servos.

    **Attributes**

    - `path`: of the MJCF file.
    - `approximations`: what the file cannot express as the drives have it, a sentence each.

    >>> from pathlib import Path
    >>> from jaxcslc.servo import WrittenServoArm
    >>> WrittenServoArm(Path("arm.xml")).approximations
    ()
    """

    path: Path
    approximations: tuple[str, ...] = ()


def write_servo_mjcf(
    robot: Manipulator,
    drives: Sequence[ServoDrive],
    path: str | Path,
    *,
    recordings: Sequence[ServoRecording] = (),
    table: Table | None = None,
) -> WrittenServoArm:
    """Write a MuJoCo model of an arm whose `ctrl` are the commands that its servos get.

    Joint positions of the model are readings of the encoders: `ref` of each joint is the drive's
    offset. Plain MuJoCo replays a recorded command: `ctrl` is the command, `qpos` the reading.

    | drive | MJCF |
    |---|---|
    | gain, damping | `kp`, `kv` of `<position>`; with an integral, `<pid>` with `ki` |
    | delay | `delay` and `nsample` |
    | torque limit | `forcerange` |
    | armature, viscous, Coulomb friction | `armature`, `damping`, `frictionloss` of the joint |
    | offset | `ref` of the joint |
    | ends of travel | `range` of the joint |
    | table | a plane, and a sphere at the point that may lean on it |

    MuJoCo has no dead zone of servos, no static friction above Coulomb friction, and no friction
    that depends on load. For them, `frictionloss` is larger than Coulomb friction and `kv` smaller
    than damping: by as much as moves the model most nearly as `simulate` does under the commands
    of `recordings`. Without recordings they are omitted, as play and a speed limit are.
    `approximations` says so where it applies.

    **Arguments**

    - `robot`: read from a URDF or MJCF file. Its meshes are not in the model.
    - `drives`: one per joint of the robot.
    - `path`: of the file to write, ending in `.xml`.
    - `recordings`: recordings of the arm; ranges of joints include their positions. Of all
      together, up to 40 s are simulated.
    - `table`: on which the hand may lean.

    **Returns** the file, and what is approximated in it.

    **Raises**

    - `RobotError`: a robot from no such file, or another number of drives.
    - `MissingExtraError`: without MuJoCo (the extra `urdf`).

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> from jaxcslc.servo import ServoDrive, write_servo_mjcf
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     example = jc.examples.write_example("panda", folder)
    ...     robot = jc.load_robot(example.robot)
    ...     drives = [ServoDrive(gain=100.0, damping=5.0, delay=0.03)] * robot.joint_count
    ...     written = write_servo_mjcf(robot, drives, Path(folder) / "servos.xml")
    ...     text = written.path.read_text()
    >>> "kp=" in text, "delay=" in text
    (True, True)
    """
    mujoco: Any = require("mujoco", "urdf")
    path = Path(path)
    if len(drives) != robot.joint_count:
        raise RobotError(f"{len(drives)} drives; expected {robot.joint_count}, one per joint")
    spec = mujoco_spec(robot)
    assert robot.source is not None
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    joints = [next(j for j in spec.joints if j.name == name) for name in robot.source.joints]
    for joint, drive in zip(joints, drives, strict=True):
        joint.ref = float(joint.ref) + drive.offset
    limits = robot.source.limits
    for j, (joint, drive) in enumerate(zip(joints, drives, strict=True)):
        joint.armature = drive.armature
        _set_linear(joint, "damping", drive.viscous)
        joint.frictionloss = drive.coulomb
        joint.solref_friction[:] = _STIFFEST * TIMESTEP, 1.0
        joint.solimp_friction[:] = _IMPEDANCE, _IMPEDANCE, 1e-3, 0.5, 2.0
        low, high = drive.low, drive.high
        if limits and math.isinf(low):
            low = limits[j].low + drive.offset
        if limits and math.isinf(high):
            high = limits[j].high + drive.offset
        for recording in recordings:
            low = min(low, float(np.min(recording.position[:, j])))
            high = max(high, float(np.max(recording.position[:, j])))
        finite = math.isfinite(low) and math.isfinite(high)
        joint.limited = finite
        if finite:
            joint.range[:] = low, high
            joint.solref_limit[:] = _STIFFEST * TIMESTEP, 1.0
            joint.solimp_limit[:] = 0.99, _IMPEDANCE, 1e-3, 0.5, 2.0
        joint.actfrclimited = False  # the drive's limit is the servo's
    _show(mujoco, spec)
    if table is not None:
        _add_table(mujoco, spec, robot, table)
    try:
        text = _text(spec, robot.source.joints, drives)
        expressed = _expressible(mujoco, text, robot, drives, recordings, table)
        for joint, drive in zip(joints, expressed, strict=True):
            joint.frictionloss = drive.coulomb
            _set_linear(joint, "damping", drive.viscous)
        text = _text(spec, robot.source.joints, expressed)
    except ValueError as error:
        raise RobotError(f"{path}: {' '.join(str(error).split())}") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    with unfinished(path) as file:
        file.write_text(text, encoding="utf-8")
    approximations = _approximations(robot.source.joints, drives, bool(recordings))
    return WrittenServoArm(path, approximations)


def replay_in_mujoco(
    path: str | Path, recording: ServoRecording
) -> Float[np.ndarray, "samples joints"]:
    """Replay a recorded command in plain MuJoCo, open loop from the first measured position.

    **Arguments**

    - `path`: of a model of `write_servo_mjcf`.
    - `recording`: its commands are applied, each held to the next sample.

    **Returns** simulated readings at the recording's times [rad or m].

    **Raises**

    - `RobotError`: a model that MuJoCo cannot read, or of another number of joints.
    - `MissingExtraError`: without MuJoCo (the extra `urdf`).

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> from jaxcslc.servo import ServoDrive, ServoRecording, replay_in_mujoco, write_servo_mjcf
    >>> time = np.arange(50) * 0.02
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     robot = jc.load_robot(jc.examples.write_example("panda", folder).robot)
    ...     drives = [ServoDrive(gain=1e4, damping=300.0)] * robot.joint_count
    ...     written = write_servo_mjcf(robot, drives, Path(folder) / "servos.xml")
    ...     command = np.tile([0.1, 0.2, 0.0, -1.0, 0.0, 1.0, 0.3], (50, 1))
    ...     replayed = replay_in_mujoco(written.path, ServoRecording(time, command, command))
    >>> bool(np.max(np.abs(replayed - command)) < 0.01)
    True
    """
    mujoco: Any = require("mujoco", "urdf")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise RobotError(f"{path}: {' '.join(str(error).split())}") from None
    if model.nu != recording.joints:
        raise RobotError(f"{path}: {model.nu} servos; the recording has {recording.joints} joints")
    return _replayed(mujoco, model, recording)


def _replayed(
    mujoco: Any, model: Any, recording: ServoRecording
) -> Float[np.ndarray, "samples joints"]:
    data = mujoco.MjData(model)
    addresses = [int(model.jnt_qposadr[model.actuator_trnid[i, 0]]) for i in range(model.nu)]
    data.qpos[addresses] = recording.position[0]
    data.ctrl[:] = recording.command[0]
    for i in range(model.nu):
        if samples := int(model.actuator_history[i, 0]):  # until now the first command held
            held = np.full(samples, recording.command[0, i])
            mujoco.mj_initCtrlHistory(model, data, i, None, held)
    time = recording.time - recording.time[0]
    positions = np.empty_like(recording.position)
    for sample, command in enumerate(recording.command):
        while data.time < time[sample] - 0.5 * model.opt.timestep:
            mujoco.mj_step(model, data)
        positions[sample] = data.qpos[addresses]
        data.ctrl[:] = command
    return positions


def _set_linear(element: Any, name: str, value: float) -> None:
    """Set a coefficient, which may stand first among those of higher powers."""
    stated = getattr(element, name)
    if np.ndim(stated):
        stated[:] = 0.0
        stated[0] = value
    else:
        setattr(element, name, value)


def _servo_element(joint: str, drive: ServoDrive) -> str:
    """Return the element of a servo."""
    element = "pid" if drive.integral else "position"
    attributes: dict[str, str | float] = {
        "name": joint,
        "joint": joint,
        "kp": drive.gain,
        "kv": drive.damping,
    }
    if drive.integral:
        attributes |= {"ki": drive.integral, "input": "pos"}
    if math.isfinite(drive.torque_limit):
        attributes["forcerange"] = f"{-drive.torque_limit:.9g} {drive.torque_limit:.9g}"
    if drive.delay > 0.0:
        attributes |= {"delay": drive.delay, "nsample": math.ceil(drive.delay / TIMESTEP)}
    written = (
        f"{name}={quoteattr(value if isinstance(value, str) else f'{value:.9g}')}"
        for name, value in attributes.items()
    )
    return f"    <{element} {' '.join(written)}/>\n"


def _text(spec: Any, joints: Sequence[str], drives: Sequence[ServoDrive]) -> str:
    """Return the MJCF of a model with its servos.

    They are written as text: MuJoCo would write their general form, which is hard to read.
    """
    spec.compile()
    head, end, tail = spec.to_xml().rpartition("</mujoco>")
    servos = "".join(map(_servo_element, joints, drives))
    return f"{head}\n  <actuator>\n{servos}  </actuator>\n{end}{tail}"


def _expressible(
    mujoco: Any,
    text: str,
    robot: Manipulator,
    drives: Sequence[ServoDrive],
    recordings: Sequence[ServoRecording],
    table: Table | None,
) -> list[ServoDrive]:
    """Return drives with other Coulomb friction and damping, for what MuJoCo has not.

    Static friction is friction that falls with velocity: a larger Coulomb friction and less damping
    come near it. The search is that of Gauss and Newton for each joint, with the changes of all
    joints in one replay: coupling between joints changes little of what suits one best.
    """
    largest = np.array([d.static + d.gain * d.dead_zone for d in drives])
    loaded = np.array([d.load_friction for d in drives])
    if not recordings or not np.any(largest + loaded):
        return list(drives)
    parts = [x.between(0.0, _MATCHED / len(recordings)) for x in recordings]
    if np.any(loaded):
        q = np.concatenate([x.position for x in parts]) - [d.offset for d in drives]
        gravity, _ = inverse_dynamics(robot, q, np.zeros_like(q), np.zeros_like(q))
        largest = largest + loaded * np.mean(np.abs(gravity), axis=0)
    goals = [simulate(robot, drives, x.time, x.command, x.position[0], table=table) for x in parts]
    model = mujoco.MjModel.from_xml_string(text)
    dofs = [int(model.jnt_dofadr[model.actuator_trnid[i, 0]]) for i in range(model.nu)]

    def changed(x: Float[np.ndarray, "joints 2"]) -> list[ServoDrive]:
        changes = zip(drives, (x[:, 0] * largest).tolist(), x[:, 1].tolist(), strict=True)
        return [
            dataclasses.replace(
                d,
                coulomb=d.coulomb + more,
                damping=d.damping * less,
                viscous=d.viscous * less,
            )
            if limit
            else d
            for (d, more, less), limit in zip(changes, largest > 0.0, strict=True)
        ]

    def differences(x: Float[np.ndarray, "joints 2"]) -> Float[np.ndarray, "samples joints"]:
        tried = changed(x)
        model.dof_frictionloss[dofs] = [d.coulomb for d in tried]
        model.dof_damping[dofs] = [d.viscous for d in tried]
        model.actuator_biasprm[:, 2] = [-d.damping for d in tried]
        pairs = zip(parts, goals, strict=True)
        return np.concatenate([_replayed(mujoco, model, x) - goal for x, goal in pairs])

    best = x = np.tile(_START, (len(drives), 1))
    found = r = differences(x)
    for _ in range(_ITERATIONS):
        sides = [(differences(x + step) - r) / step.sum() for step in np.diag(_STEPS)]
        J = np.stack(sides, axis=2)
        x = x - np.stack([np.linalg.lstsq(J[:, i], r[:, i])[0] for i in range(len(x))])
        x = np.clip(x, _LOWEST, _HIGHEST)
        r = differences(x)
        better = np.sum(r**2, axis=0) < np.sum(found**2, axis=0)
        best, found = np.where(better[:, None], x, best), np.where(better, r, found)
        x, r = best, found
    return changed(best)


def _approximations(
    joints: Sequence[str], drives: Sequence[ServoDrive], has_recordings: bool
) -> tuple[str, ...]:
    """Return what MuJoCo has not as the drives have it, and of which joints."""
    instead = "frictionloss and kv stand for it" if has_recordings else "omitted"
    kinds: dict[str, Callable[[ServoDrive], bool]] = {
        f"dead zone: {instead}": lambda drive: drive.dead_zone > 0.0,
        f"static friction: {instead}": lambda drive: drive.static > 0.0,
        f"friction by load: {instead}": lambda drive: drive.load_friction > 0.0,
        "play of the gear: omitted": lambda drive: drive.play > 0.0,
        "the command's derivative: omitted": lambda drive: drive.lead * drive.damping > 0.0,
        "speed limit: omitted": lambda drive: math.isfinite(drive.speed_limit),
    }
    found: list[str] = []
    for sentence, applies in kinds.items():
        names = [name for name, drive in zip(joints, drives, strict=True) if applies(drive)]
        if names:
            found.append(f"{sentence} ({', '.join(names)})")
    return tuple(found)


def _show(mujoco: Any, spec: Any) -> None:
    """Add rods between the bodies' frames, which have no mass and touch nothing."""
    spec.compiler.discardvisual = False
    for body in spec.bodies:
        for child in body.bodies:
            end = np.array(child.pos, float)
            if np.linalg.norm(end) > _RADIUS:
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                    fromto=[0.0, 0.0, 0.0, *end],
                    size=[_RADIUS, 0.0, 0.0],
                    contype=0,
                    conaffinity=0,
                    mass=0.0,
                )


def _add_table(mujoco: Any, spec: Any, robot: Manipulator, table: Table) -> None:
    """Add a plane, and a sphere around the point that may lean on it; nothing else collides."""
    assert robot.source is not None
    bodies = {body.name: body for body in spec.bodies}
    contact = {
        "condim": 1,
        "solref": [_STIFFEST * TIMESTEP, 1.0],
        "solimp": [0.99, _IMPEDANCE, 1e-3, 0.5, 2.0],
        "mass": 0.0,
    }
    up = -np.array(robot.gravity, float) / np.linalg.norm(robot.gravity)
    rotation = np.zeros(4)
    mujoco.mju_quatZ2Vec(rotation, up)
    base = bodies.get(robot.source.base or "", spec.worldbody)
    base.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(table.height - _CONTACT) * up,
        quat=rotation,
        size=[1.0, 1.0, 0.1],
        contype=0,
        conaffinity=1,
        **contact,
    )
    placement = np.linalg.inv(robot.source.placements[table.link])
    bodies[robot.source.links[table.link]].add_geom(
        name="table_contact",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        pos=(placement @ [*table.point, 1.0])[:3],
        size=[_CONTACT, 0.0, 0.0],
        contype=1,
        conaffinity=0,
        **contact,
    )

"""Motion of the base that an arm or legs hang on, from torques that nothing else explains.

The model has a fixed base. If the base accelerates or tilts, every link feels it at once: torques
of many joints, which the drives do not explain, then follow from one acceleration of the base at
each instant. A wrong parameter of a joint has no such pattern.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..checks import Finding
from ..manipulator import Manipulator, link_poses
from ._drive import ServoDrive
from ._recording import ServoRecording
from ._search import MOVING
from ._simulation import inverse_dynamics


_MOST_SAMPLES = 4000
# Joints from which on rotations of the base are sought too, and fewest joints that tell anything:
# two more than there are accelerations.
_WITH_ROTATION, _FEWEST_JOINTS = 8, 5
_EXPLAINED = 0.5  # part of the torques beyond what chance explains, from which on a base moves
_NOTICEABLE = 0.1  # m/s² RMS: 0.6 degrees of tilt


def base_motion(
    robot: Manipulator,
    drives: Sequence[ServoDrive],
    recordings: Sequence[ServoRecording],
    smooth: Sequence[tuple[Float[np.ndarray, "samples joints"], ...]],
) -> Finding | None:
    """Return the evidence if the base moved.

    - `smooth`: position, velocity and acceleration of each recording.
    """
    if robot.joint_count < _FEWEST_JOINTS or robot.links is None:
        return None
    stride = max(1, sum(x.samples for x in recordings) // _MOST_SAMPLES)
    torques: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    for recording, (q, v, a) in zip(recordings, smooth, strict=True):
        rows = slice(None, None, stride)
        late = _late(recording, drives)[rows]
        motion = [np.ascontiguousarray(x[rows]) for x in (q, v, a)]
        torques.append(_unexplained(robot, drives, late, *motion))
        offsets = np.array([drive.offset for drive in drives])
        columns.append(_felt(robot, motion[0] - offsets))
    torque, A = np.concatenate(torques), np.concatenate(columns)
    size = np.sqrt(np.nanmean(torque**2, axis=0))
    if not np.all(size > 0.0):
        return None
    explained = total = chance = 0.0
    accelerations: list[np.ndarray] = []
    count = A.shape[2]
    for row, columns_now in zip(torque / size, A / size[:, None], strict=True):
        known = np.isfinite(row)
        if np.sum(known) < count + 2:
            continue
        found, _, rank, _ = np.linalg.lstsq(columns_now[known], row[known], rcond=1e-6)
        squares = float(row[known] @ row[known])
        explained += float(row[known] @ (columns_now[known] @ found))
        chance += squares * rank / np.sum(known)
        total += squares
        accelerations.append(found[:3])
    if len(accelerations) < _MOST_SAMPLES // 40:
        return None
    part = (explained - chance) / (total - chance)
    # A wrong mass looks like a constant acceleration.
    felt = math.sqrt(float(np.sum(np.var(np.array(accelerations), axis=0))))
    if part < _EXPLAINED or felt < _NOTICEABLE:
        return None
    return Finding(
        "base",
        "",
        f"one acceleration of the base, {felt:.1g} m/s² RMS, explains {100.0 * part:.0f} % of the"
        " torque that the drives do not",
        "the base moves, and the model has a fixed one",
        "clamp it, or move fewer joints at a time, and record again",
    )


def _late(
    recording: ServoRecording, drives: Sequence[ServoDrive]
) -> Float[np.ndarray, "samples joints"]:
    time = recording.time
    columns = [
        np.interp(time - drive.delay, time, command)
        for drive, command in zip(drives, recording.command.T, strict=True)
    ]
    return np.stack(columns, axis=1)


def _unexplained(
    robot: Manipulator,
    drives: Sequence[ServoDrive],
    late: Float[np.ndarray, "samples joints"],
    q: Float[np.ndarray, "samples joints"],
    v: Float[np.ndarray, "samples joints"],
    a: Float[np.ndarray, "samples joints"],
) -> Float[np.ndarray, "samples joints"]:
    """Return the servos' torques minus those of links, motors and friction; NaN at rest."""
    offsets = np.array([drive.offset for drive in drives])
    links = inverse_dynamics(robot, q - offsets, v, a)[0]
    torque = np.empty_like(q)
    for i, drive in enumerate(drives):
        error = late[:, i] - q[:, i]
        error = np.sign(error) * np.maximum(np.abs(error) - drive.dead_zone, 0.0)
        friction = drive.coulomb + drive.load_friction * np.abs(links[:, i])
        torque[:, i] = (
            drive.gain * error
            - (drive.damping + drive.viscous) * v[:, i]
            - drive.armature * a[:, i]
            - friction * np.sign(v[:, i])
            - links[:, i]
        )
    return np.where(np.abs(v) > MOVING, torque, np.nan)


def _felt(
    robot: Manipulator, q: Float[np.ndarray, "samples joints"]
) -> Float[np.ndarray, "samples joints accelerations"]:
    """Return torques per acceleration of the base: along three axes, and about them.

    Links count as points at their centres.
    """
    assert robot.links is not None
    poses = np.asarray(link_poses(robot, q))
    axes, origins = poses[..., :3, 2], poses[..., :3, 3]
    count = 6 if robot.joint_count >= _WITH_ROTATION else 3
    found = np.zeros((*q.shape, count))
    for link, body in enumerate(robot.links):
        centre = poses[:, link, :3, :3] @ np.asarray(body.centre_of_gravity, float)
        centre += origins[:, link]
        joint = link
        while joint >= 0:
            arm = centre - origins[:, joint]
            slides = robot.kinds[joint] == "P"
            lever = axes[:, joint] if slides else np.cross(axes[:, joint], arm)
            found[:, joint, :3] += body.mass * lever
            if count == 6:  # lever . (e x centre) = e . (centre x lever)
                found[:, joint, 3:] += body.mass * np.cross(centre, lever)
            joint = robot.parents[joint]
    return found

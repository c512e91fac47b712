"""Errors of a robot file's lengths and axes: the torque that small ones add, and other axes.

Torque is linear in ten inertial parameters of each link, whatever the lengths: Newton and Euler's
equations in the frames of the modified Denavit-Hartenberg parameters (`manipulator`).
`_first_order` takes the columns of small errors, and `_model_findings` names them. `axis_causes`
tries whole other axes.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..manipulator import Length, Manipulator
from ..network import CSLC
from ._causes import LEAST_GAIN, Cause, removes
from ._evidence import LARGEST_ERROR, SMALLEST_ERROR, Evidence
from ._findings import finding


_STEP = 1e-4  # of finite differences [m or rad]
_TOLERANCE = 1e-10  # of singular values that count: parameters that no motion shows are none
_FOLDS, _MOST_ROWS = 5, 1000  # of the search for axes
_Z = np.array([0.0, 0.0, 1.0])
_CHANGED = "changed"  # name of a length that the file has as zero

Samples3 = Float[np.ndarray, "samples 3"]


class GeometryError(NamedTuple):
    """A length or an angle of the robot's file that may be wrong.

    - `joint`: whose row of parameters, from 0.
    - `parameter`: `"a"`, `"d"` or `"alpha"`.
    """

    joint: int
    parameter: str

    @property
    def is_angle(self) -> bool:
        """Whether it is in rad."""
        return self.parameter == "alpha"

    def described(self, names: Sequence[str], parent: int, size: float) -> str:
        """Return the error in words; `size` is what the arm has more than the file [m or rad]."""
        more = "more" if size > 0 else "less"
        shown = f"{np.degrees(abs(size)):.2g}°" if self.is_angle else f"{100 * abs(size):.2g} cm"
        own, before = names[self.joint], names[parent]
        what = {
            "a": f"the distance between the axes of {before} and {own} is {shown} {more}",
            "d": f"the offset along the axis of {own} is {shown} {more}",
            "alpha": f"the angle between the axes of {before} and {own} is {shown} {more}",
        }
        return what[self.parameter]

    def robot(self, robot: Manipulator, size: float) -> Manipulator:
        """Return the robot with the error [m or rad] added to its file's value."""
        joint = robot.joints[self.joint]
        old = getattr(joint, self.parameter)
        if self.is_angle:
            new = old + size
        else:
            # A name of its own for what was zero: that of its row may be another length's.
            name = _CHANGED if old.is_zero else old.symbol
            new = Length(float(old.value or 0.0) + size, name)
        joints = list(robot.joints)
        joints[self.joint] = dataclasses.replace(joint, **{self.parameter: new})
        return dataclasses.replace(robot, joints=tuple(joints), numbering=None)


def geometry_errors(network: CSLC) -> list[GeometryError]:
    """Return the lengths and angles between two joints; none of robots whose joints follow others.

    Those of the first joint place the base, which no torque shows.
    """
    robot = network.robot
    if network.joint_count != robot.joint_count or not robot.has_all_lengths:
        return []
    return [
        GeometryError(joint, parameter)
        for joint, parent in enumerate(robot.parents)
        if parent >= 0
        for parameter in ("a", "d", "alpha")
        if parameter != "d" or robot.kinds[joint] == "R"
    ]


def geometry_columns(
    network: CSLC,
    motion: Sequence[Float[np.ndarray, "samples joints"]],
    torque: Float[np.ndarray, "samples joints"],
) -> Float[np.ndarray, "samples joints errors"]:
    """Return the torque that a unit of each of `geometry_errors` adds.

    Up to what other inertial parameters make up for, it does not depend on which of the parameters
    that explain the torque are taken.

    - `motion`: positions, velocities and accelerations.
    - `torque`: of rigid bodies, by a fit to the file's geometry.
    """
    robot, errors = network.robot, geometry_errors(network)
    if not errors:
        return np.zeros((*torque.shape, 0))
    nominal = body_regressor(robot, *motion)
    rows = nominal.reshape(-1, nominal.shape[-1])
    scale = np.maximum(np.sqrt(np.mean(rows**2, axis=0)), 1e-12)
    # Of the normal equations: their eigenvalues are squares of singular values.
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), _TOLERANCE, hermitian=True)
    parameters = inverse @ ((rows / scale).T @ torque.ravel()) / scale
    columns = [
        (body_regressor(error.robot(robot, _STEP), *motion) - nominal) @ parameters / _STEP
        for error in errors
    ]
    return np.stack(columns, axis=-1)


def axis_causes(evidence: Evidence) -> list[Cause]:
    """Return the revolute joint that turns about another axis than the file's, if one does.

    The others that are tried are x and y of the frame that the joint turns, at its zero position,
    both ways; -z is a sign. Lengths and axes are tried by the equations of `body_regressor`, with
    the friction of the network.
    """
    network, robot = evidence.network, evidence.network.robot
    if network.joint_count != robot.joint_count or not robot.has_all_lengths:
        return []
    before = _errors_about(evidence, [_Z] * robot.joint_count)
    causes: list[Cause] = []
    for joint in np.flatnonzero([kind == "R" for kind in robot.kinds]).tolist():
        for axis in np.eye(3)[:2]:
            for sign in (1.0, -1.0):
                axes = [_Z] * robot.joint_count
                axes[joint] = sign * axis
                after = _errors_about(evidence, axes)
                gain = float(np.mean(np.log(before / after)))
                if gain < LEAST_GAIN or not removes(before, after, evidence.noise):
                    continue
                worst, own = int(np.argmax(before / after)), network.output_names[joint]
                text = (
                    f"torque errors are {100 * before[worst]:.3g} % of the torque of"
                    f" {network.output_names[worst]}, and {100 * after[worst]:.3g} % if {own} turns"
                    " about an axis at right angles to the file's"
                )
                causes.append(Cause(finding("axis", text, own, joint=own), gain, lambda: None))
    return causes


def _errors_about(
    evidence: Evidence, axes: Sequence[Float[np.ndarray, "3"]]
) -> Float[np.ndarray, " joints"]:
    """Return the held-out error of each joint, as part of its torque, if joints turn about axes."""
    network, patterns = evidence.network, evidence.patterns
    step = -(-patterns.samples // _MOST_ROWS)
    rows = slice(None, None, step)
    q, qd, qdd = (np.asarray(x)[rows] for x in (patterns.q, patterns.qd, patterns.qdd))
    torque, mask = np.asarray(patterns.torque)[rows], np.asarray(patterns.mask)[rows]
    bodies = body_regressor(network.robot, q, qd, qdd, axes=axes)
    size = bodies.shape[-1]
    whole = np.zeros((*torque.shape, size + network.size))
    whole[..., :size] = bodies
    friction = set(np.arange(network.size)[network.layout.friction].tolist())
    of_joints = zip(network.support, evidence.columns(patterns), strict=True)
    for joint, (support, columns) in enumerate(of_joints):
        for index, column in zip(support, columns, strict=True):
            if index in friction:
                whole[:, joint, size + index] = column[rows]
    scale = np.sqrt(np.where(mask, torque**2, 0.0).sum(axis=0) / np.maximum(mask.sum(axis=0), 1))
    weight = np.where(mask & (scale > 0.0), 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    whole, torque = whole * weight[..., None], torque * weight
    used = np.flatnonzero(np.any(whole != 0.0, axis=(0, 1)))
    whole = whole[..., used] / np.sqrt(np.mean(whole[..., used] ** 2, axis=(0, 1)))
    folds = np.arange(len(torque)) * _FOLDS // len(torque)
    parts = [(whole[folds == fold], torque[folds == fold]) for fold in range(_FOLDS)]
    normal = np.stack([np.einsum("sjp,sjq->pq", x, x, optimize=True) for x, _ in parts])
    right = np.stack([np.einsum("sjp,sj->p", x, y) for x, y in parts])
    squares = np.zeros(torque.shape[1])
    for fold, (x, y) in enumerate(parts):
        inverse = np.linalg.pinv(normal.sum(axis=0) - normal[fold], _TOLERANCE, hermitian=True)
        squares += np.sum((y - x @ (inverse @ (right.sum(axis=0) - right[fold]))) ** 2, axis=0)
    errors = np.sqrt(squares / np.maximum(mask.sum(axis=0), 1))
    return np.clip(errors, SMALLEST_ERROR, LARGEST_ERROR)


def body_regressor(
    robot: Manipulator,
    q: Float[np.ndarray, "samples joints"],
    qd: Float[np.ndarray, "samples joints"],
    qdd: Float[np.ndarray, "samples joints"],
    *,
    axes: Sequence[Float[np.ndarray, "3"]] | None = None,
) -> Float[np.ndarray, "samples joints parameters"]:
    """Return torque per unit of each link's mass, first moment and inertia, and motor inertias.

    Inertias are about the origins of links' frames: xx, xy, xz, yy, yz, zz.

    - `axes`: of the joints in their frames at the zero position; z by default.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.examples.pendulum()
    >>> still = np.zeros((1, 1))
    >>> body_regressor(arm, still, still, still + 1.0)[0, 0, [9, 10]].tolist()
    [1.0, 1.0]
    """
    joints = robot.joint_count
    result = np.zeros((*q.shape, 11 * joints))
    turn: list[np.ndarray] = []
    axis: list[Samples3] = []
    place: list[Samples3] = []
    spin: list[Samples3] = []
    spin_rate: list[Samples3] = []
    acceleration: list[Samples3] = []
    nothing = np.zeros((len(q), 3))
    base = (np.broadcast_to(np.eye(3), (len(q), 3, 3)), nothing, nothing, nothing)
    gravity = np.broadcast_to(-np.array(robot.gravity, float), (len(q), 3))
    for i, (joint, parent) in enumerate(zip(robot.joints, robot.parents, strict=True)):
        before = parent >= 0
        turned, origin, w, wd = (
            (turn[parent], place[parent], spin[parent], spin_rate[parent]) if before else base
        )
        accelerated = acceleration[parent] if before else gravity
        own = _Z if axes is None else axes[i]
        revolute = joint.kind == "R"
        fixed = _about(_Z, joint.gamma) @ _about(np.array([1.0, 0.0, 0.0]), joint.alpha)
        carrier = turned @ fixed @ _about(_Z, joint.theta)
        a, d, b = (float(length.value or 0.0) for _, _, length in joint.lengths)
        arm = turned @ (b * _Z + _about(_Z, joint.gamma)[:, 0] * a + d * fixed[:, 2])
        z = carrier @ own
        along = nothing if revolute else q[:, i, None] * z
        arm = arm + along
        speed, rate = qd[:, i, None] * z, qdd[:, i, None] * z
        accelerated = accelerated + np.cross(wd, arm) + np.cross(w, np.cross(w, arm))
        if revolute:
            wd, w = wd + rate + np.cross(w, speed), w + speed
            carrier = carrier @ _about(own, q[:, i])
        else:
            accelerated = accelerated + rate + 2.0 * np.cross(w, speed)
        turn.append(carrier)
        axis.append(z)
        place.append(origin + arm)
        spin.append(w)
        spin_rate.append(wd)
        acceleration.append(accelerated)
        force, moment = _wrench(carrier, w, wd, accelerated)
        carries = i
        while carries >= 0:
            z, back = axis[carries], np.swapaxes(carrier, 1, 2)
            if robot.kinds[carries] == "R":
                lever = np.cross(z, place[i] - place[carries])
                lever, about = (np.einsum("sij,sj->si", back, vector) for vector in (lever, z))
                row = np.einsum("si,sij->sj", about, moment)
                row += np.einsum("si,sij->sj", lever, force)
            else:
                row = np.einsum("si,sij->sj", np.einsum("sij,sj->si", back, z), force)
            result[:, carries, 11 * i : 11 * i + 10] = row
            carries = robot.parents[carries]
        result[:, i, 11 * i + 10] = qdd[:, i]
    return result


def _wrench(
    turn: Float[np.ndarray, "samples 3 3"], spin: Samples3, rate: Samples3, acceleration: Samples3
) -> tuple[Float[np.ndarray, "samples 3 10"], Float[np.ndarray, "samples 3 10"]]:
    """Return force and moment about its origin per parameter of a link, in its frame."""
    w, wd, a = (np.einsum("sji,sj->si", turn, vector) for vector in (spin, rate, acceleration))
    force, moment = np.zeros((len(w), 3, 10)), np.zeros((len(w), 3, 10))
    wx = _crossing(w)
    force[:, :, 0] = a
    force[:, :, 1:4] = _crossing(wd) + wx @ wx
    moment[:, :, 1:4] = -_crossing(a)
    moment[:, :, 4:] = _inertia_times(wd) + wx @ _inertia_times(w)
    return force, moment


def _crossing(vector: Samples3) -> Float[np.ndarray, "samples 3 3"]:
    return np.cross(vector[:, None, :], np.eye(3)).swapaxes(1, 2)


def _inertia_times(vector: Samples3) -> Float[np.ndarray, "samples 3 6"]:
    x, y, z = vector.T
    zero = 0.0 * x
    rows = ((x, y, z, zero, zero, zero), (zero, x, zero, y, z, zero), (zero, zero, x, zero, y, z))
    return np.moveaxis(np.array(rows), -1, 0)


def _about(
    axis: Float[np.ndarray, "3"], angle: float | Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "*samples 3 3"]:
    """Return rotations about a unit vector (Rodrigues)."""
    across = np.cross(axis, np.eye(3)).T
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * across + (1.0 - np.cos(angle)) * (across @ across)

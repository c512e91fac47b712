"""Errors of a robot file's lengths and axes: the torque that small ones add, and other axes.

Torque is linear in ten inertial parameters of each link, whatever the lengths: `body_regressor` has
them all, by Newton and Euler's equations (`derivation`), where a network has base parameters alone.
`_first_order` takes the columns of small errors, and `_model_findings` names them. `axis_causes`
tries whole other axes.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..derivation import BODY, Chain, NewtonEuler, link_frames
from ..manipulator import Axis, Length, Manipulator, link_poses, modified_dh
from ..network import CSLC
from ._evidence import (
    LARGEST_ERROR,
    LEAST_GAIN,
    SMALLEST_ERROR,
    TINY,
    Cause,
    Evidence,
    counted_rms,
    removes,
)
from ._findings import finding


_STEP = 1e-4  # of finite differences [m or rad]: exact to as much, rounding 1e-12
# Of eigenvalues of normal equations that count, 1e-5 of singular values: parameters that no motion
# shows have those of rounding.
_TOLERANCE = 1e-10
_FOLDS, _MOST_ROWS = 5, 1000  # of the search for axes; ten rows for each of a hundred parameters
_CHANGED = "changed"  # name of a length that the file has as zero


class GeometryError(NamedTuple):
    """A length or an angle of the robot's file that may be wrong.

    - `joint`: whose row of parameters, from 0.
    - `parameter`: `"a"`, `"d"` or `"alpha"`.
    """

    joint: int
    parameter: str

    @property
    def is_angle(self) -> bool:
        """Whether the parameter is an angle."""
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

    def is_plausible(self, robot: Manipulator, size: float) -> bool:
        """Return whether an error [m or rad] is less than the longest length of the robot.

        Faults of other kinds pass for errors that are larger than the arm.
        """
        lengths = [x.value or 0.0 for joint in robot.joints for _, _, x in joint.lengths]
        return self.is_angle or abs(size) <= max(abs(float(x)) for x in lengths)

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
    before = _torque_of_bodies(robot, parameters, *motion)
    columns = [
        (_torque_of_bodies(error.robot(robot, _STEP), parameters, *motion) - before) / _STEP
        for error in errors
    ]
    return np.stack(columns, axis=-1)


def axis_causes(evidence: Evidence, least: float) -> list[Cause]:
    """Return the revolute joint that turns about another axis than the file's, if one does.

    The others that are tried are x and y of the frame that the joint turns, at its zero position,
    both ways; -z is a sign. Lengths and axes are tried by the equations of `body_regressor`, with
    the friction of the network. Nothing is looked for behind an axis: it must explain the torque.

    - `least`: error beyond noise, as part of the torque, that matters: an axis leaves less.
    """
    network, robot = evidence.network, evidence.network.robot
    if network.joint_count != robot.joint_count or not robot.has_all_lengths:
        return []
    before = _errors_of(evidence, robot)
    causes: list[Cause] = []
    for joint in np.flatnonzero([kind == "R" for kind in robot.kinds]).tolist():
        for axis in np.eye(3)[:2]:
            for sign in (1.0, -1.0):
                after = _errors_of(evidence, _about(robot, joint, sign * axis))
                gain = float(np.mean(np.log(before / after)))
                if gain < LEAST_GAIN or not removes(before, after, evidence.noise):
                    continue
                if np.any(after**2 - evidence.noise**2 > least**2):
                    continue
                worst, own = int(np.argmax(before / after)), network.output_names[joint]
                text = (
                    f"torque errors are {100 * before[worst]:.3g} % of the torque of"
                    f" {network.output_names[worst]}, and {100 * after[worst]:.3g} % if {own} turns"
                    " about an axis at right angles to the file's"
                )
                causes.append(Cause(finding("axis", text, own, joint=own), gain, lambda: None))
    return causes


def _about(robot: Manipulator, joint: int, along: Float[np.ndarray, "3"]) -> Manipulator:
    """Return the robot with a joint that turns about another axis of its frame at position zero."""
    poses = np.asarray(link_poses(robot, np.zeros(robot.joint_count)))
    axes = [
        Axis(row.kind, parent, pose[:3, 3], pose[:3, 2])
        for row, parent, pose in zip(robot.joints, robot.parents, poses, strict=True)
    ]
    axes[joint] = axes[joint]._replace(direction=poses[joint][:3, :3] @ along)
    return dataclasses.replace(robot, joints=modified_dh(axes)[0], numbering=None)


def _errors_of(evidence: Evidence, robot: Manipulator) -> Float[np.ndarray, " joints"]:
    """Return the held-out error of each joint, as part of its torque, with a robot's geometry."""
    network, patterns = evidence.network, evidence.patterns
    step = -(-patterns.samples // _MOST_ROWS)
    rows = slice(None, None, step)
    q, qd, qdd = (np.asarray(x)[rows] for x in (patterns.q, patterns.qd, patterns.qdd))
    torque, mask = np.asarray(patterns.torque)[rows], np.asarray(patterns.mask)[rows]
    bodies = body_regressor(robot, q, qd, qdd)
    size = bodies.shape[-1]
    whole = np.zeros((*torque.shape, size + network.size))
    whole[..., :size] = bodies
    friction = set(np.arange(network.size)[network.layout.friction].tolist())
    of_joints = zip(network.support, evidence.columns(patterns), strict=True)
    for joint, (support, columns) in enumerate(of_joints):
        for index, column in zip(support, columns, strict=True):
            if index in friction:
                whole[:, joint, size + index] = column[rows]
    scale = counted_rms(torque, mask)
    weight = np.where(mask & (scale > 0.0), 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    whole, torque = whole * weight[..., None], torque * weight
    sizes = np.sqrt(np.mean(whole**2, axis=(0, 1)))
    whole = whole[..., sizes > TINY] / sizes[sizes > TINY]
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
) -> Float[np.ndarray, "samples joints parameters"]:
    """Return torque per unit of each link's ten inertial parameters and its motor's inertia.

    Those of a link are in the order of `BODY`, about the origin of its frame; the motor's is last.

    - `q`, `qd`, `qdd`: positions, velocities and accelerations [rad or m; s].

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.examples.pendulum()
    >>> still = np.zeros((1, 1))
    >>> body_regressor(arm, still, still, still + 1.0)[0, 0, [2, 10]].tolist()
    [1.0, 1.0]
    """
    equations, width = _newton_euler(robot, q), len(BODY) + 1
    units = tuple(np.eye(len(BODY))[:, :, None])
    columns = equations.columns(
        [(link, units) for link in range(robot.joint_count)], list(qd.T), list(qdd.T)
    )
    result = np.zeros((*q.shape, width * robot.joint_count))
    for joint, own in enumerate(columns):
        for link, column in enumerate(own):
            result[:, joint, width * link : width * (link + 1) - 1] = np.transpose(column)
        result[:, joint, width * (joint + 1) - 1] = qdd[:, joint]
    return result


def _torque_of_bodies(
    robot: Manipulator,
    parameters: Float[np.ndarray, " parameters"],
    q: Float[np.ndarray, "samples joints"],
    qd: Float[np.ndarray, "samples joints"],
    qdd: Float[np.ndarray, "samples joints"],
) -> Float[np.ndarray, "samples joints"]:
    """Return `body_regressor` times parameters, by one recursion without the regressor.

    >>> import numpy as np, jaxcslc as jc
    >>> arm, still = jc.examples.pendulum(), np.zeros((1, 1))
    >>> _torque_of_bodies(arm, np.arange(11.0), still, still, still + 1.0).round(6)
    array([[70.86]])
    """
    of_links = parameters.reshape(-1, len(BODY) + 1).tolist()
    torque = _newton_euler(robot, q).torque(
        [of_link[:-1] for of_link in of_links],
        [of_link[-1] for of_link in of_links],
        list(qd.T),
        list(qdd.T),
    )
    return np.stack([np.broadcast_to(of_joint, len(q)) for of_joint in torque], axis=1)


def _newton_euler(robot: Manipulator, q: Float[np.ndarray, "samples joints"]) -> NewtonEuler:
    """Return the equations of Newton and Euler at positions [rad or m]."""
    a, d, b = np.array(
        [[length.value or 0.0 for *_, length in joint.lengths] for joint in robot.joints]
    ).T[..., None]
    turns = np.array([[kind == "R"] for kind in robot.kinds])
    angles = np.where(turns, q.T, 0.0) + [[joint.theta] for joint in robot.joints]
    frames = link_frames(
        Chain.from_robot(robot).in_numbers(float),
        rotations=list(zip(np.cos(angles), np.sin(angles), strict=True)),
        a=list(a),
        d=list(d + np.where(turns, 0.0, q.T)),
        b=list(b),
    )
    return NewtonEuler(frames, robot.gravity)

"""Kinematics of a robot at a pose: frames of its links, and lines from joint to joint."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace


if TYPE_CHECKING:
    from ._manipulator import Manipulator

Numbers = Array | np.ndarray


def link_poses(
    robot: "Manipulator", q: Float[Numbers, "*batch joints"]
) -> Float[Numbers, "*batch joints 4 4"]:
    """Return the pose of each link's frame in the base frame (modified DH, Eqn. 2.6-1).

    **Arguments**

    - `robot`: n joints, every length with a value.
    - `q`: (..., n) positions [rad or m]; NumPy's, or JAX's, which can be traced.

    **Raises**

    - `RobotError`: a length without value.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import link_poses
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
    >>> np.round(link_poses(arm, np.array([np.pi / 2, 0.0]))[1, :3, 3], 6).tolist()
    [0.0, 0.5, 0.0]
    """
    robot.length_values()  # says which has none
    xp = array_namespace(q)
    poses: list[Any] = []
    for i, (joint, parent) in enumerate(zip(robot.joints, robot.parents, strict=True)):
        a, d, b = (float(length.value or 0.0) for _, _, length in joint.lengths)
        turn, slide = (q[..., i], 0.0) if joint.kind == "R" else (0.0 * q[..., i], q[..., i])
        fixed = _screw(np, 2, np.array(joint.gamma), b) @ _screw(np, 0, np.array(joint.alpha), a)
        step = xp.asarray(fixed, q.dtype) @ _screw(xp, 2, joint.theta + turn, d + slide)
        poses.append(step if parent < 0 else poses[parent] @ step)
    return xp.stack(poses, axis=-3)


def joint_lines(
    robot: "Manipulator", q: Float[np.ndarray, "*batch joints"]
) -> Float[np.ndarray, "*batch joints 2 3"]:
    """Return lines from the frame that carries a joint to the joint's own, in the base frame [m].

    **Raises**

    - `RobotError`: a length without value.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import joint_lines
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
    >>> joint_lines(arm, np.zeros(2))[1].tolist()
    [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    """
    ends = np.asarray(link_poses(robot, q))[..., :3, 3]
    base = np.zeros((*ends.shape[:-2], 1, 3))
    starts = np.concatenate([ends, base], axis=-2)[..., list(robot.parents), :]
    return np.stack([starts, ends], axis=-2)


def _screw(xp: Any, axis: int, angle: Any, along: Any) -> Any:
    """Return poses (..., 4, 4) of a turn about an axis and a shift along it."""
    c, s = xp.cos(angle), xp.sin(angle)
    zero, one = xp.zeros_like(c), xp.ones_like(c)
    rows = [[one if i == j else zero for j in range(4)] for i in range(4)]
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rows[first][first] = rows[second][second] = c
    rows[first][second], rows[second][first] = -s, s
    rows[axis][3] = along + zero
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)

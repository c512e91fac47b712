"""Poses of link frames in the base frame (modified Denavit-Hartenberg, Eqn. 2.6-1)."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace
from ..manipulator import Manipulator


Numbers = Array | np.ndarray


def link_poses(
    robot: Manipulator, q: Float[Numbers, "*batch joints"]
) -> Float[Numbers, "*batch joints 4 4"]:
    """The pose of each link's frame in the base frame (modified Denavit-Hartenberg, Eqn. 2.6-1).

    **Arguments**

    - `robot`: n joints, every length with a value.
    - `q`: (..., n) positions [rad or m]; NumPy's, or JAX's, which can be traced.

    **Raises**

    - `RobotError`: a length without value.

    >>> import numpy as np, jaxcslc as jc
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
        fixed = _screw_z(joint.gamma, b) @ _screw_x(joint.alpha, a)
        step = xp.asarray(fixed, q.dtype) @ _screws_z(xp, joint.theta + turn, d + slide)
        poses.append(step if parent < 0 else poses[parent] @ step)
    return xp.stack(poses, axis=-3)


def _screws_z(xp: Any, angle: Any, along: Any) -> Any:
    """Screws about z by arrays of angles."""
    c, s = xp.cos(angle), xp.sin(angle)
    zero, one = xp.zeros_like(c), xp.ones_like(c)
    rows = ((c, -s, zero, zero), (s, c, zero, zero), (zero, zero, one, along + zero))
    return xp.stack([xp.stack(row, axis=-1) for row in (*rows, (zero, zero, zero, one))], axis=-2)


def _screw_z(angle: float, along: float) -> Float[np.ndarray, "4 4"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, along], [0, 0, 0, 1.0]])


def _screw_x(angle: float, along: float) -> Float[np.ndarray, "4 4"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, along], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])

import numpy as np
from jaxtyping import Float

from ...manipulator import Manipulator


def link_poses(
    robot: Manipulator, q: Float[np.ndarray, " joints"]
) -> Float[np.ndarray, "joints 4 4"]:
    """The pose of each link's frame in the base frame (modified Denavit-Hartenberg, Eqn. 2.6-1).

    **Arguments**

    - `robot`: n joints, every length with a value.
    - `q`: (n,) positions [rad or m].

    **Raises**

    - `RobotError`: a length without value.

    >>> import numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
    >>> np.round(link_poses(arm, np.array([np.pi / 2, 0.0]))[1, :3, 3], 6).tolist()
    [0.0, 0.5, 0.0]
    """
    robot.length_values()  # says which has none
    poses: list[np.ndarray] = []
    for joint, parent, position in zip(robot.joints, robot.parents, q, strict=True):
        a, d, b = (float(length.value or 0.0) for _, _, length in joint.lengths)
        revolute = joint.kind == "R"
        step = (
            _screw_z(joint.gamma, b)
            @ _screw_x(joint.alpha, a)
            @ _screw_z(
                joint.theta + (position if revolute else 0.0), d + (0.0 if revolute else position)
            )
        )
        poses.append(step if parent < 0 else poses[parent] @ step)
    return np.stack(poses)


def _screw_z(angle: float, along: float) -> Float[np.ndarray, "4 4"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, along], [0, 0, 0, 1.0]])


def _screw_x(angle: float, along: float) -> Float[np.ndarray, "4 4"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, along], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])

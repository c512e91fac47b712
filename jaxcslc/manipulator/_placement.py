"""Poses of links, and modified Denavit-Hartenberg rows of joints whose axes are given in space.

The common normal of consecutive axes gives each row (Khalil and Kleinfinger 1986). Readers of
URDF and MJCF files need this; see `files._load`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from .._environment import array_namespace
from ._joint import Joint, JointKind, Length


if TYPE_CHECKING:
    from ._manipulator import Manipulator

# Axes this close to parallel, and angles this close to a multiple of 90°, are taken as exactly
# that [rad]: files round pi/2 to 1.5708 and mean pi/2. (Two axes that miss being parallel by as
# little as that have their common normal hundreds of kilometres away.)
_ANGLE_TOLERANCE = 1e-5
_LENGTH_DIGITS = 11  # decimals: files round angles, and lengths that are rotated by them follow

Numbers = Array | np.ndarray
Vector = Float[np.ndarray, "3"]
Pose = Float[np.ndarray, "4 4"]


class Axis(NamedTuple):
    """A joint's axis at the robot's zero position, in the base frame.

    **Attributes**

    - `kind`: `"R"` or `"P"`.
    - `parent`: the joint that carries it, counted from 0, or -1 for the base.
    - `origin`, `direction`: a point on the axis [m], and a vector along it.
    - `offset`: added to the joint variable: minus its value at the zero position.
    """

    kind: JointKind
    parent: int
    origin: Vector
    direction: Vector
    offset: float = 0.0


class _Normal(NamedTuple):
    """The common normal of two axes, from a point on the first along `direction` to the second."""

    start: Vector
    direction: Vector
    length: float
    unique: bool  # neither parallel nor the same line


def modified_dh(axes: Sequence[Axis]) -> tuple[tuple[Joint, ...], tuple[Pose, ...]]:
    """Modified Denavit-Hartenberg rows of joints with any axes (Khalil and Kleinfinger 1986).

    Every link's frame has its z along the link's axis and its x along the common normal
    to the axis of the first joint that the link carries, so that `gamma` and `b` are zero along a
    chain; only at other branches and at the base, whose frame is fixed, they are not.

    **Returns**

    - The rows.
    - The (4, 4) pose of each link's frame in the base frame, joints at zero.

    >>> import numpy as np
    >>> x, y, z = np.eye(3)
    >>> elbow = [Axis("R", -1, 0 * z, z), Axis("R", 0, z + 2 * x, y)]
    >>> rows, frames = modified_dh(elbow)
    >>> [(row.alpha, row.a.value, row.d.value, row.theta) for row in rows]
    [(0.0, 0.0, 1.0, 0.0), (-1.5707963267948966, 2.0, 0.0, 0.0)]
    """
    axes = _straightened(axes)
    base = np.eye(4)
    first_child: dict[int, int] = {}
    for i, axis in enumerate(axes):
        first_child.setdefault(axis.parent, i)
    rows: list[Joint] = []
    frames: list[Pose] = []
    for i, axis in enumerate(axes):
        frame = frames[axis.parent] if axis.parent >= 0 else base
        normal = _common_normal(frame, axis)
        foot = normal.start + normal.length * normal.direction
        link_frame = _pose(foot, normal.direction, axis.direction)  # theta = 0, d = 0
        if i in first_child:
            onward = _common_normal(link_frame, axes[first_child[i]])
            link_frame = _pose(onward.start, onward.direction, axis.direction)
        rows.append(_row(frame, normal, link_frame, axis))
        frames.append(link_frame)
    return tuple(rows), tuple(frames)


def _straightened(axes: Sequence[Axis]) -> list[Axis]:
    """Return the axes with directions almost parallel to their parent's made parallel."""
    straight: list[Axis] = []
    for axis in axes:
        before = straight[axis.parent].direction if axis.parent >= 0 else np.array([0.0, 0.0, 1.0])
        direction = axis.direction / np.linalg.norm(axis.direction)
        if np.linalg.norm(np.cross(before, direction)) < _ANGLE_TOLERANCE:
            direction = before * np.sign(before @ direction)
        straight.append(axis._replace(direction=direction))
    return straight


def _common_normal(frame: Pose, axis: Axis) -> _Normal:
    """Compute the common normal from the z axis of a frame to a joint's axis.

    Where it is not unique, it starts at the frame's origin.
    """
    origin, x, z = frame[:3, 3], frame[:3, 0], frame[:3, 2]
    cross, between = np.cross(z, axis.direction), axis.origin - origin
    sine = float(np.linalg.norm(cross))
    if sine < _ANGLE_TOLERANCE:
        across = between - (between @ z) * z
        length = float(np.linalg.norm(across))
        if length < 10.0**-_LENGTH_DIGITS:
            return _Normal(origin, x, 0.0, unique=False)
        return _Normal(origin, across / length, length, unique=False)
    along = np.cross(axis.direction, cross) @ between / sine**2
    direction, length = cross / sine, float(between @ cross) / sine
    if length < 0:  # from the first axis to the second
        direction, length = -direction, -length
    elif length < 10.0**-_LENGTH_DIGITS and direction @ x < -_ANGLE_TOLERANCE:
        direction = -direction  # the axes meet: the normal that turns the frame less
    return _Normal(origin + along * z, direction, length, unique=True)


def _row(frame: Pose, normal: _Normal, link_frame: Pose, axis: Axis) -> Joint:
    x, y, z = frame[:3, :3].T
    along = normal.direction
    foot = normal.start + normal.length * along
    gamma = math.atan2(along @ y, along @ x)
    alpha = math.atan2(np.cross(z, axis.direction) @ along, z @ axis.direction)
    across = np.cross(axis.direction, along)
    theta = math.atan2(link_frame[:3, 0] @ across, link_frame[:3, 0] @ along)
    b = float((normal.start - frame[:3, 3]) @ z)
    d = float((link_frame[:3, 3] - foot) @ axis.direction)
    turning = axis.kind == "R"
    return Joint(
        axis.kind,
        _right(alpha),
        _length(normal.length),
        _length(d + (0.0 if turning else axis.offset)),
        _right(theta + (axis.offset if turning else 0.0)),
        _right(gamma),
        _length(b),
        axis.parent + 1,
    )


def _pose(origin: Vector, x: Vector, z: Vector) -> Pose:
    x = x - (x @ z) * z  # rounding apart, they are perpendicular
    x = x / np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :] = np.column_stack([x, np.cross(z, x), z, origin])
    return pose


def _right(angle: float) -> float:
    """Return the angle within half a turn of zero, exact where it almost is a multiple of 90°."""
    angle = math.remainder(angle, 2 * math.pi)
    quarter_turns = round(angle / (math.pi / 2))
    if abs(angle - quarter_turns * math.pi / 2) < _ANGLE_TOLERANCE:
        return math.pi if quarter_turns == -2 else quarter_turns * math.pi / 2
    return angle


def _length(value: float) -> Length:
    return Length(round(value, _LENGTH_DIGITS) + 0.0)  # no negative zero


def link_poses(
    robot: "Manipulator", q: Float[Numbers, "*batch joints"]
) -> Float[Numbers, "*batch joints 4 4"]:
    """Return the pose of each link's frame in the base frame (modified DH, Eqn. 2.6-1).

    **Arguments**

    - `robot`: n joints, every length with a value.
    - `q`: (..., n) positions [rad or m]; NumPy's, or JAX's, which can be traced.

    **Raises** `RobotError`: a length without value.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import link_poses
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
    >>> np.round(link_poses(arm, np.array([np.pi / 2, 0.0]))[1, :3, 3], 6).tolist()
    [0.0, 0.5, 0.0]
    """
    return LinkPoses.of(robot)(q)


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Poses of a robot's links, as `link_poses`, for many calls.

    Each link's pose in the frame that carries it is linear in the cosine and the sine of its
    joint's angle, or in its joint's way: all of them are formed at once.

    **Attributes**

    - `parts`: of these poses: a constant, and what multiplies cosine, sine and way.
    - `parents`: the link that carries each, -1 for the base.
    - `has_slides`: whether a joint is prismatic.
    """

    parts: Float[np.ndarray, "4 joints 4 4"]
    parents: tuple[int, ...]
    has_slides: bool

    @classmethod
    def of(cls, robot: "Manipulator") -> "LinkPoses":
        """Return the poses of a robot.

        **Raises** `RobotError`: a length without value.
        """
        robot.length_values()  # says which has none
        parts = np.zeros((4, robot.joint_count, 4, 4))
        fixed, cosine, sine, slide = parts
        fixed[:] = steps_at_zero(robot.joints)
        turns = np.array([kind == "R" for kind in robot.kinds])
        slide[~turns, :, 3] = fixed[~turns, :, 2]
        x, y = fixed[turns, :, 0], fixed[turns, :, 1]
        cosine[turns, :, 0], cosine[turns, :, 1] = x, y
        sine[turns, :, 0], sine[turns, :, 1] = y, -x
        fixed[turns, :, :2] = 0.0
        return cls(parts, robot.parents, not bool(np.all(turns)))

    def __call__(self, q: Float[Numbers, "*batch joints"]) -> Float[Numbers, "*batch joints 4 4"]:
        xp, parts = array_namespace(q), self.parts
        if xp is not np:  # JAX's settings can forbid other ranks
            parts = xp.asarray(parts.reshape(4, *[1] * (q.ndim - 1), *parts.shape[1:]), q.dtype)
        fixed, cosine, sine, slide = parts
        q = q[..., None, None]
        steps = fixed + cosine * xp.cos(q) + sine * xp.sin(q)
        if self.has_slides:
            steps = steps + slide * q
        poses: list[Any] = []
        for i, parent in enumerate(self.parents):
            step = steps[..., i, :, :]
            poses.append(step if parent < 0 else poses[parent] @ step)
        return xp.stack(poses, axis=-3)


def steps_at_zero(joints: tuple[Joint, ...]) -> Float[np.ndarray, "joints 4 4"]:
    """Return each link's pose in the frame that carries it, at joint variable zero (Eqn. 2.6-1)."""
    return np.array(
        [
            _screw(2, joint.gamma, joint.b.value or 0.0)
            @ _screw(0, joint.alpha, joint.a.value or 0.0)
            @ _screw(2, joint.theta, joint.d.value or 0.0)
            for joint in joints
        ]
    )


def joint_lines(
    robot: "Manipulator", q: Float[np.ndarray, "*batch joints"]
) -> Float[np.ndarray, "*batch joints 2 3"]:
    """Return lines from the frame that carries a joint to the joint's own, in the base frame [m].

    **Raises** `RobotError`: a length without value.

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


def _screw(axis: int, angle: float, along: float) -> Pose:
    """Return the pose of a turn about an axis and a shift along it."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    pose = np.eye(4)
    pose[first, first] = pose[second, second] = math.cos(angle)
    pose[first, second], pose[second, first] = -math.sin(angle), math.sin(angle)
    pose[axis, 3] = along
    return pose

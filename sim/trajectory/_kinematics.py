"""Kinematics of the hand: poses, Jacobians, and joint positions that reach a point."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import LinkPoses, Manipulator
from sim.machine._bodies import MachineError
from sim.trajectory._paths import Array, namespace, spread


# Of the inverse kinematics.
_ITERATIONS = 100
_TOLERANCE = 1e-12  # [m and rad]: a few roundings of an arm of metres
_ACCEPTED = 1e-9
_LARGEST_STEP = 0.3  # [rad or m]


@dataclass(frozen=True, eq=False)
class Hand:
    """A point of the last link: its position and Jacobian.

    >>> import numpy as np
    >>> import jaxcslc
    >>> from sim import Hand
    >>> point, jacobian = Hand.of(jaxcslc.puma560()).locate(np.zeros(6))
    >>> point.round(4), jacobian.shape
    (array([0.4115, 0.1501, 0.4331]), (3, 6))
    """

    poses: LinkPoses
    """Of the links in frame 0."""

    turns: Float[np.ndarray, " joints"]
    """1 for a revolute joint, 0 for a prismatic one."""

    point: Float[np.ndarray, "3"]
    """In the last link's frame [m]."""

    @classmethod
    def of(cls, robot: Manipulator, point: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> "Hand":
        """A point of a manipulator's last link, its frame's origin if omitted [m].

        **Raises** `jaxcslc.RobotError`: a length has no value.
        """
        turns = np.array([float(joint.kind == "R") for joint in robot.joints])
        return cls(LinkPoses.of(robot), turns, np.array(point, dtype=np.float64))

    def locate(
        self, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3 joints"]]:
        """Position of the point in frame 0 [m], and its Jacobian [m/rad, or 1], at joint positions
        [rad or m]."""
        xp = namespace(position)
        chain = self.poses(position)
        last = chain[..., -1, :, :]
        point = (last[..., :3, :3] @ spread(self.point[:, None], position))[..., 0]
        point = point + last[..., :3, 3]
        x, y, z = (point[..., i, None] - chain[..., i, 3] for i in range(3))
        u, v, w = (chain[..., i, 2] for i in range(3))
        circling = xp.stack([v * z - w * y, w * x - u * z, u * y - v * x], axis=-2)
        if self._turns_only:
            return point, circling
        turns = spread(self.turns, position)[..., None, :]
        axis = xp.stack([u, v, w], axis=-2)
        return point, turns * circling + (1.0 - turns) * axis

    def turn(
        self, position: Float[Array, "*batch joints"]
    ) -> tuple[Float[Array, "*batch 3 3"], Float[Array, "*batch 3 joints"]]:
        """Rotation of the last link in frame 0, and the axis about which each joint turns it
        [rad/rad, or 0], at joint positions [rad or m].

        >>> import numpy as np
        >>> import jaxcslc
        >>> from sim import Hand
        >>> rotation, axes = Hand.of(jaxcslc.puma560()).turn(np.zeros(6))
        >>> axes.round(3)[:, 1]
        array([-0.,  1.,  0.])
        """
        chain = self.poses(position)
        turns = spread(self.turns, position)[..., None, :]
        axes = namespace(position).moveaxis(chain[..., :3, 2], -1, -2)
        return chain[..., -1, :3, :3], turns * axes

    @cached_property
    def _turns_only(self) -> bool:
        """Return whether there is no prismatic joint."""
        return bool(np.all(self.turns == 1.0))


def reach(
    hand: Hand,
    target: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"] | None,
    near: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, " joints"]:
    """Inverse kinematics by a damped Newton method.

    The damping is proportional to the squared error (Sugihara 2011): far from the target the method
    is gradient descent, which passes singular poses; close to it, it converges quadratically. Of
    several solutions it returns one close to `near`. (`scipy.optimize.least_squares` took 2.4 to
    20 times as long, and missed 2 % of 300 random poses of a PUMA 560 that this method reaches.)

    **Arguments**

    - `hand`: which point of the last link.
    - `target`: position of the hand in frame 0 [m].
    - `rotation`: of the last link's frame in frame 0; any, if None.
    - `near`: initial joint positions [rad or m].

    **Raises** `MachineError`: the target cannot be reached from `near`.
    """
    q = near
    for _ in range(_ITERATIONS):
        error, jacobian = _pose_error(hand, target, rotation, q)
        size = float(np.abs(error).max())
        if size < _TOLERANCE:
            return q
        damping = min(size * size, 1e-2) * 1e-2 * np.eye(len(error))
        step = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + damping + 1e-15 * np.eye(len(error)), error
        )
        q = q + step * min(1.0, _LARGEST_STEP / max(float(np.abs(step).max()), 1e-300))
    error, _ = _pose_error(hand, target, rotation, q)
    if np.abs(error).max() < _ACCEPTED:
        return q
    where = ", ".join(f"{value:.4g}" for value in target)
    turned = "" if rotation is None else f" and {np.linalg.norm(error[3:]):.3g} rad"
    raise MachineError(
        f"the hand cannot reach ({where}) m: it stays"
        f" {np.linalg.norm(error[:3]):.3g} m{turned} away"
    )


def _pose_error(
    hand: Hand,
    target: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"] | None,
    q: Float[np.ndarray, " joints"],
) -> tuple[np.ndarray, np.ndarray]:
    """Error of the hand's pose [m, rad], and its Jacobian."""
    point, jacobian = hand.locate(q)
    if rotation is None:
        return target - point, np.asarray(jacobian)
    turned, axes = hand.turn(q)
    # Half the antisymmetric part of the remaining rotation: sin(angle) times its axis.
    remaining = rotation @ turned.T
    angle = 0.5 * np.array(
        [
            remaining[2, 1] - remaining[1, 2],
            remaining[0, 2] - remaining[2, 0],
            remaining[1, 0] - remaining[0, 1],
        ]
    )
    return np.concatenate([target - point, angle]), np.concatenate([jacobian, axes])

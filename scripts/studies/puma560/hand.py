"""Torque errors by what they do at the hand: J(q) M(q)⁻¹ times the error.

Section 7.5 names two reasons to weight the joints' torque errors, and weights none: errors of low
joints move the hand most, and errors of high joints move light links. Both are in this product.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC, Patterns
from jaxcslc.manipulator import link_poses
from jaxcslc.network import JointProjection
from jaxcslc.report import torque_errors


Numbers = Array | np.ndarray
Point = Sequence[float] | Float[Numbers, "3"]
_ORIGIN = (0.0, 0.0, 0.0)


def hand_effects(
    network: CSLC,
    reference: Float[Numbers, " coefficients"],
    q: Float[Numbers, "*batch joints"],
    *,
    point: Point = _ORIGIN,
    link: int | None = None,
) -> Float[Array, "*batch 3 joints"]:
    """Return how the hand's acceleration follows the joints' torques: J(q) M(q)⁻¹.

    At a given position and velocity, torques that differ by e give accelerations that differ by
    M⁻¹ e at the joints and by J M⁻¹ e at the hand. Can be jitted, vmapped and differentiated.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `reference`: (p,) coefficients that M is computed with, for instance an earlier
      identification. They are fixed: with those under judgement the error would not be linear in
      them (7.5).
    - `q`: (..., n) positions [rad or m].
    - `point`: the hand in the link's frame [m]; the frame's origin by default.
    - `link`: that carries the hand, counted from 1; the last one by default.

    **Returns** (..., 3, n) translational acceleration in the base frame per unit of torque
    [m/s² per N m, or per N]. Not finite where M is singular, which it is for no possible bodies.

    **Raises** `ValueError` for a link that does not exist; `RobotError` for a length without value.
    """
    robot = network.robot
    link = robot.joint_count if link is None else link
    if not 1 <= link <= robot.joint_count:
        raise ValueError(f"link: expected 1 to {robot.joint_count}, got {link}")
    q = jnp.asarray(q)
    poses = link_poses(robot, jnp.asarray(network.positions_of_all_joints(q)))
    axes, origins = poses[..., :3, 2], poses[..., :3, 3]
    last = poses[..., link - 1, :, :]
    hand = last[..., :3, :3] @ jnp.asarray(point, q.dtype) + last[..., :3, 3]
    columns: list[Array] = []
    carrying = _carrying(robot.parents, link - 1)
    for joint, kind in enumerate(robot.kinds):
        axis = axes[..., joint, :]
        if joint not in carrying:
            columns.append(jnp.zeros_like(axis))
        elif kind == "R":
            columns.append(jnp.cross(axis, hand - origins[..., joint, :]))
        else:
            columns.append(jnp.asarray(axis))
    jacobian = jnp.stack(columns, axis=-1)
    if (projection := JointProjection.of(robot)) is not None:
        jacobian = jacobian @ jnp.asarray(projection.matrix, q.dtype)
    mass = network.mass_matrix(reference, q)  # symmetric: J M⁻¹ = (M⁻¹ J')'
    return jnp.linalg.solve(mass, jacobian.mT).mT


@dataclasses.dataclass(frozen=True)
class HandErrors:
    """Errors of several models at the hand, over the patterns in which every joint is judged.

    `print` shows one line; `rows()` returns one row per joint and one of all.

    **Attributes**

    - `names`: of the models.
    - `per_joint`: (models, n) mean acceleration error of the hand by each joint's torque error
      alone [m/s²].
    - `total`: (models,) mean acceleration error of the hand by all of them [m/s²]. Less than the
      sum, since vectors cancel.
    - `patterns`: how many were judged.
    """

    names: tuple[str, ...]
    per_joint: Float[np.ndarray, "models joints"]
    total: Float[np.ndarray, " models"]
    patterns: int

    def rows(self) -> list[dict[str, str | float]]:
        """Rows of the table: each joint, then all joints together [m/s²]."""
        labels = [*(f"joint {j}" for j in range(1, self.per_joint.shape[1] + 1)), "all joints"]
        values = np.column_stack([self.per_joint, self.total])
        return [
            {"": label, **dict(zip(self.names, map(float, column), strict=True))}
            for label, column in zip(labels, values.T, strict=True)
        ]

    def __str__(self) -> str:
        listed = ", ".join(
            f"{name} {value:.3g}" for name, value in zip(self.names, self.total, strict=True)
        )
        return f"mean acceleration error of the hand [m/s²], {self.patterns} patterns: {listed}"


def hand_errors(
    network: CSLC,
    patterns: Patterns,
    vectors: Mapping[str, Float[Numbers, " coefficients"]],
    reference: Float[Numbers, " coefficients"],
    *,
    point: Point = _ORIGIN,
    link: int | None = None,
) -> HandErrors:
    """Compare models by what their torque errors do to the hand's acceleration.

    An open loop that applies a model's torques misses the hand's acceleration by J M⁻¹ e, with
    the model's torque error e of `torque_errors`. The measure is the mean of its length.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion and torque; patterns with a joint outside `patterns.mask` are left out.
    - `vectors`: (p,) coefficients of each model, by name.
    - `reference`, `point`, `link`: as of `hand_effects`.

    **Returns** a `HandErrors`.

    **Raises** `ValueError` if no pattern has all joints in the mask; and as `hand_effects`.
    """
    judged = np.all(np.asarray(patterns.mask), axis=1)
    if not np.any(judged):
        raise ValueError("patterns: none has all joints in its mask")
    q = np.asarray(patterns.q)[judged]
    effects = np.asarray(hand_effects(network, reference, q, point=point, link=link))
    per_joint: list[np.ndarray] = []
    total: list[float] = []
    for k in vectors.values():
        error = np.asarray(torque_errors(network, patterns, k))[judged]
        shares = effects * error[:, None, :]
        per_joint.append(np.linalg.norm(shares, axis=1).mean(axis=0))
        total.append(float(np.linalg.norm(shares.sum(axis=2), axis=1).mean()))
    return HandErrors(tuple(vectors), np.array(per_joint), np.array(total), int(np.sum(judged)))


def _carrying(parents: Sequence[int], link: int) -> frozenset[int]:
    """The joints that move a link, from 0."""
    path: set[int] = set()
    while link >= 0:
        path.add(link)
        link = parents[link]
    return frozenset(path)

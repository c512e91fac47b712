"""Robots drawn as lines from joint to joint, with an ellipsoid per body."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc.instruments import link_poses
from jaxcslc.manipulator import LinkParameters, Manipulator

from .._arm_chart import ArmChart, Ellipsoid


def ellipsoid_of(link: LinkParameters) -> tuple[np.ndarray, np.ndarray]:
    """The solid ellipsoid with a body's mass, centre of gravity and inertia tensor.

    It exists for every possible body: along the principal axes, half axes are √(5 s / m), with s
    the spread ∫ x² dm of mass along an axis, an eigenvalue of tr(I)/2 - I.

    **Returns**

    - The centre, (3,) [m].
    - (3, 3), its columns the half axes [m].

    >>> import numpy as np
    >>> from jaxcslc.manipulator import LinkParameters
    >>> ball = LinkParameters(2.0, np.zeros(3), 0.4 * 2.0 * 0.1**2 * np.eye(3))
    >>> np.round(np.linalg.norm(ellipsoid_of(ball)[1], axis=0), 6).tolist()
    [0.1, 0.1, 0.1]
    """
    tensor = np.asarray(link.inertia, float)
    spread, directions = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
    half = np.sqrt(5.0 * np.maximum(spread, 0.0) / float(link.mass))
    return np.asarray(link.centre_of_gravity, float), directions * half


def arm_document(
    robot: Manipulator,
    links: Sequence[LinkParameters],
    names: Sequence[str],
    q: Float[np.ndarray, " joints"],
) -> dict[str, Any]:
    """A robot's bodies at one position as plain data: lines from joint to joint, and ellipsoids.

    **Raises** `RobotError` for a length without value.
    """
    poses = link_poses(robot, q)
    origins = [np.zeros(3) if i < 0 else poses[i][:3, 3] for i in robot.parents]
    bodies: list[dict[str, Any]] = []
    for link, name, pose in zip(links, names, poses, strict=True):
        centre, axes = ellipsoid_of(link)
        bodies.append(
            {
                "name": name,
                "centre": (pose[:3, :3] @ centre + pose[:3, 3]).tolist(),
                "axes": (pose[:3, :3] @ axes).tolist(),
            }
        )
    lines = [[a.tolist(), pose[:3, 3].tolist()] for a, pose in zip(origins, poses, strict=True)]
    return {"lines": lines, "bodies": bodies}


def arm_chart(document: dict[str, Any]) -> ArmChart:
    """The chart of what `arm_document` returned.

    Bodies larger than the arm are named in the caption in place of being drawn: where the motion
    determines a moment of inertia and hardly the mass, the ellipsoid has no meaningful size.
    """
    lines = np.asarray(document["lines"], float)
    reach = float(np.sum(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)))
    caption = "Solid ellipsoids of the same mass and inertia, at the recording's first sample"
    bodies: list[Ellipsoid] = []
    large: list[str] = []
    for body in document["bodies"]:
        ellipsoid = Ellipsoid(body["name"], np.asarray(body["centre"]), np.asarray(body["axes"]))
        if 0.0 < reach < float(np.max(np.linalg.norm(ellipsoid.axes, axis=0))):
            large.append(body["name"])
        else:
            bodies.append(ellipsoid)
    if large:
        caption += (
            f"; not drawn, because larger than the arm: {', '.join(large)}, whose inertia the"
            " motion determines and whose mass it hardly does"
        )
    return ArmChart(lines, tuple(bodies), caption)

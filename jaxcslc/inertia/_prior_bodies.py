import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..manipulator import Joint, LinkParameters, Manipulator
from ._bodies import (
    bodies_of,
    body_of_pseudo_inertia,
    central_tensor,
    principal_body,
    pseudo_inertia,
)


# A ball is at least this part of the robot's reach in radius, and no smaller than this [m].
_SMALLEST_PART, _SMALLEST_RADIUS = 0.1, 0.02
# A prior that is no body (a massless link, a flat one) gets this much of a ball in the directions
# that it lacks.
_FILL = 0.02


@dataclass(frozen=True)
class Prior:
    """Bodies and motor inertias to keep to where the data say nothing.

    **Attributes**

    - `bodies`: ten numbers a link, all of them possible.
    - `motors`: motor inertias.
    - `motor_scales`: what counts as a change by a whole one.
    """

    bodies: Float[np.ndarray, "links 10"]
    motors: Float[np.ndarray, " links"]
    motor_scales: Float[np.ndarray, " links"]


def balls(robot: Manipulator, mass: float) -> tuple[LinkParameters, ...]:
    """Solid balls of equal mass, one a link, half way to where the next joint is.

    The assumption for a robot of which only the lengths are known.
    """
    n = robot.joint_count
    reach = sum(
        abs(length.value or 0.0) for joint in robot.joints for _, _, length in joint.lengths
    )
    ends = np.zeros((n, 3))
    for child, parent in enumerate(robot.parents):
        origin = _origin(robot.joints[child])
        if parent >= 0 and np.linalg.norm(origin) > np.linalg.norm(ends[parent]):
            ends[parent] = origin
    links: list[LinkParameters] = []
    for inertia, end in zip(robot.inertia, ends, strict=True):
        radius = max(float(np.linalg.norm(end)) / 2, _SMALLEST_PART * reach, _SMALLEST_RADIUS)
        zero = np.array([f"r{axis}" in inertia.zero for axis in "xyz"])
        centre = np.where(zero, 0.0, end / 2)
        links.append(LinkParameters(mass, centre, 0.4 * mass * radius**2 * np.eye(3)))
    return tuple(links)


def prior_of(
    robot: Manipulator,
    links: Sequence[LinkParameters],
    filler: Sequence[LinkParameters],
    fixed: Float[np.ndarray, "links 10"],
) -> Prior:
    """Links without what is fixed to them, made bodies where they are none.

    **Arguments**

    - `robot`: its links' kinds of inertia.
    - `links`: their parameters.
    - `filler`: a possible body for each link, which lends it what it lacks.
    - `fixed`: ten numbers of the body that is fixed to each link.
    """
    bodies = bodies_of(links) - fixed
    lenders = bodies_of(filler)
    possible = np.stack(
        [
            _possible(body, lender) if inertia.form == "full" else _possible_principal(body, lender)
            for body, lender, inertia in zip(bodies, lenders, robot.inertia, strict=True)
        ]
    )
    motors = np.array([float(link.motor_inertia) for link in links])
    # A light link's motor may be heavy: it is of the machine's size, as the lenders are.
    largest = np.maximum(possible, lenders)
    link_scales = np.where([kind == "R" for kind in robot.kinds], largest[:, 2], largest[:, 9])
    return Prior(possible, motors, np.where(motors > 0, motors, link_scales))


def _possible(
    body: Float[np.ndarray, "10"], lender: Float[np.ndarray, "10"]
) -> Float[np.ndarray, "10"]:
    """The body with its pseudo-inertia's eigenvalues, in units of the lender's, kept from zero."""
    scale = np.linalg.cholesky(pseudo_inertia(lender))
    unit = np.linalg.solve(scale, np.linalg.solve(scale, pseudo_inertia(body)).T)
    values, vectors = np.linalg.eigh((unit + unit.T) / 2)
    # A lender is of this machine's size, not of this link's: a light link needs little.
    least = _FILL * min(1.0, max(float(values[-1]), _FILL))
    if values[0] >= least * 1e-3:
        return body
    values = np.maximum(values, least)
    filled = scale @ (vectors * values) @ vectors.T @ scale.T
    return body_of_pseudo_inertia((filled + filled.T) / 2)


def _possible_principal(
    body: Float[np.ndarray, "10"], lender: Float[np.ndarray, "10"]
) -> Float[np.ndarray, "10"]:
    """The same of a body that keeps its axes: its mass, and its spread along each of them."""
    mass = max(float(body[9]), _FILL * float(lender[9]))
    centre = body[6:9] / mass
    moments = np.diag(central_tensor(body)) if body[9] > 0 else body[:3]
    spread = np.sum(moments) / 2 - moments
    some = _FILL * mass / lender[9] * np.diag(pseudo_inertia(lender))[:3]
    spread = np.maximum(spread, _FILL * np.maximum(np.max(spread), some))
    return principal_body(mass, centre, spread)


def _origin(joint: Joint) -> Float[np.ndarray, "3"]:
    """Where a joint's frame is in the frame of the link that carries it [m]."""
    a, d, b = (length.value or 0.0 for length in (joint.a, joint.d, joint.b))
    across = np.array([a, -math.sin(joint.alpha) * d, math.cos(joint.alpha) * d])
    c, s = math.cos(joint.gamma), math.sin(joint.gamma)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return turn @ across + np.array([0.0, 0.0, b])

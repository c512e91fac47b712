"""Rigid bodies that exist, and links as assembly tilts them."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from jaxcslc.manipulator import LinkParameters, Manipulator


# Relative excess of the spread that is added to a tensor that no rigid body can have.
_MARGIN = 0.05
_ROUNDING = 1e-12


class MachineError(ValueError):
    """A machine, or a trajectory for one, that cannot exist.

    The message is one line: the field, the joint, the value and what was expected.
    """


def possible_links(
    robot: Manipulator, links: Sequence[LinkParameters]
) -> tuple[LinkParameters, ...]:
    """Physically possible link parameters with the same dynamics as `links`.

    Moments of inertia that were measured or identified one by one need not belong to any rigid
    body: each of a body's principal moments is at most the sum of the other two, and MuJoCo
    refuses a link that breaks this. Armstrong's link 3 does.

    The moments determine the spread of the mass, ∫ x xᵀ dm = tr(I)/2 − I, which cannot be negative
    in any direction. Mass spread along the axis of joint i turns neither with link i nor
    against it, so whether it belongs to link i or to link i − 1 makes no difference to any motion
    or torque. This function moves as much of it as link i lacks from link i − 1 to link i, from
    the tip to the base. The base supplies any amount. Links that rigid bodies can have change only
    if they supply spread.

    **Arguments**

    - `robot`: the chain; only its twists are used.
    - `links`: parameters of its links, one a joint.

    **Returns** the parameters, changed where they had to be.

    **Raises** `MachineError`: a link has negative mass, or a spread that is negative across its
    joint's axis, which no neighbour can supply.

    >>> import jaxcslc
    >>> from sim import possible_links
    >>> robot = jaxcslc.puma560()
    >>> robot.links[2].inertia.diagonal(), possible_links(robot, robot.links)[2].inertia.diagonal()
    (array([0.066 , 0.0125, 0.086 ]), array([0.0699375, 0.0164375, 0.086    ]))
    """
    masses = np.array([float(link.mass) for link in links])
    tensors = np.array([np.asarray(link.inertia, dtype=np.float64) for link in links])
    if np.all(masses >= 0) and np.all(are_rigid_bodies(tensors)):
        return tuple(links)
    supplied = np.zeros((3, 3))  # supplied to the next link, in the frame of this one
    result: list[LinkParameters] = []
    for i in reversed(range(robot.joint_count)):
        link = links[i]
        if not float(link.mass) >= 0:
            raise MachineError(f"link {i + 1} has a mass of {link.mass} kg; expected zero or more")
        inertia = tensors[i] - supplied
        addition = _missing_spread(inertia, i + 1)
        result.append(
            link
            if addition == 0 and not supplied.any()
            else dataclasses.replace(link, inertia=inertia + addition * np.diag([1.0, 1.0, 0.0]))
        )
        # diag(1, 1, 0) in frame i: I - z zᵀ, with joint i's axis z seen from link i - 1.
        alpha = robot.joints[i].alpha
        axis = np.array([0.0, -math.sin(alpha), math.cos(alpha)])
        supplied = addition * (np.eye(3) - np.outer(axis, axis))
        supplied[np.abs(supplied) < _ROUNDING * addition] = 0.0  # of sin and cos of right angles
    return tuple(reversed(result))


def tilted_links(
    links: Sequence[LinkParameters], angles: Sequence[float]
) -> tuple[LinkParameters, ...]:
    """Link parameters whose principal axes at the centre of gravity are turned.

    **Arguments**

    - `links`: parameters of the links.
    - `angles`: by how much each is turned, about the direction (1, 1, 1) of its frame, which
        weights the three axes alike [rad].

    **Returns** the parameters with other inertia tensors of the same principal moments.

    >>> import jaxcslc
    >>> from sim import tilted_links
    >>> link = tilted_links(jaxcslc.puma560().links, [0.1] * 6)[1]
    >>> round(float(link.inertia[0, 1]), 4), round(float(link.inertia.trace()), 4)
    (-0.0233, 1.193)
    """
    turns = [Rotation.from_rotvec(np.full(3, angle / math.sqrt(3))).as_matrix() for angle in angles]
    return tuple(
        dataclasses.replace(link, inertia=turn @ np.asarray(link.inertia) @ turn.T)
        for link, turn in zip(links, turns, strict=True)
    )


def are_rigid_bodies(inertia: Float[np.ndarray, "bodies 3 3"]) -> Bool[np.ndarray, " bodies"]:
    """Return whether bodies can have these tensors at their centres of gravity [kg m²]."""
    return np.linalg.eigvalsh(_spread(inertia))[:, 0] >= -_slack(inertia)


def _spread(inertia: Float[np.ndarray, "bodies 3 3"]) -> Float[np.ndarray, "bodies 3 3"]:
    return np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia


def _slack(inertia: Float[np.ndarray, "bodies 3 3"]) -> Float[np.ndarray, " bodies"]:
    return _ROUNDING * np.maximum(np.max(np.abs(inertia), axis=(1, 2)), _ROUNDING)


def _missing_spread(inertia: Float[np.ndarray, "3 3"], number: int) -> float:
    """Spread along z to add so that a rigid body can have the tensor [kg m²]; 0 if none."""
    if are_rigid_bodies(inertia[None])[0]:
        return 0.0
    spread = _spread(inertia[None])[0]
    across = np.linalg.eigvalsh(spread[:2, :2])
    if float(across[0]) < -_slack(inertia[None])[0]:
        raise MachineError(
            f"link {number} cannot be a rigid body: its mass would be spread by {across[0]:.3g}"
            " kg m² across its joint's axis; expected zero or more"
        )
    # Schur complement: the smallest spread_zz with which the spread is positive semidefinite.
    coupling = spread[:2, 2]
    needed = float(coupling @ np.linalg.pinv(spread[:2, :2]) @ coupling) - float(spread[2, 2])
    return (1 + _MARGIN) * needed

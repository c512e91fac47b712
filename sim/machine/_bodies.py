import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxcslc.manipulator import LinkParameters, Manipulator


# A link whose measured tensor misses being a body's is made one with this much to spare.
_MARGIN = 0.05
_ROUNDING = 1e-12


class MachineError(ValueError):
    """A machine, or a trajectory for one, that cannot exist.

    The message is one line: which field and joint, what was found and what was expected.
    """


def possible_links(
    robot: Manipulator, links: Sequence[LinkParameters]
) -> tuple[LinkParameters, ...]:
    """Link parameters that rigid bodies can have, with the dynamics of those given.

    Moments of inertia that were measured or identified one by one need not belong to any rigid
    body: each of a body's principal moments is at most the sum of the other two, and MuJoCo
    refuses a link that breaks this. Armstrong's link 3 does.

    What the moments say is how the mass is spread, ∫ x xᵀ dm = tr(I)/2 − I, and a spread cannot be
    negative in any direction. Mass spread along the axis of joint i turns neither with link i nor
    against it, so whether it belongs to link i or to link i − 1 makes no difference to any motion
    or torque. This function borrows as much of it as each link lacks, from the tip to the base;
    the base can lend without end. Links that are bodies already stay as they are, unless they
    lend.

    **Arguments**

    - `robot`: the chain; only its twists are used.
    - `links`: parameters of its links, one a joint.

    **Returns**

    The parameters, changed where they had to be.

    **Raises**

    - `MachineError`: a link has negative mass, or a spread that is negative across its joint's
        axis, which no neighbour can lend.

    >>> import jaxcslc
    >>> from sim import possible_links
    >>> robot = jaxcslc.puma560()
    >>> robot.links[2].inertia.diagonal(), possible_links(robot, robot.links)[2].inertia.diagonal()
    (array([0.066 , 0.0125, 0.086 ]), array([0.0699375, 0.0164375, 0.086    ]))
    """
    borrowed = np.zeros((3, 3))  # by the link after, in the frame of this one
    result: list[LinkParameters] = []
    for i in reversed(range(robot.joint_count)):
        link = links[i]
        if not float(link.mass) >= 0:
            raise MachineError(f"link {i + 1} has a mass of {link.mass} kg; expected zero or more")
        inertia = np.asarray(link.inertia, dtype=np.float64) - borrowed
        loan = _lacking(inertia, i + 1)
        result.append(
            link
            if loan == 0 and not borrowed.any()
            else dataclasses.replace(link, inertia=inertia + loan * np.diag([1.0, 1.0, 0.0]))
        )
        # diag(1, 1, 0) in frame i: I - z zᵀ, with joint i's axis z seen from link i - 1.
        alpha = robot.joints[i].alpha
        axis = np.array([0.0, -math.sin(alpha), math.cos(alpha)])
        borrowed = loan * (np.eye(3) - np.outer(axis, axis))
        borrowed[np.abs(borrowed) < _ROUNDING * loan] = 0.0  # of sin and cos of right angles
    return tuple(reversed(result))


def tilted_links(
    links: Sequence[LinkParameters], angles: Sequence[float]
) -> tuple[LinkParameters, ...]:
    """Link parameters whose principal axes at the centre of gravity are turned.

    **Arguments**

    - `links`: parameters of the links.
    - `angles`: by how much each is turned, about the direction (1, 1, 1) of its own frame, which
        favours none of the frame's axes [rad].

    **Returns**

    The parameters with other inertia tensors of the same principal moments.

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


def is_rigid_body(inertia: Float[np.ndarray, "3 3"]) -> bool:
    """Whether a body can have this tensor at its centre of gravity [kg m²], to rounding."""
    return float(np.linalg.eigvalsh(_spread(inertia))[0]) >= -_slack(inertia)


def _spread(inertia: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    return np.trace(inertia) / 2 * np.eye(3) - inertia


def _slack(inertia: Float[np.ndarray, "3 3"]) -> float:
    return _ROUNDING * max(float(np.abs(inertia).max()), _ROUNDING)


def _lacking(inertia: Float[np.ndarray, "3 3"], number: int) -> float:
    """How much spread along z makes the tensor a body's [kg m²]; 0 if it is one."""
    if is_rigid_body(inertia):
        return 0.0
    spread = _spread(inertia)
    across = np.linalg.eigvalsh(spread[:2, :2])
    if float(across[0]) < -_slack(inertia):
        raise MachineError(
            f"link {number} cannot be a rigid body: its mass would be spread by {across[0]:.3g}"
            " kg m² across its joint's axis; expected zero or more"
        )
    # Schur complement: the least spread_zz that leaves no direction negative.
    lean = spread[:2, 2]
    needed = float(lean @ np.linalg.pinv(spread[:2, :2]) @ lean) - float(spread[2, 2])
    return (1 + _MARGIN) * needed

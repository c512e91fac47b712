"""Table on which the hand of a servo arm may lean: where it is, and its place in the equations.

A servo presses its hand onto the table as long as the command is below. Shoulder, elbow and wrist
then stop together, as if each had an end of travel. Read with `arm.c`, which has the contact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..bodies import bodies_of
from ..manipulator import LinkParameters, Manipulator, RobotError, link_poses


@dataclass(frozen=True)
class Table:
    """Horizontal plane that one point of an arm does not go below, such as the tip of its gripper.

    The contact has no friction.

    **Attributes**

    - `link`: index of the link that has the point, from 0.
    - `point`: in the link's frame [m].
    - `height`: of the plane above the origin of the base frame, against gravity [m].

    >>> from jaxcslc.servo import Table
    >>> Table(4, (0.0, 0.0, 0.1)).height
    0.0
    """

    link: int
    point: tuple[float, float, float]
    height: float = 0.0

    def heights(
        self, robot: Manipulator, q: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, " samples"]:
        """Return how far the point is above the table [m].

        **Raises** `RobotError`: a robot without gravity, or without this link.
        """
        pose = np.asarray(link_poses(robot, q))[:, self._checked(robot)]
        up = -np.array(robot.gravity, float) / np.linalg.norm(robot.gravity)
        return (pose[:, :3, :3] @ np.array(self.point) + pose[:, :3, 3]) @ up - self.height

    def weight(self, robot: Manipulator) -> Float[np.ndarray, "links 10"]:
        """Return bodies whose gravity torques are the derivatives of the point's height.

        They are a point of mass 1/g, as `bodies_of`.
        """
        none = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
        links = [none] * robot.joint_count
        mass = 1.0 / float(np.linalg.norm(robot.gravity))
        links[self._checked(robot)] = LinkParameters(mass, np.array(self.point), np.zeros((3, 3)))
        return bodies_of(links)

    def _checked(self, robot: Manipulator) -> int:
        if not np.any(robot.gravity):
            raise RobotError(f"robot {robot.name!r} has no gravity; a table needs its direction")
        if not 0 <= self.link < robot.joint_count:
            raise RobotError(
                f"table: link {self.link}; expected 0 to {robot.joint_count - 1}, of robot"
                f" {robot.name!r}"
            )
        return self.link

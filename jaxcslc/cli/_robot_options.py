"""Options of commands that say which robot, and what its network has."""

import dataclasses

from ..manipulator import Manipulator
from ..network import CSLC
from ._common import (
    BaseOption,
    CoupledOption,
    FixOption,
    FrictionOption,
    LengthsOption,
    MimicOption,
    RobotOrSystemArgument,
    TipOption,
    network_of,
    robot_named,
)


@dataclasses.dataclass(frozen=True)
class RobotOptions:
    """A robot, or the part of a file that it is, and what its network has.

    - `friction`: `"auto"` leaves that of the robot's file.
    """

    robot: RobotOrSystemArgument
    lengths: LengthsOption = "auto"
    base: BaseOption = None
    tip: TipOption = None
    fix: FixOption = None
    mimic: MimicOption = None
    friction: FrictionOption = None
    coupled: CoupledOption = None

    def manipulator(self) -> Manipulator:
        """Read the robot."""
        return robot_named(self.robot, self.base, self.tip, self.fix, self.mimic)

    def network(self, robot: Manipulator) -> CSLC:
        """Derive the network of the robot."""
        friction = None if self.friction == "auto" else self.friction
        return network_of(robot, self.lengths, friction, self.coupled)

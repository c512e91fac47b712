from ._errors import RobotError as RobotError
from ._inertia import LinkInertia as LinkInertia
from ._joint import Joint as Joint, Length as Length
from ._link_parameters import LinkParameters as LinkParameters
from ._manipulator import Manipulator as Manipulator
from ._numbering import Numbering as Numbering, Subnumbering as Subnumbering
from ._toml import load_robot as load_robot, panda as panda, puma560 as puma560

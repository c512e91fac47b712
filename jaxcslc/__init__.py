from .derivation import Coefficient as Coefficient
from .manipulator import (
    LinkInertia as LinkInertia,
    LinkParameters as LinkParameters,
    Manipulator as Manipulator,
    RobotError as RobotError,
    load_robot as load_robot,
    panda as panda,
    puma560 as puma560,
)
from .network import CSLC as CSLC, derive as derive

from ._computed_torque import (
    COMPENSATIONS as COMPENSATIONS,
    ComputedTorque as ComputedTorque,
    smooth_friction as smooth_friction,
)
from ._controller import AbstractController as AbstractController
from ._gains import error_gains as error_gains
from ._gravity import Gravity as Gravity, abbreviated_gravity as abbreviated_gravity
from ._guard import FAULTS as FAULTS, Guard as Guard, GuardState as GuardState
from ._limits import integrated as integrated, limited as limited
from ._loop import Loop as Loop, LoopState as LoopState
from ._low_pass import LowPassChain as LowPassChain, Smoothed as Smoothed
from ._pid import PID as PID
from ._reference import Reference as Reference
from ._within_range import WithinRange as WithinRange

from ._bodies import possible_links as possible_links
from ._controllers import (
    PID as PID,
    AbbreviatedGravity as AbbreviatedGravity,
    AbstractController as AbstractController,
    PIDState as PIDState,
    Repulsion as Repulsion,
    SinusoidalTorque as SinusoidalTorque,
    minimum_jerk as minimum_jerk,
)
from ._encoders import Encoders as Encoders
from ._friction import Friction as Friction
from ._machine import Machine as Machine, MachineError as MachineError
from ._mjcf import mjcf as mjcf
from ._plant import Plant as Plant
from ._puma560 import puma560 as puma560
from ._simulate import SimulationError as SimulationError, simulate as simulate
from ._specimen import specimen as specimen
from ._trajectories import Trajectory as Trajectory, comparison as comparison, training as training
from ._truth import SimulatedRecording as SimulatedRecording, Truth as Truth

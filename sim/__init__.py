from ._bodies import possible_links as possible_links, tilted_links as tilted_links
from ._closed_loop import ClosedLoop as ClosedLoop, close_loop as close_loop
from ._controllers import (
    PID as PID,
    AbbreviatedGravity as AbbreviatedGravity,
    AbstractController as AbstractController,
    PIDState as PIDState,
    SinusoidalTorque as SinusoidalTorque,
)
from ._disturbances import (
    DISTURBANCES as DISTURBANCES,
    disturbed as disturbed,
    undisturbed as undisturbed,
)
from ._drives import Drives as Drives
from ._encoders import Encoders as Encoders
from ._faults import Fault as Fault
from ._film import film as film
from ._friction import Friction as Friction
from ._kinematics import Hand as Hand
from ._linearity import MotorLinearity as MotorLinearity, motor_linearity as motor_linearity
from ._loads import Load as Load, carrying as carrying
from ._machine import Machine as Machine
from ._machine_error import MachineError as MachineError
from ._mjcf import mjcf as mjcf
from ._motions import circle as circle, go_to as go_to
from ._nearest_links import nearest_links as nearest_links
from ._paths import (
    AbstractPath as AbstractPath,
    MinimumJerk as MinimumJerk,
    Oscillation as Oscillation,
    SampledPath as SampledPath,
    ViaPoints as ViaPoints,
    minimum_jerk as minimum_jerk,
)
from ._plant import Plant as Plant
from ._puma560 import puma560 as puma560
from ._record import Job as Job, record as record, record_each as record_each
from ._repulsion import (
    AbstractRepulsion as AbstractRepulsion,
    HandRepulsion as HandRepulsion,
    Repulsion as Repulsion,
)
from ._scene import Scene as Scene
from ._servo import Servo as Servo, ServoState as ServoState
from ._simulate import SimulationError as SimulationError, simulate as simulate
from ._specimen import specimen as specimen
from ._thesis_machines import (
    ThesisCoefficients as ThesisCoefficients,
    puma_a as puma_a,
    puma_b as puma_b,
    thesis_coefficients as thesis_coefficients,
)
from ._trajectories import (
    FLANGE as FLANGE,
    Trajectory as Trajectory,
    comparison as comparison,
    training as training,
)
from ._transmission import Transmission as Transmission
from ._truth import SimulatedRecording as SimulatedRecording, Truth as Truth
from ._ultrasound import Echoes as Echoes, ultrasound as ultrasound
from ._ultrasound_echo import Sonar as Sonar

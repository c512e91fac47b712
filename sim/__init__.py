from jaxcslc._environment import require


require("mujoco", "sim")

from .engine import (
    Plant as Plant,
    SimulatedRecording as SimulatedRecording,
    SimulationError as SimulationError,
    Truth as Truth,
    mjcf as mjcf,
    simulate as simulate,
)
from .machine import (
    DISTURBANCES as DISTURBANCES,
    Drives as Drives,
    Encoders as Encoders,
    Fault as Fault,
    Friction as Friction,
    Load as Load,
    Machine as Machine,
    MachineError as MachineError,
    ThesisCoefficients as ThesisCoefficients,
    Transmission as Transmission,
    carrying as carrying,
    disturbed as disturbed,
    nearest_links as nearest_links,
    possible_links as possible_links,
    puma560 as puma560,
    puma_a as puma_a,
    puma_b as puma_b,
    specimen as specimen,
    thesis_coefficients as thesis_coefficients,
    tilted_links as tilted_links,
    undisturbed as undisturbed,
)
from .recording import (
    ClosedLoop as ClosedLoop,
    Job as Job,
    MaskQuality as MaskQuality,
    MotorLinearity as MotorLinearity,
    Scene as Scene,
    close_loop as close_loop,
    film as film,
    mask_quality as mask_quality,
    motor_linearity as motor_linearity,
    record as record,
    record_each as record_each,
)
from .trajectory import (
    FLANGE as FLANGE,
    AbbreviatedGravity as AbbreviatedGravity,
    AbstractPath as AbstractPath,
    Hand as Hand,
    HandRepulsion as HandRepulsion,
    MinimumJerk as MinimumJerk,
    Oscillation as Oscillation,
    Repulsion as Repulsion,
    SampledPath as SampledPath,
    Trajectory as Trajectory,
    ViaPoints as ViaPoints,
    adjusted_training as adjusted_training,
    circle as circle,
    comparison as comparison,
    go_to as go_to,
    minimum_jerk as minimum_jerk,
    training as training,
)
from .ultrasound import Echoes as Echoes, Sonar as Sonar, ultrasound as ultrasound

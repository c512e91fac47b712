"""Simulated machines: recordings with the disturbances of real ones, and their true motion.

- `machine`: what a machine is. `trajectory`: what it does.
- `engine`: simulation. `recording`: many recordings, films.
- `ultrasound`: another identification problem.
"""

from jaxcslc._environment import require


require("mujoco", "sim")

from sim.engine._mjcf import mjcf as mjcf
from sim.engine._plant import Plant as Plant
from sim.engine._simulate import (
    SimulatedRecording as SimulatedRecording,
    SimulationError as SimulationError,
    Truth as Truth,
    simulate as simulate,
)
from sim.machine._bodies import (
    MachineError as MachineError,
    possible_links as possible_links,
    tilted_links as tilted_links,
)
from sim.machine._disturbances import (
    DISTURBANCES as DISTURBANCES,
    disturbed as disturbed,
    undisturbed as undisturbed,
)
from sim.machine._drivetrain import (
    Drives as Drives,
    Encoders as Encoders,
    Friction as Friction,
    Transmission as Transmission,
)
from sim.machine._events import Fault as Fault, Load as Load, carrying as carrying
from sim.machine._machine import Machine as Machine
from sim.machine._nearest_links import nearest_links as nearest_links
from sim.machine._puma560 import puma560 as puma560, specimen as specimen
from sim.machine._thesis_machines import (
    ThesisCoefficients as ThesisCoefficients,
    puma_a as puma_a,
    puma_b as puma_b,
    thesis_coefficients as thesis_coefficients,
)
from sim.recording._closed_loop import ClosedLoop as ClosedLoop, close_loop as close_loop
from sim.recording._film import Scene as Scene, film as film
from sim.recording._linearity import (
    MotorLinearity as MotorLinearity,
    motor_linearity as motor_linearity,
)
from sim.recording._mask_quality import MaskQuality as MaskQuality, mask_quality as mask_quality
from sim.recording._record import Job as Job, record as record, record_each as record_each
from sim.trajectory._kinematics import Hand as Hand
from sim.trajectory._motions import circle as circle, go_to as go_to
from sim.trajectory._paths import (
    AbstractPath as AbstractPath,
    MinimumJerk as MinimumJerk,
    Oscillation as Oscillation,
    SampledPath as SampledPath,
    ViaPoints as ViaPoints,
    minimum_jerk as minimum_jerk,
)
from sim.trajectory._torques import (
    AbbreviatedGravity as AbbreviatedGravity,
    HandRepulsion as HandRepulsion,
    Repulsion as Repulsion,
    SinusoidalTorque as SinusoidalTorque,
)
from sim.trajectory._trajectories import (
    FLANGE as FLANGE,
    Trajectory as Trajectory,
    adjusted_training as adjusted_training,
    comparison as comparison,
    training as training,
)
from sim.ultrasound._echoes import Echoes as Echoes, ultrasound as ultrasound
from sim.ultrasound._sonar import Sonar as Sonar

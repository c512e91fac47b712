from sim.trajectory._abbreviated_gravity import AbbreviatedGravity as AbbreviatedGravity
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
from sim.trajectory._repulsion import HandRepulsion as HandRepulsion, Repulsion as Repulsion
from sim.trajectory._sinusoidal_torque import SinusoidalTorque as SinusoidalTorque
from sim.trajectory._trajectories import (
    FLANGE as FLANGE,
    Trajectory as Trajectory,
    adjusted_training as adjusted_training,
    comparison as comparison,
    training as training,
)

"""Tasks of simulated machines: paths, controllers, and the thesis's trajectories.

- `_kinematics`: poses and Jacobians of the hand.
- `_paths`, `_motions`: desired paths of joints and of the hand.
- `_torques`: torques beside feedback.
- `_trajectories`: start, controller, path, loads and faults of a simulation.
"""

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

"""Discrete-time controllers of robot arms, from PID to computed torque with fault detection.

Every controller has `begin` and `step`. Controllers can wrap each other, and a simulator runs all
of them alike.

     Reference, q (qd) --> controller --> torque
                              ^
     network, k  -------------+

Modules, in reading order:

- `_controller`: base class, reference, PID control and gravity compensation.
- `_computed_torque`: computed-torque control.
- `_velocity_estimation`: control without tachometers.
- `_protection`: wrappers for limits and faults.
"""

from ._computed_torque import (
    COMPENSATIONS as COMPENSATIONS,
    ComputedTorque as ComputedTorque,
    smooth_friction as smooth_friction,
)
from ._controller import (
    PID as PID,
    AbstractController as AbstractController,
    AbstractPositionTorque as AbstractPositionTorque,
    Gravity as Gravity,
    PIDState as PIDState,
    Reference as Reference,
    conditional_integration as conditional_integration,
    error_gains as error_gains,
)
from ._protection import (
    FAULTS as FAULTS,
    FaultMonitor as FaultMonitor,
    FaultMonitorState as FaultMonitorState,
    JointLimitAvoidance as JointLimitAvoidance,
)
from ._velocity_estimation import (
    FilteredSignal as FilteredSignal,
    LowPassChain as LowPassChain,
    OutputFeedback as OutputFeedback,
    OutputFeedbackState as OutputFeedbackState,
)


__all__ = [
    "COMPENSATIONS",
    "FAULTS",
    "PID",
    "AbstractController",
    "AbstractPositionTorque",
    "ComputedTorque",
    "FaultMonitor",
    "FaultMonitorState",
    "FilteredSignal",
    "Gravity",
    "JointLimitAvoidance",
    "LowPassChain",
    "OutputFeedback",
    "OutputFeedbackState",
    "PIDState",
    "Reference",
    "conditional_integration",
    "error_gains",
    "smooth_friction",
]

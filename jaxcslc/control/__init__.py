from ._computed_torque import (
    COMPENSATIONS as COMPENSATIONS,
    ComputedTorque as ComputedTorque,
    smooth_friction as smooth_friction,
)
from ._controller import AbstractController as AbstractController, Reference as Reference
from ._fault_monitor import (
    FAULTS as FAULTS,
    FaultMonitor as FaultMonitor,
    FaultMonitorState as FaultMonitorState,
)
from ._gains_and_limits import (
    conditional_integration as conditional_integration,
    error_gains as error_gains,
)
from ._gravity import (
    AbstractPositionTorque as AbstractPositionTorque,
    Gravity as Gravity,
)
from ._joint_limit_avoidance import JointLimitAvoidance as JointLimitAvoidance
from ._low_pass import FilteredSignal as FilteredSignal, LowPassChain as LowPassChain
from ._output_feedback import (
    OutputFeedback as OutputFeedback,
    OutputFeedbackState as OutputFeedbackState,
)
from ._pid import PID as PID, PIDState as PIDState
from ._sinusoidal_torque import SinusoidalTorque as SinusoidalTorque

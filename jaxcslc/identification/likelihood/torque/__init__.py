from ._calibration import (
    TorqueCalibration as TorqueCalibration,
    TorqueUnknown as TorqueUnknown,
)
from ._torque_record import (
    TorqueRecord as TorqueRecord,
    TorqueSampling as TorqueSampling,
    triangle_mean as triangle_mean,
)
from ._whitening import (
    MOST_ORDER as MOST_ORDER,
    Whitening as Whitening,
    autocovariance as autocovariance,
)

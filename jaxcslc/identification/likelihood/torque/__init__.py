from ._calibration import (
    TorqueCalibration as TorqueCalibration,
    TorqueUnknown as TorqueUnknown,
)
from ._torque_record import TorqueRecord as TorqueRecord, TorqueSampling as TorqueSampling

"""Recorded torques."""

from ._torque_record import (
    TorqueRecord as TorqueRecord,
    TorqueSampling as TorqueSampling,
    triangle_mean as triangle_mean,
)

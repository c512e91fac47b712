from ._agreement import AGREEMENT_KINDS as AGREEMENT_KINDS
from ._check import DataCheck as DataCheck, check as check
from ._finding import Finding as Finding
from ._sample_findings import without_outliers as without_outliers
from ._summary import JointSummary as JointSummary, RecordingSummary as RecordingSummary
from ._torque_lag import (
    TorqueLag as TorqueLag,
    estimate_torque_lag as estimate_torque_lag,
    small_torque_lag as small_torque_lag,
)

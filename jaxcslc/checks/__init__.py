"""Checks of recordings for wrong units, signs, times and samples, with cause and remedy.

    recordings ──► samples, clock ──► evidence ──► motion and torque ──► agreement ──► DataCheck

- `_check`: the entry point, `check`.
- `_sample_findings`: clock, stale rows, outliers, clipping.
- `_evidence`: the low-passed part of a recording that hypotheses are scored on.
- `_hypotheses`, `_motion_findings`, `_torque_lag`: faults in columns, and the lag of torques.
- `_agreement_findings`: recordings that differ from the first; `_summary`: what was read.
"""

from ._agreement_findings import AGREEMENT_KINDS as AGREEMENT_KINDS
from ._check import DataCheck as DataCheck, check as check
from ._sample_findings import Finding as Finding, without_outliers as without_outliers
from ._torque_lag import (
    TorqueLag as TorqueLag,
    estimate_torque_lag as estimate_torque_lag,
    small_torque_lag as small_torque_lag,
)


__all__ = [
    "DataCheck",
    "Finding",
    "TorqueLag",
    "check",
    "estimate_torque_lag",
    "without_outliers",
]

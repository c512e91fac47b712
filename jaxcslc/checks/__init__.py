"""Checks of recordings for wrong units, signs, times and samples, with cause and remedy.

    recordings ──► samples, clock ──► evidence ──► motion and torque ──► agreement ──► DataCheck

- `_check`: the entry point, `check`, and summaries of what was read.
- `_findings`: the table of causes and remedies.
- `_sample_findings`: clock, stale rows, outliers, clipping.
- `_channel_findings`: angles that wrap, jumps, stops, unsigned and saturated torques.
- `_evidence`: the low-passed part of a recording that hypotheses are scored on; causes, and
  recordings without them.
- `_first_order`, `_model_findings`: scales, zero positions, mounting, clock, and what changes
  during a recording, by the columns that a small fault adds.
- `_motion_findings`, `_torque_lag`: faults in columns, the lag of torques, and recordings that
  differ from the first.

Each bound has its derivation beside it, or the word *heuristic*. Heuristics were chosen on the
three arms of `scripts.studies.checks.study`. What they do on six others is counted by
`scripts.studies.checks.spoiler`: faults that are named, false alarms. How far right recordings stay
from the main ones is measured by `scripts.studies.checks.margins`.
"""

from ._check import DataCheck as DataCheck, check as check
from ._findings import (
    AGREEMENT_KINDS as AGREEMENT_KINDS,
    SPOILING_KINDS as SPOILING_KINDS,
    Finding as Finding,
)
from ._sample_findings import without_outliers as without_outliers
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

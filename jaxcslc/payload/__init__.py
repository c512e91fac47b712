"""Inertial parameters of a payload, from recordings and on-line (thesis 8.2.4).

From recordings:

     loaded, and unloaded or an earlier fit --> fit_payload --> PayloadFit --> PayloadReport

On-line, sample by sample:

     readings, torque --> PayloadEstimator --> estimate --> PayloadCompensation (control)

Modules, in reading order:

- `_report`: `fit_payload` for patterns, `identify_payload` for recordings, and the report.
- `_equations`: recursive equations, evidence for a change, possible bodies.
- `_estimator`: recursive identification, and a controller that uses the estimate.
"""

from ._equations import possible_body as possible_body, torque_noise as torque_noise
from ._estimator import (
    PayloadCompensation as PayloadCompensation,
    PayloadCompensationState as PayloadCompensationState,
    PayloadEstimate as PayloadEstimate,
    PayloadEstimator as PayloadEstimator,
    PayloadState as PayloadState,
)
from ._report import (
    PHYSICAL as PHYSICAL,
    PayloadFit as PayloadFit,
    PayloadReport as PayloadReport,
    fit_payload as fit_payload,
    identify_payload as identify_payload,
)


__all__ = [
    "PHYSICAL",
    "PayloadCompensation",
    "PayloadCompensationState",
    "PayloadEstimate",
    "PayloadEstimator",
    "PayloadFit",
    "PayloadReport",
    "PayloadState",
    "fit_payload",
    "identify_payload",
    "possible_body",
    "torque_noise",
]

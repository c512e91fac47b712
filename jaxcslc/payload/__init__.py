"""Inertial parameters of a payload, from recordings and on-line (thesis 8.2.4).

From recordings:

     loaded, and unloaded or an earlier fit --> fit_payload --> PayloadFit --> PayloadReport

On-line, sample by sample:

     readings, torque --> PayloadEstimator --> estimate --> PayloadCompensation (control)

Modules, in reading order:

- `_fit`: the ten parameters, physical quantities, and their errors.
- `_identify`: `fit_payload` for patterns, `identify_payload` for recordings.
- `_report`: the report, its text and files.
- `_change_detection`: evidence that a payload is picked up, put down or changed.
- `_estimator`: recursive identification.
- `_compensation`: a controller that uses the estimate.
"""

from ._change_detection import PayloadEstimate as PayloadEstimate, PayloadState as PayloadState
from ._compensation import (
    PayloadCompensation as PayloadCompensation,
    PayloadCompensationState as PayloadCompensationState,
)
from ._estimator import (
    PayloadEstimator as PayloadEstimator,
    possible_body as possible_body,
    torque_noise as torque_noise,
)
from ._fit import PHYSICAL as PHYSICAL, PayloadFit as PayloadFit
from ._identify import fit_payload as fit_payload, identify_payload as identify_payload
from ._report import PayloadReport as PayloadReport


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

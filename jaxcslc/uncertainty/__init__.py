"""Errors of a fit on held-out data, systematic errors, and agreement of recordings.

In: a fit, its patterns and others. Out: figures of how far the coefficients can be trusted.

- `_held_out`: errors on data that was not fitted, and what is beyond chance.
- `_systematic_error`: errors by smoothing, timing and missing terms.
- `_drift`: how much coefficients differ from recording to recording.
- `_tolerances`: errors by faults that stay possible: torque scale, clock, zeros of joints.
- `_several`: joint fit of several recordings, and whether they agree.
"""

from ._drift import Drift as Drift, drift_text as drift_text
from ._held_out import (
    FEWEST_SAMPLES as FEWEST_SAMPLES,
    FOLDS as FOLDS,
    HeldOut as HeldOut,
    RelativeError as RelativeError,
    Source as Source,
    cross_validated_error as cross_validated_error,
    fold_numbers as fold_numbers,
    held_out_error as held_out_error,
    held_out_from as held_out_from,
    judged_errors as judged_errors,
    unlike_halves as unlike_halves,
)
from ._several import (
    DRIFT as DRIFT,
    RecordingAgreement as RecordingAgreement,
    SeveralFit as SeveralFit,
    fit_recordings as fit_recordings,
    several_text as several_text,
)
from ._systematic_error import (
    SystematicError as SystematicError,
    SystematicProblem as SystematicProblem,
    missing_terms as missing_terms,
    smoothing_bias as smoothing_bias,
    standard_uncertainty as standard_uncertainty,
    systematic_error as systematic_error,
    uncertainty_interval as uncertainty_interval,
)
from ._tolerances import (
    CLOCK as CLOCK,
    SHOWN_SCALE as SHOWN_SCALE,
    TOLERANCES as TOLERANCES,
    TOLERATED as TOLERATED,
    TORQUE_SCALE as TORQUE_SCALE,
    ZEROS as ZEROS,
    Estimate as Estimate,
    PossibleFaults as PossibleFaults,
    Tolerance as Tolerance,
    possible_faults as possible_faults,
    possible_size as possible_size,
)


__all__ = [
    "TOLERANCES",
    "Drift",
    "Estimate",
    "HeldOut",
    "PossibleFaults",
    "RecordingAgreement",
    "RelativeError",
    "SeveralFit",
    "SystematicError",
    "Tolerance",
    "cross_validated_error",
    "fit_recordings",
    "held_out_error",
    "possible_faults",
    "possible_size",
    "standard_uncertainty",
    "systematic_error",
    "uncertainty_interval",
]

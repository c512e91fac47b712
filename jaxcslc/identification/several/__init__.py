from ._agreement import RecordingAgreement as RecordingAgreement
from ._fit import (
    SeveralFit as SeveralFit,
    fit_recordings as fit_recordings,
    several_text as several_text,
)

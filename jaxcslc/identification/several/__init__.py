from ._agreement import Agreement as Agreement
from ._fit import SeveralFit as SeveralFit, fit_recordings as fit_recordings

from ._candidates import Candidates as Candidates
from ._compiled import filled_up as filled_up, require_float64 as require_float64
from ._factors import JointFactors as JointFactors, factorise as factorise
from ._identification import Identification as Identification
from ._least_squares import fit_factors as fit_factors, least_squares as least_squares
from ._refinement import Refinement as Refinement, refine_thresholds as refine_thresholds
from ._selection import Selection as Selection, Trial as Trial, choose_settings as choose_settings
from ._settings import Settings as Settings
from ._settings_document import (
    settings_document as settings_document,
    settings_from as settings_from,
)
from ._solution import RESULTS as RESULTS
from ._streaming import least_squares_stream as least_squares_stream

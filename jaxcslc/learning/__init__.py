from ._bodies import (
    body_map as body_map,
    body_of as body_of,
    link_of as link_of,
    pseudo_inertia as pseudo_inertia,
)
from ._candidates import Candidates as Candidates
from ._compiled import (
    filled_up as filled_up,
    regressor_of as regressor_of,
    require_float64 as require_float64,
)
from ._correlated import Errors as Errors
from ._factors import JointFactors as JointFactors, factorise as factorise
from ._held import Known as Known
from ._held_out import (
    HeldOut as HeldOut,
    cross_validated_error as cross_validated_error,
    held_out_error as held_out_error,
)
from ._identification import Identification as Identification
from ._least_squares import (
    JointWeights as JointWeights,
    check_patterns as check_patterns,
    check_words as check_words,
    checked as checked,
    equations_of as equations_of,
    fit_factors as fit_factors,
    fit_rows as fit_rows,
    least_squares as least_squares,
)
from ._losses import Loss as Loss
from ._nearest_body import nearest_body as nearest_body
from ._physical_parameters import (
    POSSIBILITY as POSSIBILITY,
    PhysicalParameters as PhysicalParameters,
    physical_parameters as physical_parameters,
)
from ._refinement import Refinement as Refinement, refine_thresholds as refine_thresholds
from ._relearn import relearn as relearn
from ._rows import KeptRows as KeptRows
from ._selection import Selection as Selection, Trial as Trial, choose_settings as choose_settings
from ._settings import Settings as Settings
from ._settings_document import (
    settings_document as settings_document,
    settings_from as settings_from,
)
from ._slopes import SlopeFit as SlopeFit, fit_slopes as fit_slopes
from ._solution import RESULTS as RESULTS
from ._streaming import least_squares_stream as least_squares_stream

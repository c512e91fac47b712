from ._compiled import (
    filled_up as filled_up,
    regressor_of as regressor_of,
    require_float64 as require_float64,
)
from ._correlated import ERRORS as ERRORS, Errors as Errors, effective_counts as effective_counts
from ._equations import Equations as Equations
from ._factors import JointFactors as JointFactors, factorise as factorise
from ._folds import fit_without_each as fit_without_each, held_out_errors as held_out_errors
from ._held import Held as Held, Known as Known
from ._identification import Identification as Identification
from ._least_squares import (
    JointWeights as JointWeights,
    check_patterns as check_patterns,
    check_words as check_words,
    checked as checked,
    equations_of as equations_of,
    fit_factors as fit_factors,
    fit_patterns as fit_patterns,
    fit_rows as fit_rows,
    least_squares as least_squares,
)
from ._losses import LOSSES as LOSSES, Loss as Loss
from ._rows import KeptRows as KeptRows
from ._solution import RESULTS as RESULTS
from ._streaming import least_squares_stream as least_squares_stream

from ._missing_terms import missing_terms as missing_terms
from ._systematic_error import (
    SystematicError as SystematicError,
    standard_uncertainty as standard_uncertainty,
    uncertainty_interval as uncertainty_interval,
)
from ._systematic_problem import (
    SystematicProblem as SystematicProblem,
    systematic_error as systematic_error,
)

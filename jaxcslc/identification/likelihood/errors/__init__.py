from ._correlated import CorrelatedErrors as CorrelatedErrors, reported_errors as reported_errors
from ._rows import (
    eliminated_rows as eliminated_rows,
    independent_covariance as independent_covariance,
)
from ._systematic import systematic_errors as systematic_errors

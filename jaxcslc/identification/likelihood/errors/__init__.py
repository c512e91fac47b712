"""Standard errors of maximum likelihood."""

from ._correlated import CorrelatedErrors as CorrelatedErrors, reported_errors as reported_errors
from ._rows import RowSums as RowSums, eliminated_rows as eliminated_rows
from ._systematic import systematic_errors as systematic_errors

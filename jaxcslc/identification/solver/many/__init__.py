"""Factors of many patterns: by matrix products, on several devices, in a stream; refinement."""

from ._correction import (
    corrected as corrected,
    needs_correction as needs_correction,
    residual_sums as residual_sums,
)
from ._preconditioned import Preconditioner as Preconditioner, factors_of as factors_of
from ._sharded import shard_patterns as shard_patterns
from ._streaming import (
    are_many as are_many,
    factors_of_patterns as factors_of_patterns,
    factors_of_stream as factors_of_stream,
    residual_sums_of as residual_sums_of,
)

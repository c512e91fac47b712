from ._maximum_likelihood import (
    LikelihoodFit as LikelihoodFit,
    MaximumLikelihood as MaximumLikelihood,
)
from ._signs import runs as runs
from ._start import TorqueSampling as TorqueSampling

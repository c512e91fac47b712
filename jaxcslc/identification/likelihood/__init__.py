from ._maximum_likelihood import (
    LikelihoodFit as LikelihoodFit,
    MaximumLikelihood as MaximumLikelihood,
)
from ._start import TorqueSampling as TorqueSampling

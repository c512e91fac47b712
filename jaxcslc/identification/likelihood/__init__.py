from ._maximum_likelihood import (
    LikelihoodFit as LikelihoodFit,
    MaximumLikelihood as MaximumLikelihood,
)
from ._readings import TorqueSampling as TorqueSampling
from ._signs import runs as runs

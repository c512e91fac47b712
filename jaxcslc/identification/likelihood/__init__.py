from ._comparison import (
    Estimator as Estimator,
    EstimatorComparison as EstimatorComparison,
    calibration_lines as calibration_lines,
    estimator_text as estimator_text,
    lengths_line as lengths_line,
)
from ._left_out import LeftOut as LeftOut
from ._likelihood_fit import LikelihoodFit as LikelihoodFit, Misfit as Misfit
from ._maximum_likelihood import MaximumLikelihood as MaximumLikelihood
from ._signs import runs as runs
from .selection import (
    ModelSelection as ModelSelection,
    NoiseExcitation as NoiseExcitation,
    NoiseOrders as NoiseOrders,
    OrderChoice as OrderChoice,
    SpacingTrial as SpacingTrial,
)
from .torque import TorqueSampling as TorqueSampling, TorqueUnknown as TorqueUnknown
from .transmission import Transmission as Transmission

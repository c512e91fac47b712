"""Estimators by name: objects that `identify` fits a problem with."""

from ._estimator import (
    AbstractEstimator as AbstractEstimator,
    Fit as Fit,
    Judged as Judged,
    held_out_of as held_out_of,
    residual as residual,
)
from ._instruments import SimulatedMotion as SimulatedMotion
from ._least_squares import Regression as Regression
from ._maximum_likelihood import (
    Likelihood as Likelihood,
    within_memory as within_memory,
)
from ._registry import ESTIMATORS as ESTIMATORS

"""Estimators by name, as `identify` and the command know them."""

from collections.abc import Mapping
from types import MappingProxyType

from ._estimator import AbstractEstimator
from ._instruments import SimulatedMotion
from ._least_squares import Regression
from ._maximum_likelihood import Likelihood


ESTIMATORS: Mapping[str, AbstractEstimator] = MappingProxyType(
    {
        "least-squares": Regression(),
        "maximum-likelihood": Likelihood(),
        "instrumental-variables": SimulatedMotion(),
        "auto": Likelihood(always=False),
    }
)
"""Estimators of `identify` and of the command, by name."""

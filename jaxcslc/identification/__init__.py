"""Identification: from recordings and a network to a report.

recordings ──► Problem ──► estimators ──► judgement ──► Report

- `_identify`: the pipeline.
- `_problem`: settings, patterns and what is known.
- `_estimator`, `_registry`: estimators by name.
- `_exclusions`: what is not combined, one table.
"""

from ._estimator import AbstractEstimator as AbstractEstimator, Fit as Fit
from ._identify import identify as identify
from ._instruments import SimulatedMotion as SimulatedMotion
from ._least_squares import Regression as Regression
from ._maximum_likelihood import Likelihood as Likelihood
from ._problem import recording_named as recording_named
from ._registry import ESTIMATORS as ESTIMATORS
from ._torque_constants import (
    TorqueConstants as TorqueConstants,
    fit_torque_constants as fit_torque_constants,
    identify_torque_constants as identify_torque_constants,
)


__all__ = [
    "ESTIMATORS",
    "AbstractEstimator",
    "TorqueConstants",
    "fit_torque_constants",
    "identify",
    "identify_torque_constants",
]

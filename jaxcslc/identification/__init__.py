"""Identification: from recordings and a network to a report.

recordings ──► Problem ──► estimators ──► judgement ──► Report

- `_identify`: the pipeline, and estimators by name.
- `_problem`: settings, patterns and what is known.
- `_estimator`, `_least_squares`, `_likelihood`: estimators.
- `_exclusions`: what is not combined, one table.
- `_torque_constants`: torque per motor current.
"""

from ._estimator import AbstractEstimator as AbstractEstimator, Fit as Fit
from ._exclusions import (
    BODIES as BODIES,
    LIKELIHOOD as LIKELIHOOD,
    OFFSETS as OFFSETS,
    PREVIOUS as PREVIOUS,
    SEVERAL as SEVERAL,
)
from ._identify import ESTIMATORS as ESTIMATORS, identify as identify
from ._least_squares import Regression as Regression, SimulatedMotion as SimulatedMotion
from ._likelihood import Likelihood as Likelihood
from ._problem import recording_named as recording_named
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

"""Settings: the numbers they refuse, and what they read from files."""

from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.least_squares import settings_from
from jaxcslc.recordings import AbstractSmoothing, CentralDifferences


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("torque_alignment", "next", "torque alignment is 'next'"),
        ("joint_weights", "heavy", "joint_weights is 'heavy'"),
        ("torque_lag", float("nan"), "torque lag is nan"),
        ("threshold_fraction", 1.0, "threshold fraction is 1.0"),
        ("cutoff", 0.0, "cutoff: expected more than 0 Hz"),
    ],
)
def test_settings_refuse_numbers_that_make_no_sense(field: str, value: Any, message: str):
    # Types are checked first where tests check them.
    with pytest.raises((ValueError, TypeError), match=f"{message}|type"):
        jc.Settings().with_options(**{field: value})


def test_a_smoothing_must_state_its_reach():
    class Silent(AbstractSmoothing):
        def smooth(self, time: np.ndarray, position: np.ndarray):
            return CentralDifferences().smooth(time, position)

        def low_pass(self, time: np.ndarray, signal: np.ndarray):
            return signal

        @property
        def description(self) -> str:
            return "silent"

    with pytest.raises(TypeError, match=r"abstract method .?reach"):
        Silent()  # pyright: ignore[reportAbstractUsage]


def test_flat_documents_of_earlier_versions_are_read():
    flat = {
        "smoothing": {"method": "averaged_splines", "spacing": [9, 17], "sections": True},
        "torque_alignment": "mean",
        "torque_lag": 0.003,
        "threshold_fraction": 0.1,
        "backlash": True,
        "cutoff": 8.0,
        "joint_weights": "equal",
        "trim": None,
        "thresholds": [0.1, 0.2],
        "loss": "huber",
        "errors": "independent",
    }
    settings = settings_from(flat)
    preparation, solver = settings.preparation, settings.solver
    assert preparation.smoothing == jc.AveragedSplines((9, 17))
    assert (preparation.torque_lag, preparation.thresholds) == (0.003, (0.1, 0.2))
    assert (solver.cutoff, solver.joint_weights, solver.loss) == (8.0, "equal", "huber")
    for entries, message in (
        ({"cut": 8.0}, "unknown entry 'cut'"),
        ({"preparation": {"cut": 8.0}}, "unknown entry 'cut'"),
        ({"solver": 3}, "settings, solver: expected entries"),
        ({"smoothing": {"method": "magic"}}, "expected a method out of"),
        ({"smoothing": {"method": ["butterworth"]}}, "expected a method out of"),
        (
            {"smoothing": {"method": "averaged_splines", "spacing": "9"}},
            "settings, smoothing, spacing: expected a whole number or a list of numbers, got '9'",
        ),
        ({"trim": "x"}, "settings, trim: expected a whole number or nothing, got 'x'"),
        ({"torque_lag": [0]}, r"settings, torque_lag: expected a number, got \[0\]"),
        ({"loss": ["huber"]}, "settings, loss: expected 'squared' or 'huber' or 'bisquare'"),
        ({"backlash": 1}, "settings, backlash: expected true or false, got 1"),
        ({"chosen_on": 3}, "settings, chosen_on: expected entries, got 3"),
        ({"chosen_on": {"interval": "x"}}, "settings, chosen_on, interval: expected a number"),
    ):
        with pytest.raises(ValueError, match=message):
            settings_from(entries)

"""Thresholds of static friction among the settings."""

import json

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.least_squares import settings_document, settings_from


SETTINGS = jc.Settings(jc.Preparation(jc.AveragedSplines(17)))


@pytest.fixture
def swing() -> jc.Recording:
    """12 s of a joint that swings to and fro."""
    phase = np.outer(np.arange(6000) * 0.002, [3.1, 7.3, 12.7])
    q = (np.sin(phase) @ np.array([0.9, 0.5, 0.12]))[:, None]
    return jc.Recording(phase[:, 0] / 3.1, q, 0.0 * q)


def test_thresholds_take_the_place_of_the_fraction(swing: jc.Recording) -> None:
    settings = SETTINGS.with_options(thresholds=(0.7,))
    patterns = settings.patterns(swing)
    assert np.array_equal(np.asarray(patterns.friction_mask), np.abs(np.asarray(patterns.qd)) > 0.7)
    assert "thresholds 0.7," in str(settings)


def test_thresholds_and_savitzky_golay_in_a_file() -> None:
    preparation = jc.Preparation(jc.SavitzkyGolay(31, 4), thresholds=(0.1, 0.2))
    settings = jc.Settings(preparation, jc.LeastSquares(cutoff=8.0))
    assert settings_from(json.loads(json.dumps(settings_document(settings)))) == settings
    assert str(settings).startswith("Savitzky-Golay of 31 samples and order 4,")


def test_half_a_window_is_trimmed(swing: jc.Recording) -> None:
    settings = jc.Settings(jc.Preparation(jc.SavitzkyGolay(31)))
    assert settings.preparation.trimmed(swing) == 15


@pytest.mark.parametrize("wrong", [-0.1, float("nan"), float("inf")])
def test_thresholds_that_make_no_sense(wrong: float) -> None:
    with pytest.raises(ValueError, match="expected finite numbers, none below 0"):
        jc.Preparation(thresholds=(0.1, wrong))


def test_thresholds_of_another_number_of_joints(swing: jc.Recording) -> None:
    with pytest.raises(ValueError, match="one for each of the 1 joints"):
        jc.Preparation(thresholds=(0.1, 0.2)).patterns(swing)

"""Rotor and link apart: stiffness, play and coefficients of two masses integrated literally."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from scripts.studies.likelihood.elastic_gears import GearFit, fit_with_gears
from scripts.studies.likelihood.two_masses import TwoMasses


STEP, NOISE = 5e-5, 0.05
# Two-sided probability of 1e-4 for a normal variable, in standard errors.
FAR = 4.0


@pytest.fixture(scope="module")
def recording(with_play: TwoMasses) -> jc.Recording:
    return with_play.recording(STEP, NOISE, np.random.default_rng(1))


@pytest.fixture(scope="module")
def fit(network: jc.CSLC, recording: jc.Recording) -> GearFit:
    return fit_with_gears(jc.MaximumLikelihood(), network, recording, (1,))


def test_gears_with_play(fit: GearFit, with_play: TwoMasses) -> None:
    true, gears, identified = with_play, fit.gears, fit.fit
    assert identified.converged and gears.joints == (1,)
    low, high = gears.stiffness_interval[0]
    assert low < gears.stiffness[0] < high < 1.02 * low
    for value, error, expected in (
        (gears.compliance, gears.compliance_error, 1 / true.stiffness),
        (gears.play, gears.play_error, true.play),
        (gears.rotor_inertia, gears.rotor_inertia_error, true.rotor_inertia),
        (np.asarray(identified.k), np.asarray(identified.fit.standard_error), true.k),
    ):
        assert np.all(np.abs(value - expected) < FAR * error)
    assert_allclose(gears.damping, true.damping, rtol=0.02)
    assert np.sqrt(np.mean((gears.link_position - true.link) ** 2)) < 2e-5


def test_rigid_gears_miss_the_coefficients(
    network: jc.CSLC, recording: jc.Recording, fit: GearFit, with_play: TwoMasses
) -> None:
    rigid = jc.MaximumLikelihood().fit(network, recording)
    worst, ours = (np.abs(np.asarray(x.k) - with_play.k).max() for x in (rigid, fit.fit))
    assert worst > 10.0 * ours


def test_gears_without_play(network: jc.CSLC, without_play: TwoMasses) -> None:
    recording = without_play.recording(STEP, NOISE, np.random.default_rng(2))
    fit = fit_with_gears(jc.MaximumLikelihood(), network, recording, (1,))
    gears = fit.gears
    assert fit.fit.converged
    low, high = gears.play_interval[0]
    assert low < 0.0 < high < 2e-4
    assert abs(gears.compliance[0] - 1 / 2500.0) < FAR * gears.compliance_error[0]


def test_joints_that_there_are_not(network: jc.CSLC, recording: jc.Recording) -> None:
    with pytest.raises(ValueError, match="different joints from 1 to 1"):
        fit_with_gears(jc.MaximumLikelihood(), network, recording, (2,))

"""Rotor and link apart: stiffness, play and coefficients of two masses integrated literally."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from scripts.studies.likelihood.two_masses import TwoMasses


STEP, NOISE = 5e-5, 0.05
# Two-sided probability of 1e-4 for a normal variable, in standard errors.
FAR = 4.0


@pytest.fixture(scope="module")
def recording(with_play: TwoMasses) -> jc.Recording:
    return with_play.recording(STEP, NOISE, np.random.default_rng(1))


@pytest.fixture(scope="module")
def fit(network: jc.CSLC, recording: jc.Recording) -> jc.LikelihoodFit:
    return jc.MaximumLikelihood(transmission=(1,)).fit(network, recording)


def test_gears_with_play(fit: jc.LikelihoodFit, with_play: TwoMasses) -> None:
    true, gears = with_play, fit.transmission
    assert fit.converged and gears is not None and gears.joints == (1,)
    low, high = gears.stiffness_interval[0]
    assert low < gears.stiffness[0] < high < 1.02 * low
    for value, error, expected in (
        (gears.compliance, gears.compliance_error, 1 / true.stiffness),
        (gears.play, gears.play_error, true.play),
        (gears.rotor_inertia, gears.rotor_inertia_error, true.rotor_inertia),
        (np.asarray(fit.k), np.asarray(fit.fit.standard_error), true.k),
    ):
        assert np.all(np.abs(value - expected) < FAR * error)
    assert_allclose(gears.damping, true.damping, rtol=0.02)
    assert np.sqrt(np.mean((gears.link_position - true.link) ** 2)) < 2e-5


def test_rigid_gears_miss_the_coefficients(
    network: jc.CSLC, recording: jc.Recording, fit: jc.LikelihoodFit, with_play: TwoMasses
) -> None:
    rigid = jc.MaximumLikelihood().fit(network, recording)
    worst, ours = (np.abs(np.asarray(x.k) - with_play.k).max() for x in (rigid, fit))
    assert worst > 10.0 * ours


def test_gears_without_play(network: jc.CSLC, without_play: TwoMasses) -> None:
    recording = without_play.recording(STEP, NOISE, np.random.default_rng(2))
    fit = jc.MaximumLikelihood(transmission=(1,)).fit(network, recording)
    gears = fit.transmission
    assert fit.converged and gears is not None
    low, high = gears.play_interval[0]
    assert low < 0.0 < high < 2e-4
    assert abs(gears.compliance[0] - 1 / 2500.0) < FAR * gears.compliance_error[0]


def test_start_from_a_fit(network: jc.CSLC, recording: jc.Recording, fit: jc.LikelihoodFit) -> None:
    again = jc.MaximumLikelihood().fit(network, recording, start=fit)
    assert again.converged and again.steps < 10
    assert again.transmission is not None and fit.transmission is not None
    assert_allclose(again.transmission.stiffness, fit.transmission.stiffness, rtol=1e-3)


def test_misfit_of_other_motion(
    network: jc.CSLC, recording: jc.Recording, fit: jc.LikelihoodFit
) -> None:
    """Of the fit's gears it is noise, of rigid ones far more."""
    levels = fit.torque_noise[0], fit.position_noise[0]
    part = recording.between(0.0, 1.5)
    sizes: list[float] = []
    for gears in (fit, None):
        misfit = jc.MaximumLikelihood().misfit(network, part, fit.k, *levels, gears)
        sizes.append(float(np.sqrt(np.mean(misfit.error[misfit.mask] ** 2))))
    assert sizes[0] < 1.3 and sizes[1] > 5.0


def test_report(network: jc.CSLC, recording: jc.Recording, tmp_path: Path) -> None:
    """Text, file and page say what gears are."""
    report = jc.identify(
        network,
        recording,
        settings=jc.Settings(),
        estimator="maximum-likelihood",
        likelihood=jc.MaximumLikelihood(transmission=(1,)),
    )
    assert "transmission of joint 1: stiffness 25" in str(report)
    report.save(tmp_path)
    document = json.loads((tmp_path / "identification.json").read_text())
    (entry,) = document["estimators"]["transmission"]
    assert entry["stiffness_interval"][0] < 2500.0 < entry["stiffness_interval"][1] * 1.01
    assert "transmission of joint 1" in (tmp_path / "index.html").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"transmission": (1,), "presliding_distance": (0.01,)}, "not with presliding_distance"),
        ({"transmission": (1,), "possible": True}, "not with possible"),
    ],
)
def test_options_that_exclude_each_other(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        jc.MaximumLikelihood(**options)


def test_joints_that_there_are_not(network: jc.CSLC, recording: jc.Recording) -> None:
    with pytest.raises(ValueError, match="different joints from 1 to 1"):
        jc.MaximumLikelihood(transmission=(2,)).fit(network, recording)

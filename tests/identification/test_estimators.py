"""`identify` with least squares, with maximum likelihood, and with whichever predicts better."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import Known, Prior
from jaxcslc.identification import ESTIMATORS
from tests import arms


K = np.array([0.5, 0.3, -0.1, 0.2, 0.4])  # inertia, two of gravity, viscous and dry friction
STEP = 2e-3  # of the encoder [rad]


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.pendulum()


def swing(
    network: jc.CSLC, seed: int, *, step: float = STEP, samples: int = 600, noise: float = 0.02
) -> jc.Recording:
    """Fast motion of a pendulum, read by an encoder."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(samples)[:, None]
    rate = np.array([3.0, 7.0, 11.0]) + 0.2 * rng.normal(size=3)
    size = np.array([0.8, 0.3, 0.15])
    phase = rate * t + rng.uniform(0, 2 * np.pi, 3)
    q = np.sum(size * np.sin(phase), axis=1, keepdims=True)
    qd = np.sum(size * rate * np.cos(phase), axis=1, keepdims=True)
    qdd = np.sum(-size * rate**2 * np.sin(phase), axis=1, keepdims=True)
    torque = np.asarray(network.torque(K, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    positions = q if step == 0.0 else step * np.round(q / step)
    return jc.Recording(t[:, 0], positions, torque, velocity=qd)


QUICK: dict[str, Any] = {
    "settings": jc.Settings(),
    "checks": False,
    "systematic": False,
    "possible": "never",
}


@pytest.fixture(scope="module")
def coarse(network: jc.CSLC) -> jc.Report:
    return jc.identify(network, swing(network, 2), swing(network, 1), estimator="auto", **QUICK)


@pytest.mark.parametrize("estimator", list(ESTIMATORS))
def test_nothing_is_chosen_on_the_validation_recording(network: jc.CSLC, estimator: str) -> None:
    """Not the estimator, bodies, settings or friction: another one changes no coefficient."""
    training, validation = swing(network, 0), swing(network, 1)
    # Of another arm, backwards, and of which little is left: it would prefer other coefficients.
    other = jc.Recording(validation.time, validation.position[::-1], -0.1 * validation.torque)
    possible: Any = "never" if estimator == "instrumental-variables" else "auto"
    first, second = (
        jc.identify(
            *(network, training, judge),
            estimator=estimator,
            friction="auto",
            possible=possible,
            checks=False,
            systematic=False,
        )
        for judge in (validation, other)
    )
    assert first.network.names == second.network.names
    assert np.array_equal(first.k, second.k)
    assert np.array_equal(first.fit.standard_error, second.fit.standard_error)
    assert str(first.settings) == str(second.settings)


class TestAuto:
    def test_the_better_one_on_the_last_part_is_used(self, coarse: jc.Report) -> None:
        comparison = coarse.estimators
        assert comparison is not None
        assert (comparison.source, comparison.used) == ("held-out stretch", "maximum-likelihood")
        assert comparison.relative.beyond_chance()
        assert_allclose(coarse.k, comparison.likelihood.k)

    def test_the_validation_recording_judges_the_result(self, coarse: jc.Report) -> None:
        assert coarse.held_out is not None and coarse.held_out.source == "validation"
        rms = coarse.errors["validation"].rms[0]
        assert_allclose(rms, coarse.held_out.held_out, rtol=1e-9)

    def test_it_says_so(self, coarse: jc.Report, tmp_path: Path) -> None:
        text = str(coarse)
        assert "estimators, held-out stretch RMS" in text
        assert "coefficients used: maximum-likelihood" in text
        assert any("recorded velocities are not used" in note for note in coarse.notes)
        coarse.save(tmp_path, pictures=False)
        assert "This report uses maximum-likelihood" in (tmp_path / "index.html").read_text("utf-8")
        saved = jc.load_report(tmp_path, coarse.network.robot)
        assert_allclose(saved.fit.k, coarse.k)

    def test_without_validation_the_last_part_decides(self, network: jc.CSLC) -> None:
        # A motion in which the difference is three times its error: others differ by chance.
        report = jc.identify(network, swing(network, 2), estimator="auto", **QUICK)
        assert report.estimators is not None and report.held_out is not None
        assert report.estimators.relative.beyond_chance()
        assert report.estimators.source == report.held_out.source == "held-out stretch"
        assert report.estimators.used == "maximum-likelihood"

    def test_least_squares_if_there_is_no_difference(self, network: jc.CSLC) -> None:
        slow = swing(network, 0, step=0.0, noise=1.0)
        report = jc.identify(network, slow, estimator="auto", **QUICK)
        assert report.estimators is not None
        assert report.estimators.used == "least-squares"
        assert not report.estimators.relative.beyond_chance()
        alone = jc.identify(network, slow, **QUICK)
        assert_allclose(report.k, alone.k)

    def test_least_squares_if_the_other_fails(self, network: jc.CSLC) -> None:
        short = swing(network, 0, samples=200)
        report = jc.identify(network, short, estimator="auto", **QUICK)
        assert report.estimators is None
        assert any("200 samples are too few to hold" in sentence for sentence in report.warnings)


def test_the_misfit_of_smoothing_is_seen(network: jc.CSLC) -> None:
    """Smoothed motion likes coefficients that make up for smoothing; estimated positions do not."""
    estimator = jc.MaximumLikelihood("sampled")
    unfitted = swing(network, 1, step=2e-4)
    levels = np.array([0.02]), np.array([1e-4])
    attenuated = K * np.array([1.01, 1.0, 1.0, 1.0, 1.0])
    true, other = (estimator.misfit(network, unfitted, k, *levels) for k in (K, attenuated))
    mask = true.mask & other.mask
    assert np.mean(true.error[mask] ** 2) < 0.98 * np.mean(other.error[mask] ** 2)


def test_static_friction_that_regression_leaves_out(network: jc.CSLC) -> None:
    robot = dataclasses.replace(network.robot, friction=("viscous", "dry", "static"))
    static = jc.derive(robot, lengths="numeric")
    report = jc.identify(static, swing(network, 0), estimator="maximum-likelihood", **QUICK)
    assert report.network.names == report.fit.names == tuple(str(r["name"]) for r in report.rows())
    assert report.excitation is not None
    assert report.excitation.variance_inflation.shape == (report.network.size,)


def test_several_recordings(network: jc.CSLC) -> None:
    parts = {"first": swing(network, 0, samples=450), "second": swing(network, 1, samples=500)}
    report = jc.identify(network, parts, estimator="maximum-likelihood", **QUICK)
    assert report.estimators is not None
    assert report.estimators.likelihood.torque_noise.shape == (2, 1)
    assert_allclose(report.k, K, atol=0.02)


def test_options_of_maximum_likelihood(network: jc.CSLC) -> None:
    report = jc.identify(
        network,
        swing(network, 0),
        estimator="maximum-likelihood",
        likelihood=jc.MaximumLikelihood(every=2),
        **QUICK,
    )
    assert report.estimators is not None
    likelihood = report.estimators.likelihood
    assert len(likelihood.position) == (swing(network, 0).samples + 1) // 2
    assert_allclose(report.k, K, atol=0.03)


def test_what_is_known_before_is_kept(network: jc.CSLC) -> None:
    prior = Prior({"kv1": Known(0.25)})
    report = jc.identify(
        network, swing(network, 0), estimator="maximum-likelihood", prior=prior, **QUICK
    )
    assert dict(zip(network.names, np.asarray(report.k), strict=True))["kv1"] == 0.25


class TestBadInput:
    def test_unknown(self, network: jc.CSLC) -> None:
        with pytest.raises((ValueError, TypeError), match="often"):
            jc.identify(network, swing(network, 0), estimator="often")  # type: ignore[arg-type]

    def test_options_of_another_estimator(self, network: jc.CSLC) -> None:
        options = jc.MaximumLikelihood(every=2)
        with pytest.raises(ValueError, match="takes no options of maximum likelihood"):
            jc.identify(network, swing(network, 0), likelihood=options, **QUICK)

    def test_a_re_identification(self, network: jc.CSLC) -> None:
        with pytest.raises(
            ValueError, match="'auto': cannot be combined with previous; expected least-squ"
        ):
            jc.identify(*(network, swing(network, 0)), previous=K, groups=["dry"], estimator="auto")

    def test_too_short_to_be_judged(self, network: jc.CSLC) -> None:
        short = swing(network, 0, samples=200)
        with pytest.raises(ValueError, match="200 samples are too few to hold a stretch out"):
            jc.identify(network, short, estimator="maximum-likelihood", **QUICK)

    def test_too_long_for_memory(self, network: jc.CSLC) -> None:
        with pytest.raises(ValueError, match=r"about \d+ samples: thin the recording"):
            jc.identify(
                *(network, swing(network, 0)),
                estimator="maximum-likelihood",
                memory=1e-5,
                **QUICK,
            )


class TestInstruments:
    def test_they_replace_coefficients_and_say_whether_least_squares_is_biased(
        self, network: jc.CSLC
    ) -> None:
        rough = jc.Settings(jc.Preparation(jc.AveragedSplines(3)))
        options: dict[str, Any] = {**QUICK, "settings": rough}
        recording = swing(network, 0)
        report = jc.identify(network, recording, estimator="instrumental-variables", **options)
        before = jc.identify(network, recording, **options)
        ours, theirs = (np.abs(np.asarray(k) - K)[0] for k in (report.k, before.k))
        assert ours < 0.2 * theirs  # of inertia, which noise of accelerations attenuates
        assert any("least squares is biased" in note for note in report.notes)
        assert report.held_out is not None and report.held_out.source == "held-out stretch"
        assert report.possible is None and report.systematic is None
        alone = jc.InstrumentalVariables(settings=rough).fit(network, recording)
        assert_allclose(report.k, alone.k, rtol=0.01)

    def test_what_they_cannot_do(self, network: jc.CSLC) -> None:
        recording = swing(network, 0)
        options: dict[str, Any] = {**QUICK, "estimator": "instrumental-variables"}
        with pytest.raises(ValueError, match="expected one recording, got 2"):
            jc.identify(network, [recording, recording], **options)
        with pytest.raises(ValueError, match="cannot be combined with possible='always'"):
            options["possible"] = "always"
            jc.identify(network, recording, **options)

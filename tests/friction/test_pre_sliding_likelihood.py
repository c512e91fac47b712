"""Pre-sliding that `identify` chooses, in maximum likelihood: one law in fit, report and files."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import Prior
from jaxcslc.friction import contact_states, state_at
from jaxcslc.identification import ESTIMATORS
from jaxcslc.identification._exclusions import Request
from jaxcslc.identification._identify import choose_friction_terms
from jaxcslc.instruments import prediction_error
from jaxcslc.likelihood import EstimatorComparison


LENGTH, DRY = 0.04, 0.4
OPTIONS = jc.MaximumLikelihood(every=1)
# Sums of a few hundred products in another order, and searches from other starts.
_ROUNDING, _SEARCH = 1e-12, 0.02


def pendulum() -> jc.Manipulator:
    return jc.examples.pendulum()


def swing(network: jc.CSLC, seed: int, *, yields: bool) -> jc.Recording:
    """Motion with many reversals; a state of friction by small steps along a fine path."""
    fine, every = 0.0005 * np.arange(32_000), 20
    rate, size = np.array([2.0, 3.1]), np.array([0.3, 0.2])
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 2)
    path = np.sin(rate * fine[:, None] + phase) @ size
    t = fine[::every]
    angle = rate * t[:, None] + phase
    q, qd, qdd = (
        (trend(angle) @ (size * rate**power))[:, None]
        for power, trend in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
    )
    torque = np.array(network.torque(np.full(network.size, DRY), q, qd, qdd))
    if yields:
        w, states = 0.0, [0.0]
        for change in np.diff(path):
            w += (change - abs(change) * w) / LENGTH
            states.append(w)
        torque[:, 0] += DRY * (np.array(states)[::every] - np.sign(qd[:, 0]))
    torque += 0.02 * np.random.default_rng(seed).normal(size=q.shape)
    return jc.Recording(t, q, torque)


def identified(
    recording: jc.Recording,
    validation: jc.Recording | None = None,
    estimator: str = "maximum-likelihood",
    likelihood: jc.MaximumLikelihood = OPTIONS,
    friction: bool = True,
    simulate: bool = False,
) -> jc.Report:
    return jc.identify(
        jc.derive(pendulum(), lengths="numeric"),
        recording,
        validation,
        jc.Settings(),
        estimator=estimator,
        likelihood=likelihood,
        friction="auto" if friction else None,
        possible="never",
        systematic=False,
        simulate=simulate,
    )


@pytest.fixture(scope="module")
def recordings() -> tuple[jc.Recording, jc.Recording]:
    """To fit, and to judge on."""
    network = jc.derive(pendulum(), lengths="numeric")
    return swing(network, 1, yields=True), swing(network, 2, yields=True)


@pytest.fixture(scope="module")
def report(recordings: tuple[jc.Recording, jc.Recording]) -> jc.Report:
    return identified(*recordings, simulate=True)


def comparison_of(report: jc.Report) -> EstimatorComparison:
    assert report.estimators is not None
    return report.estimators


class TestFit:
    def test_it_is_that_of_the_estimator_with_the_distances_of_the_report(
        self, report: jc.Report, recordings: tuple[jc.Recording, jc.Recording]
    ) -> None:
        assert_allclose(report.presliding_distance, [LENGTH], rtol=0.1)
        estimator = dataclasses.replace(
            OPTIONS,
            presliding_distance=tuple(report.presliding_distance.tolist()),
            torque_sampling="sampled",
            settings=report.settings,
        )
        alone = estimator.fit(report.network, recordings[0])
        error = np.asarray(report.fit.standard_error)
        assert_allclose(np.asarray(alone.k), np.asarray(report.k), atol=_SEARCH * error.min())
        assert_allclose(np.asarray(alone.fit.standard_error), error, rtol=1e-3)

    def test_it_has_the_true_coefficients_within_its_intervals(self, report: jc.Report) -> None:
        """Those of friction that was added without need are 0."""
        names = jc.derive(pendulum(), lengths="numeric").names
        true = np.array([DRY if name in names else 0.0 for name in report.network.names])
        low, high = np.asarray(report.fit.confidence_interval(0.999)).T
        assert np.all((low < true) & (high > true))
        assert np.all(np.abs(np.asarray(report.k) - true) < 0.02)

    def test_a_joint_that_yields_has_no_static_friction_beside(self, report: jc.Report) -> None:
        assert "static" not in report.network.robot.friction_terms

    def test_distances_that_are_given_are_kept(
        self, report: jc.Report, recordings: tuple[jc.Recording, jc.Recording]
    ) -> None:
        """Without a choice of friction, and with one, which then does not try them."""
        options = dataclasses.replace(
            OPTIONS, presliding_distance=tuple(report.presliding_distance.tolist())
        )
        for friction in (False, True):
            result = identified(*recordings, likelihood=options, friction=friction)
            assert result.presliding_distance.tolist() == report.presliding_distance.tolist()
            assert result.pre_sliding is not None
            text = str(result)
            assert "pre-sliding of joint 1: a state along the motion" in text
            assert ("pre-sliding was not tried: its distances are given" in text) == friction


class TestComparison:
    def test_both_estimators_have_states(self, report: jc.Report) -> None:
        """Errors of either are noise; those of a step are ten times as large."""
        comparison = comparison_of(report)
        for rms in comparison.rms_all_samples.values():
            assert_allclose(rms, 0.02, rtol=0.3)
        assert "pre-sliding friction of both estimators, distance: joint 1 0.0" in str(comparison)

    def test_a_stretch_that_is_left_out_begins_with_the_state_of_the_motion_before(
        self, recordings: tuple[jc.Recording, jc.Recording]
    ) -> None:
        report = identified(recordings[0])
        comparison = comparison_of(report)
        assert comparison.source == "held-out stretch"
        for rms in comparison.rms_all_samples.values():
            assert_allclose(rms, 0.02, rtol=0.3)
        assert report.held_out is not None and not report.held_out.beyond_chance

    def test_a_state_does_not_depend_on_where_motion_is_cut(self, report: jc.Report) -> None:
        patterns = report.patterns["training"]
        q = np.asarray(patterns.q)
        whole = np.asarray(contact_states(q, report.presliding_distance, np.zeros(1)))
        start = state_at(patterns, report.presliding_distance, 700)
        after = np.asarray(contact_states(q[700:], report.presliding_distance, start))
        assert_allclose(after, whole[700:], atol=_ROUNDING)

    def test_least_squares_that_are_as_good_with_states_are_kept(
        self, recordings: tuple[jc.Recording, jc.Recording]
    ) -> None:
        """Of exact positions, with the right law. The report has their fit with states beside
        their own, as without another estimator."""
        report = identified(*recordings, estimator="auto")
        comparison = comparison_of(report)
        assert comparison.likelihood.presliding_distance.any()
        assert comparison.used == "least-squares" and not report.presliding_distance.any()
        assert report.pre_sliding is not None
        assert_allclose(
            report.pre_sliding.presliding_distance, comparison.likelihood.presliding_distance
        )
        step = report.errors["training"].rms_all_samples[0]
        motion = report.patterns["training"]
        torque, _ = report.pre_sliding.torque(motion.q, motion.qd, motion.qdd)
        assert np.std(np.asarray(motion.torque - torque)) < 0.3 * step


class TestReport:
    def test_errors_are_those_of_states(self, report: jc.Report) -> None:
        assert report.pre_sliding is not None
        assert np.array_equal(report.pre_sliding.fit.k, report.k)
        for name, patterns in report.patterns.items():
            torque, _ = report.pre_sliding.torque(patterns.q, patterns.qd, patterns.qdd)
            error = np.asarray(patterns.torque - torque)
            assert_allclose(report.errors[name].rms_all_samples[0], np.std(error), rtol=0.01)
            network = report.network_along(name)
            along = network.torque(report.k, patterns.q, patterns.qd, patterns.qdd)
            assert_allclose(along, torque, atol=_ROUNDING)

    def test_simulated_motion_is_that_of_the_coefficients_with_states(
        self, report: jc.Report, recordings: tuple[jc.Recording, jc.Recording]
    ) -> None:
        assert report.horizon is not None
        assert tuple(report.horizon.error) == ("fit",)
        expected = prediction_error(
            report.network,
            {"fit": np.asarray(report.k)},
            recordings[1],
            report.settings,
            presliding_distance={"fit": report.presliding_distance},
        )
        assert_allclose(report.horizon.error["fit"], expected.error["fit"])

    def test_files_have_one_set_of_coefficients(self, report: jc.Report, tmp_path: Path) -> None:
        report.save(tmp_path, pictures=False)
        document = json.loads((tmp_path / "identification.json").read_text("utf-8"))
        assert document["pre_sliding"]["fit"]["k"] == document["k"]
        assert document["pre_sliding"]["lengths"] == report.presliding_distance.tolist()
        assert document["estimators"]["lengths"] == report.presliding_distance.tolist()
        page = (tmp_path / "index.html").read_text("utf-8")
        assert "Pre-sliding friction of both estimators, distance: joint 1" in page
        rows = np.genfromtxt(tmp_path / "torque_training.csv", delimiter=",", names=True)
        saved = jc.load_report(tmp_path, pendulum())
        assert saved.pre_sliding is not None
        assert np.array_equal(saved.pre_sliding.fit.k, saved.fit.k)
        assert np.array_equal(saved.fit.k, report.k)
        patterns = report.patterns["training"]
        torque, _ = saved.pre_sliding.torque(patterns.q, patterns.qd, patterns.qdd)
        assert_allclose(rows["predicted_1"], np.asarray(torque)[:, 0], rtol=1e-8, atol=1e-8)


class TestFrictionThatDoesNotYield:
    def test_nothing_changes(self) -> None:
        """The fit is the one that the chosen terms have without a choice."""
        recording = swing(jc.derive(pendulum(), lengths="numeric"), 3, yields=False)
        report = identified(recording)
        assert report.pre_sliding is None and not report.presliding_distance.any()
        assert report.friction is not None
        assert not any(trial.used for trial in report.friction.trials)
        assert report.network_along("training") is report.network
        terms = report.friction.network
        same = jc.identify(
            terms,
            recording,
            settings=jc.Settings(),
            estimator="maximum-likelihood",
            likelihood=OPTIONS,
            possible="never",
            systematic=False,
        )
        assert np.array_equal(same.k, report.k)
        assert comparison_of(same).rms.keys() == comparison_of(report).rms.keys()


@pytest.mark.parametrize(
    ("estimator", "likelihood", "reason"),
    [
        ("auto", jc.MaximumLikelihood(prior=Prior()), "coefficients are known beforehand"),
        (
            "instrumental-variables",
            None,
            "the estimator 'instrumental-variables' does not support it",
        ),
    ],
)
def test_what_pre_sliding_is_not_tried_with(
    estimator: str,
    likelihood: jc.MaximumLikelihood | None,
    reason: str,
    recordings: tuple[jc.Recording, jc.Recording],
) -> None:
    request = Request(
        jc.derive(pendulum(), lengths="numeric"),
        {"swing": recordings[0]},
        settings=jc.Settings(),
        estimator=estimator,
        supports=ESTIMATORS[estimator].supports,
        likelihood=likelihood,
    )
    friction = choose_friction_terms(request, request, lambda _: None)
    assert friction.tried is None and friction.not_tried == reason
    assert friction.request.likelihood is likelihood

"""One sequence of steps from recordings to a report, for every estimator."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.control import PID, Reference
from jaxcslc.identification import (
    ESTIMATORS,
    AbstractEstimator,
    Fit,
    Regression,
    SimulatedMotion,
    _problem,
)
from jaxcslc.identification._exclusions import EXCLUSIONS, FEATURES, Request, excluded
from jaxcslc.identification._problem import Problem, prepare, with_friction
from tests import arms


K = np.array([0.5, 0.3, -0.1, 0.2, 0.4])  # inertia, two of gravity, viscous and dry friction
NOISE = 0.02


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.pendulum()


def swing(network: jc.CSLC, seed: int, samples: int = 1200, noise: float = NOISE) -> jc.Recording:
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(samples)[:, None]
    rate = np.array([1.1, 2.3, 3.7]) + 0.2 * rng.normal(size=3)
    size, start = np.array([0.8, 0.3, 0.2]), rng.uniform(0, 2 * np.pi, 3)
    phase = rate * t + start
    q = np.sum(size * np.sin(phase), axis=1, keepdims=True)
    qd = np.sum(size * rate * np.cos(phase), axis=1, keepdims=True)
    qdd = np.sum(-size * rate**2 * np.sin(phase), axis=1, keepdims=True)
    torque = np.asarray(network.torque(K, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    return jc.Recording(t[:, 0], q, torque)


class Ridge(AbstractEstimator):
    """Least squares with a penalty on the coefficients: (XᵀX + w I) k = Xᵀ torque."""

    def __init__(self, weight: float) -> None:
        self.weight = weight

    @property
    def supports(self) -> frozenset[str]:
        return frozenset()

    def fit(self, problem: Problem) -> Fit:
        patterns, network = problem.patterns["training"], problem.network
        start = Regression().fit(problem)
        mask = np.asarray(patterns.mask).ravel()
        motion = (np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        rows = np.asarray(network.regressor(*motion)).reshape(-1, network.size)[mask]
        torque = np.asarray(patterns.torque).ravel()[mask]
        k = np.linalg.solve(rows.T @ rows + self.weight * np.eye(network.size), rows.T @ torque)
        changed = dataclasses.replace(start.identification, k=jnp.asarray(k))
        return dataclasses.replace(start, identification=changed)


@pytest.mark.parametrize("weight", [0.0, 30.0])
def test_an_estimator_needs_no_more_than_a_fit(network: jc.CSLC, weight: float) -> None:
    recording = swing(network, 0)
    report = jc.identify(
        network, recording, settings=jc.Settings(), estimator=Ridge(weight), checks=False
    )
    before = jc.identify(network, recording, settings=jc.Settings(), checks=False)
    ours, theirs = (np.linalg.norm(np.asarray(x.k)) for x in (report, before))
    if weight:
        assert ours < 0.99 * theirs
    else:
        assert_allclose(report.k, before.fit.k, rtol=1e-8)
    assert report.held_out is not None and report.held_out.source == "held-out stretch"
    assert_allclose(report.held_out.held_out, NOISE, rtol=0.2 if not weight else 9.0)
    assert report.errors["training"].rms[0] >= before.errors["training"].rms[0] * (1 - 1e-9)
    judged = jc.identify(
        network, recording, swing(network, 1), jc.Settings(), estimator=Ridge(weight), checks=False
    )
    assert judged.held_out is not None and judged.held_out.source == "validation"
    assert_allclose(judged.held_out.held_out, judged.errors["validation"].rms[0])


def test_direct_dynamics_is_an_estimator() -> None:
    """Torques under a known controller give the coefficients; no note tests for a bias."""
    network = arms.turntable("viscous")
    t = np.arange(1000)[:, None] * 0.002
    desired = Reference(0.5 - 0.5 * np.cos(4 * t), 2 * np.sin(4 * t), 8 * np.cos(4 * t))
    motion = jc.instruments.ControlledMotion(
        PID(1, position_gain=200.0, velocity_gain=20.0), desired
    )
    true = np.array([0.5, 0.2])
    start = jc.Recording(t[:, 0], desired.q, desired.q)
    q, qd, qdd = motion.simulate(network, true, start, jc.Settings())
    recording = jc.Recording(t[:, 0], q, true[0] * qdd + true[1] * qd)
    report = jc.identify(
        network,
        recording,
        recording.rows(slice(800)),
        jc.Settings(),
        estimator=SimulatedMotion(jc.DirectDynamics(motion)),
        checks=False,
    )
    assert_allclose(report.k, true, atol=5e-3)
    assert not any("biased" in note for note in report.notes)


def test_what_it_does_not_support_is_said(network: jc.CSLC) -> None:
    recording = swing(network, 0)
    with pytest.raises(ValueError, match="estimator 'Ridge': expected one recording, got 2"):
        jc.identify(network, [recording, recording], estimator=Ridge(0.0))
    with pytest.raises(
        ValueError, match="estimator 'Ridge': cannot be combined with possible='always'"
    ):
        jc.identify(network, recording, estimator=Ridge(0.0), possible="always")


def test_misfit_is_in_units_of_the_noise(network: jc.CSLC) -> None:
    request = Request(network, {"swing": swing(network, 0)}, settings=jc.Settings())
    problem = with_friction(prepare(request, None, lambda words: None))
    estimator = Regression()
    fit = estimator.fit(problem)
    other = [swing(network, 1)]
    right = estimator.misfit(problem, fit, other)
    assert_allclose(np.std(right.error[right.mask]), 1.0, rtol=0.1)
    k = dataclasses.replace(fit.identification, k=1.2 * fit.k)
    wrong = estimator.misfit(problem, dataclasses.replace(fit, identification=k), other)
    assert np.std(wrong.error[wrong.mask]) > 5.0


def test_one_recording_is_several_of_one(network: jc.CSLC) -> None:
    recording = swing(network, 0)
    options: dict[str, Any] = {"settings": jc.Settings(), "checks": False}
    alone = jc.identify(network, recording, **options)
    for listed in ([recording], {"a.csv": recording}):
        report = jc.identify(network, listed, **options)
        assert np.array_equal(report.k, alone.k)
        assert str(report) == str(alone)


def test_settings_are_chosen_once(network: jc.CSLC, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen: list[str] = []
    select = _problem.selection_with_motion

    def counted(*arguments: Any, **options: Any) -> Any:
        chosen.append("again")
        return select(*arguments, **options)

    monkeypatch.setattr(_problem, "selection_with_motion", counted)
    report = jc.identify(
        network,
        swing(network, 0),
        friction="auto",
        checks=False,
        systematic=False,
        possible="never",
    )
    assert len(chosen) == 1
    assert report.selection is not None and report.friction is not None


def test_static_friction_that_is_chosen_keeps_slow_pairs(network: jc.CSLC) -> None:
    """Settings that were chosen before mask them by the fractions that they would have got."""
    request = Request(network, {"swing": swing(network, 0)})
    chosen = _problem.select_settings(request, lambda words: None)
    fraction = chosen.selection.settings.preparation.threshold_fraction
    assert isinstance(fraction, float)
    kinds = [("viscous", "dry", "static")]
    later = dataclasses.replace(request, network=network.with_joint_friction(kinds))
    settings = _problem.basic_settings(later, chosen)
    assert settings.preparation.threshold_fraction == (round(0.1 * fraction, 12),)
    same = _problem.basic_settings(request, chosen)
    assert same.preparation.threshold_fraction == fraction


class TestExclusions:
    def test_all_features_exist(self) -> None:
        for row in EXCLUSIONS:
            for name in row.features:
                feature = name.removeprefix("not ").removeprefix("unsupported ")
                assert feature in FEATURES
        for estimator in ESTIMATORS.values():
            assert estimator.supports <= FEATURES.keys()

    def test_a_feature_may_be_asked_about(self, network: jc.CSLC) -> None:
        request = Request(
            network, {"swing": swing(network, 0)}, supports=ESTIMATORS["least-squares"].supports
        )
        assert excluded(request, "friction of the load") is None
        assert excluded(request, "pre-sliding") is None
        longer = dataclasses.replace(request, simulate=True)
        reason = excluded(longer, "friction of the load")
        assert reason is not None and "simulation" in reason
        several = dataclasses.replace(
            request, training={**request.training, "b": swing(network, 1)}
        )
        assert excluded(several, "pre-sliding") == "several recordings are fitted together"
        other = dataclasses.replace(request, supports=frozenset(), estimator="ridge")
        assert excluded(other, "pre-sliding") == "the estimator 'ridge' does not support it"


def test_a_file_as_prior_does_not_hide_too_few_equations() -> None:
    """Without enough equations nothing is fitted, whatever the robot's file knows."""
    network = jc.derive(jc.puma560().with_friction("viscous", "dry"), lengths="numeric")
    time = np.arange(21) / 200.0
    position = np.stack([0.3 * np.sin((6.0 + 2.0 * j) * time + j) for j in range(6)], axis=1)
    torque = np.random.default_rng(0).standard_normal(position.shape)
    recording = jc.Recording(time, position, torque)  # three samples are left by trimming
    with pytest.raises(RuntimeError, match="Fewer equations than coefficients"):
        jc.identify(network, recording, settings=jc.Settings(), checks=False, systematic=False)

"""Drift of coefficients between recordings: intervals that hold for a further recording."""

import dataclasses

import numpy as np
import pytest
import scipy

import jaxcslc as jc
from jaxcslc.least_squares import LeastSquares
from jaxcslc.uncertainty import DRIFT, SystematicError, fit_recordings
from jaxcslc.uncertainty._drift import drift_of
from tests import arms


@pytest.fixture(scope="module")
def panda() -> jc.CSLC:
    return jc.derive(jc.panda(), lengths="numeric")


@pytest.mark.parametrize(("recordings", "size"), [(2, 0.03), (3, 0.1), (5, 0.05), (3, 0.0)])
def test_intervals_hold_for_a_further_recording(
    panda: jc.CSLC, rng: np.random.Generator, recordings: int, size: float
) -> None:
    """Friction drifts, bodies do not; errors of fits are of all sizes."""
    p = panda.size
    friction = np.isin(np.arange(p), panda.layout.friction)
    held: dict[str, list[float]] = {"with": [], "without": [], "bodies": []}
    for _ in range(12):
        k = np.where(friction, np.exp(rng.normal(size=p)), rng.normal(size=p))
        error = np.where(friction, 0.01 * np.abs(k), 0.05) * np.exp(0.7 * rng.normal(size=p))
        error = np.broadcast_to(error, (recordings, p))
        deviation = np.where(friction, size * np.abs(k) * np.exp(0.4 * rng.normal(size=p)), 0.0)
        alone = k + np.hypot(deviation, error) * rng.normal(size=(recordings, p))
        value, common = alone.mean(axis=0), error[0] / np.sqrt(recordings)
        drift = drift_of(panda, value, common, alone, error)
        further = np.abs(k + deviation * rng.normal(size=p) - value)
        inside = further < 1.96 * np.hypot(common, drift.allowance)
        held["with"].append(inside[friction].mean())
        held["without"].append((further < 1.96 * common)[friction].mean())
        held["bodies"].append(inside[~friction].mean())
        if not size:
            assert not drift.drifting.any()
    assert 0.91 < np.mean(held["with"]) <= 1.0
    assert 0.95 < np.mean(held["bodies"]) <= 1.0
    assert np.mean(held["without"]) < 0.4 or not size


def test_two_recordings_of_one_coefficient_by_sampling(rng: np.random.Generator) -> None:
    """Against draws from the distributions before anything is seen, weighted by likelihood."""
    network = jc.derive(jc.examples.turntable("viscous"))
    alone = np.array([[0.5, 2.0], [0.5, 2.3]])
    errors = np.array([[0.01, 0.02], [0.01, 0.04]])
    error = np.sqrt(1.0 / np.sum(errors**-2.0, axis=0))
    value = error**2 * np.sum(alone / errors**2, axis=0)
    drift = drift_of(network, value, error, alone, errors)
    usual = np.sqrt(1.0 / np.mean(errors[:, 1] ** -2.0))
    draws = 400_000
    group = 0.05 * np.hypot(value[1], usual) * np.abs(rng.standard_cauchy(draws))
    tau = group * np.exp(0.7 * rng.standard_normal(draws))
    likelihood = scipy.stats.norm.pdf(0.3, scale=np.sqrt(np.sum(errors[:, 1] ** 2) + 2 * tau**2))
    order = np.argsort(tau)
    share = np.cumsum(likelihood[order]) / likelihood.sum()
    assert np.isclose(drift.deviation[1], tau[order][np.searchsorted(share, 0.5)], rtol=0.15)
    weights = errors[:, 1] ** -2.0 / np.sum(errors[:, 1] ** -2.0)
    spread = np.sqrt(error[1] ** 2 + tau**2 * (1.0 + np.sum(weights**2)))
    half = 1.96 * np.hypot(error[1], drift.allowance[1])
    outside = 2.0 * scipy.stats.norm.cdf(-half / spread)
    assert abs(np.sum(likelihood * outside) / likelihood.sum() - 0.05) < 0.005
    assert drift.drifting.tolist() == [False, True]
    assert str(drift).startswith("coefficients that drift between recordings: kv1 by ")


def test_a_recording_that_determines_nothing_says_nothing(panda: jc.CSLC) -> None:
    p = panda.size
    alone, errors = np.ones((3, p)), np.full((3, p), 0.1)
    without = drift_of(panda, np.ones(p), np.full(p, 0.07), alone[:2], errors[:2])
    alone[2], errors[2] = 1e9, np.inf
    with_it = drift_of(panda, np.ones(p), np.full(p, 0.07), alone, errors)
    np.testing.assert_allclose(with_it.allowance, without.allowance)
    assert not with_it.drifting.any()
    assert str(with_it) == "no coefficient drifts between recordings beyond chance"


def test_friction_that_drifts_is_named_and_widens_intervals(rng: np.random.Generator) -> None:
    """The friction of an arm of two joints changes by a tenth from recording to recording."""
    network = arms.elbow()
    k = np.array([0.3, 0.4, 0.45, 0.5, 0.6, 0.65, 0.7, 0.8, 0.85, 0.9, 1.0, 1.05, 1.1, 1.2])
    friction = network.layout.friction
    patterns: dict[str, jc.Patterns] = {}
    for number in range(4):
        t = 0.02 * np.arange(600)
        rate = np.array([1.1, 1.7]) + 0.1 * number
        angle = np.outer(t, rate) + number
        q, qd, qdd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
        own = k.copy()
        own[friction] *= 1.0 + 0.1 * rng.standard_normal(len(friction))
        torque = np.asarray(network.torque(own, q, qd, qdd)) + 0.01 * rng.standard_normal(q.shape)
        pairs = np.ones(q.shape, bool)
        patterns[f"run {number}"] = jc.Patterns(t, q, qd, qdd, torque, pairs, pairs)
    several = fit_recordings(network, patterns, LeastSquares(errors="independent"))
    drifting = np.flatnonzero(several.drift.drifting)
    assert len(drifting) and {*drifting} <= {*friction}
    assert 0.03 < np.median((several.drift.deviation / np.abs(several.fit.k))[friction]) < 0.25
    none = SystematicError({"smoothing": np.zeros(network.size)})
    changed, error = several.allowing_for(dict.fromkeys(patterns, none))
    np.testing.assert_allclose(error.parts[DRIFT], changed.drift.allowance)
    half = several.allowing_for(dict.fromkeys(patterns, none), 0.5 * np.eye(network.size))[1]
    np.testing.assert_allclose(half.parts[DRIFT], 0.5 * error.parts[DRIFT])


def test_the_report_says_which_coefficients_drift(rng: np.random.Generator) -> None:
    network = jc.derive(jc.examples.turntable())
    recordings: dict[str, jc.Recording] = {}
    for name, viscous in (("cold", 2.0), ("warm", 1.5)):
        exact = jc.examples.swing_recording(network, [0.5, viscous, 1.0])
        noise = 0.01 * rng.standard_normal(exact.torque.shape)
        recordings[name] = dataclasses.replace(exact, torque=exact.torque + noise)
    settings = jc.Settings(jc.Preparation(threshold_fraction=0.05))
    report = jc.identify(network, recordings, settings=settings, checks=False)
    sentence = "coefficients that drift between recordings: kv1 by "
    assert sentence in str(report) and sentence in str(report.page(charts=False))
    (row,) = [row for row in report.rows() if row["name"] == "kv1"]
    assert float(row["low"]) <= 1.5 and float(row["high"]) >= 2.0

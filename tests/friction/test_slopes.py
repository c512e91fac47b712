"""Slopes of static friction by variable projection: round trips, an oracle, errors that cover."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares as scipy_least_squares

import jaxcslc as jc
from tests.patterns import ORDINARY


ROWS = [(0.0, 0.0, 0.0, 0.0), ("pi/2", 0.3, 0.0, 0.0)]
SLOPES = np.array([12.0, 4.0])


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh(ROWS, friction=("viscous", "dry", "static"))
    return jc.derive(robot, lengths="numeric").with_static_slopes(SLOPES)


def recorded(
    network: jc.CSLC, noise: float, rng: np.random.Generator
) -> tuple[np.ndarray, jc.Patterns]:
    """Random states, many of them slow, their torque, and the coefficients behind it."""
    q, qd, qdd = rng.uniform(-1.5, 1.5, (3, 1500, 2))
    qd *= rng.uniform(0, 1, qd.shape) ** 2
    k = rng.uniform(0.5, 1.5, network.size)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    pairs = np.ones(q.shape, bool)
    return k, jc.Patterns(0.01 * np.arange(len(q)), q, qd, qdd, torque, pairs, pairs)


def test_recovers_slopes_and_coefficients(network: jc.CSLC, rng: np.random.Generator) -> None:
    k, patterns = recorded(network, 0.0, rng)
    result = jc.fit_slopes(network.with_static_slopes([1.0, 100.0]), patterns, solver=ORDINARY)
    assert_allclose(result.slopes, SLOPES, rtol=1e-6)
    assert_allclose(result.fit.k, k, rtol=1e-6)
    assert bool(result.converged)
    assert np.array_equal(np.asarray(result.network.static_slopes), result.slopes)
    assert "slopes [12 ± " in repr(result)


def test_is_the_minimum_that_scipy_finds(network: jc.CSLC, rng: np.random.Generator) -> None:
    """All parameters at once, from the truth; and its Jacobian's covariance."""
    k, patterns = recorded(network, 0.1, rng)
    result = jc.fit_slopes(network, patterns, start=np.array([6.0, 6.0]), solver=ORDINARY)
    rigid = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    indices = [network.names.index(name) for name in ("ks1", "ks2")]
    speed, sign = np.abs(patterns.qd), np.sign(patterns.qd)

    def residual(x: np.ndarray) -> np.ndarray:
        columns = rigid.copy()
        columns[:, [0, 1], indices] = sign * np.exp(-x[-2:] * speed)
        return np.ravel(columns @ x[:-2] - patterns.torque)

    oracle = scipy_least_squares(residual, np.concatenate([k, SLOPES]), x_scale="jac", xtol=1e-14)
    assert_allclose(result.fit.k, oracle.x[:-2], rtol=1e-4)
    assert_allclose(result.slopes, oracle.x[-2:], rtol=1e-4)
    degrees_of_freedom = oracle.fun.size - oracle.x.size
    covariance = (
        np.linalg.inv(oracle.jac.T @ oracle.jac) * np.sum(oracle.fun**2) / degrees_of_freedom
    )
    errors = np.sqrt(np.diag(covariance))
    assert_allclose(result.fit.standard_error, errors[:-2], rtol=1e-3)
    assert_allclose(result.slope_error, errors[-2:], rtol=1e-3)


def test_errors_cover_the_truth(network: jc.CSLC, rng: np.random.Generator) -> None:
    """40 slopes of 20 recordings: the chance that 33 or fewer 95 % intervals hold them is 1e-3."""
    within = 0
    for _ in range(20):
        _, patterns = recorded(network, 0.1, rng)
        result = jc.fit_slopes(network, patterns, start=SLOPES, solver=ORDINARY)
        within += int(
            np.sum(np.abs(np.asarray(result.slopes) - SLOPES) < 1.96 * result.slope_error)
        )
    assert within > 33


def test_correlated_errors_count_repeated_samples_once(
    network: jc.CSLC, rng: np.random.Generator
) -> None:
    """Every sample ten times over: as many equations, no more to learn from."""
    _, once = recorded(network, 0.1, rng)
    once = jax.tree.map(lambda x: x[:400], once)
    often = jax.tree.map(lambda x: np.repeat(x, 10, axis=0), once)
    single = jc.fit_slopes(network, once, start=SLOPES, solver=ORDINARY)
    as_independent = jc.fit_slopes(network, often, start=SLOPES, solver=ORDINARY)
    correlated = dataclasses.replace(ORDINARY, errors="correlated")
    as_correlated = jc.fit_slopes(network, often, start=SLOPES, solver=correlated)
    assert_allclose(as_independent.slopes, single.slopes, rtol=1e-5)
    assert np.all(np.asarray(as_independent.slope_error) < 0.4 * np.asarray(single.slope_error))
    ratio = np.asarray(as_correlated.slope_error) / np.asarray(single.slope_error)
    assert np.all((ratio > 0.6) & (ratio < 1.6))
    assert as_correlated.fit.errors == "correlated"


def test_weights_by_residual_and_pairs_left_out(network: jc.CSLC, rng: np.random.Generator) -> None:
    """A joint that is noisy, and pairs that are wrong but do not count."""
    k, patterns = recorded(network, 0.0, rng)
    torque = patterns.torque + rng.normal(size=patterns.q.shape) * np.array([1e-3, 1.0])
    wrong = rng.random(torque.shape) < 0.1
    torque[wrong] += 100.0
    friction_mask = ~wrong
    patterns = jc.Patterns(
        patterns.time,
        patterns.q,
        patterns.qd,
        patterns.qdd,
        torque,
        patterns.backlash_mask,
        friction_mask,
    )
    result = jc.fit_slopes(network, patterns, solver=jc.LeastSquares(errors="independent"))
    assert_allclose(result.slopes[0], SLOPES[0], rtol=0.01)
    assert_allclose(result.fit.k[network.names.index("ks1")], k[network.names.index("ks1")], 0.01)


def test_static_friction_of_one_joint_only(rng: np.random.Generator) -> None:
    robot = jc.Manipulator.from_modified_dh(ROWS).with_friction("dry", "static", joint=2)
    network = jc.derive(robot, lengths="numeric").with_static_slopes(SLOPES)
    _, patterns = recorded(network, 0.0, rng)
    result = jc.fit_slopes(network, patterns, start=np.array([3.0, 9.0]), solver=ORDINARY)
    assert_allclose(result.slopes, [3.0, 4.0], rtol=1e-6)  # joint 1's is not used
    assert float(result.slope_error[0]) == 0.0


def test_nothing_slow_tells_no_slope(network: jc.CSLC, rng: np.random.Generator) -> None:
    """No static friction in the torque: the search ends, and no error is small."""
    _, patterns = recorded(network, 0.1, rng)
    k = np.zeros(network.size)
    torque = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    torque = torque + 0.1 * rng.normal(size=torque.shape)
    patterns = jc.Patterns(
        patterns.time, patterns.q, patterns.qd, patterns.qdd, torque, patterns.backlash_mask,
        patterns.friction_mask,
    )  # fmt: skip
    result = jc.fit_slopes(network, patterns, solver=ORDINARY)
    assert np.all(np.isfinite(result.fit.k))
    assert np.all(np.asarray(result.slope_error) > 0.2 * np.asarray(result.slopes))
    assert result.dropped and len(result.warnings) == len(result.dropped)
    for joint, sentence in zip(result.dropped, result.warnings, strict=True):
        assert sentence.startswith(f"joint {joint}: static friction dropped, its slope is not")
        assert f"ks{joint}" not in result.network.names
    assert result.fit.names == result.network.names


def test_a_parabola_of_speed_is_no_static_friction(rng: np.random.Generator) -> None:
    """Torque of v|v| at joint 1, which slopes near zero would follow with huge coefficients that
    cancel: the slope stays within the observed speeds, and the term is dropped."""
    robot = jc.Manipulator.from_modified_dh(ROWS, friction=("viscous", "dry", "static"))
    network = jc.derive(robot, lengths="numeric").with_static_slopes(SLOPES)
    _, patterns = recorded(network, 0.02, rng)
    parabola = patterns.qd * np.abs(patterns.qd) * np.array([0.8, 0.0])
    ks1 = network.names.index("ks1")
    k = np.where(np.arange(network.size) == ks1, 0.0, 1.0)
    torque = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd)) + parabola
    torque = torque + 0.02 * rng.normal(size=torque.shape)
    result = jc.fit_slopes(network, dataclasses.replace(patterns, torque=torque), solver=ORDINARY)
    assert result.dropped == (1,)
    assert "at the end of the observed speeds" in result.warnings[0]
    assert "ks1" not in result.network.names and "ks2" in result.network.names
    assert bool(result.fit.meaningful)
    assert np.max(np.abs(np.asarray(result.fit.k))) < 10.0
    assert_allclose(result.slopes[1], SLOPES[1], rtol=0.1)


@pytest.mark.parametrize("options", [{"cutoff": 10.0}, {"loss": "huber"}, {"loss": "bisquare"}])
def test_takes_every_option_of_the_solver(
    network: jc.CSLC, options: dict[str, Any], rng: np.random.Generator
) -> None:
    """Without noise all options have the same minimum, outliers under a robust loss included."""
    t = 0.01 * np.arange(1500)[:, None]
    rate = np.array([1.7, 2.3])
    q, qd, qdd = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    k = rng.uniform(0.5, 1.5, network.size)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + 1e-6 * rng.normal(size=q.shape)
    if "loss" in options:
        torque[rng.random(torque.shape) < 0.02] += 30.0
    pairs = np.ones(q.shape, bool)
    patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, pairs, pairs)
    result = jc.fit_slopes(network, patterns, solver=jc.LeastSquares(**options))
    assert_allclose(result.slopes, SLOPES, rtol=1e-3)
    assert result.dropped == () and result.fit.errors == "correlated"


def test_kuka_recording_leaves_no_meaningless_static_friction() -> None:
    """A recording on which free slopes fell to 1e-5 s/rad, with coefficients of 1e8 N m."""
    data = next(
        (p / "shared" / "data" / "kuka_kr300" for p in Path(__file__).parents
         if (p / "shared" / "data" / "kuka_kr300").is_dir()), None
    )  # fmt: skip
    if data is None:
        pytest.skip("no recordings of a KUKA KR 300 in shared/data/kuka_kr300")
    robot = jc.load_robot(data / "kr300.toml").with_friction("viscous", "dry", "static")
    network = jc.derive(robot, lengths="numeric")
    recording = jc.load_recording(data / "A.csv", joints=network.joint_count)
    result = jc.fit_slopes(network, jc.Settings().patterns(recording))
    assert bool(result.fit.meaningful)
    for joint in range(network.joint_count):
        if joint + 1 not in result.dropped:
            assert float(result.slope_error[joint]) < float(result.slopes[joint])
    assert np.max(np.abs(np.asarray(result.fit.k))) < 1e5


def test_refused(network: jc.CSLC, rng: np.random.Generator) -> None:
    _, patterns = recorded(network, 0.0, rng)
    bare = jc.derive(network.robot.with_friction("dry"), lengths="numeric")
    with pytest.raises(ValueError, match="'robot' has no static friction, whose slopes could be"):
        jc.fit_slopes(bare, patterns, solver=ORDINARY)
    with pytest.raises(ValueError, match="static slopes: expected numbers above 0"):
        jc.fit_slopes(network, patterns, start=np.array([1.0, -1.0]), solver=ORDINARY)

"""Slopes of static friction by variable projection: round trips, an oracle, errors that cover."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares as scipy_least_squares

import jaxcslc as jc

from .conftest import ORDINARY


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
    found = jc.fit_slopes(network.with_static_slopes([1.0, 100.0]), patterns, solver=ORDINARY)
    assert_allclose(found.slopes, SLOPES, rtol=1e-6)
    assert_allclose(found.fit.k, k, rtol=1e-6)
    assert bool(found.settled)
    assert np.array_equal(np.asarray(found.network.static_slopes), found.slopes)
    assert "slopes [12 ± " in repr(found)


def test_is_the_minimum_that_scipy_finds(network: jc.CSLC, rng: np.random.Generator) -> None:
    """All parameters at once, from the truth; and its Jacobian's covariance."""
    k, patterns = recorded(network, 0.1, rng)
    found = jc.fit_slopes(network, patterns, start=np.array([6.0, 6.0]), solver=ORDINARY)
    rigid = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    places = [network.names.index(name) for name in ("ks1", "ks2")]
    speed, sign = np.abs(patterns.qd), np.sign(patterns.qd)

    def residual(x: np.ndarray) -> np.ndarray:
        columns = rigid.copy()
        columns[:, [0, 1], places] = sign * np.exp(-x[-2:] * speed)
        return np.ravel(columns @ x[:-2] - patterns.torque)

    oracle = scipy_least_squares(residual, np.concatenate([k, SLOPES]), x_scale="jac", xtol=1e-14)
    assert_allclose(found.fit.k, oracle.x[:-2], rtol=1e-4)
    assert_allclose(found.slopes, oracle.x[-2:], rtol=1e-4)
    degrees_of_freedom = oracle.fun.size - oracle.x.size
    covariance = (
        np.linalg.inv(oracle.jac.T @ oracle.jac) * np.sum(oracle.fun**2) / degrees_of_freedom
    )
    errors = np.sqrt(np.diag(covariance))
    assert_allclose(found.fit.standard_error, errors[:-2], rtol=1e-3)
    assert_allclose(found.slope_error, errors[-2:], rtol=1e-3)


def test_errors_cover_the_truth(network: jc.CSLC, rng: np.random.Generator) -> None:
    """40 slopes of 20 recordings: the chance that 33 or fewer 95 % intervals hold them is 1e-3."""
    within = 0
    for _ in range(20):
        _, patterns = recorded(network, 0.1, rng)
        found = jc.fit_slopes(network, patterns, start=SLOPES, solver=ORDINARY)
        within += int(np.sum(np.abs(np.asarray(found.slopes) - SLOPES) < 1.96 * found.slope_error))
    assert within > 33


def test_blocks_see_noise_that_hangs_together(network: jc.CSLC, rng: np.random.Generator) -> None:
    """Every sample fifty times over: as many equations, no more to learn from."""
    _, once = recorded(network, 0.1, rng)
    once = jax.tree.map(lambda x: x[:400], once)
    often = jax.tree.map(lambda x: np.repeat(x, 10, axis=0), once)
    single = jc.fit_slopes(network, once, start=SLOPES, solver=ORDINARY)
    taken_for_new = jc.fit_slopes(network, often, start=SLOPES, solver=ORDINARY)
    in_blocks = jc.fit_slopes(network, often, start=SLOPES, blocks=40, solver=ORDINARY)
    assert_allclose(taken_for_new.slopes, single.slopes, rtol=1e-5)
    assert np.all(np.asarray(taken_for_new.slope_error) < 0.4 * np.asarray(single.slope_error))
    ratio = np.asarray(in_blocks.slope_error) / np.asarray(single.slope_error)
    assert np.all((ratio > 0.6) & (ratio < 1.6))


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
    found = jc.fit_slopes(network, patterns, solver=jc.LeastSquares(errors="independent"))
    assert_allclose(found.slopes[0], SLOPES[0], rtol=0.01)
    assert_allclose(found.fit.k[network.names.index("ks1")], k[network.names.index("ks1")], 0.01)


def test_static_friction_of_one_joint_only(rng: np.random.Generator) -> None:
    robot = jc.Manipulator.from_modified_dh(ROWS).with_friction("dry", "static", joint=2)
    network = jc.derive(robot, lengths="numeric").with_static_slopes(SLOPES)
    _, patterns = recorded(network, 0.0, rng)
    found = jc.fit_slopes(network, patterns, start=np.array([3.0, 9.0]), solver=ORDINARY)
    assert_allclose(found.slopes, [3.0, 4.0], rtol=1e-6)  # joint 1's is not used
    assert float(found.slope_error[0]) == 0.0


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
    found = jc.fit_slopes(network, patterns, solver=ORDINARY)
    assert np.all(np.isfinite(found.fit.k))
    assert np.all(np.asarray(found.slope_error) > 0.2 * np.asarray(found.slopes))


def test_refused(network: jc.CSLC, rng: np.random.Generator) -> None:
    _, patterns = recorded(network, 0.0, rng)
    bare = jc.derive(network.robot.with_friction("dry"), lengths="numeric")
    with pytest.raises(ValueError, match="'robot' has no static friction, whose slopes could be"):
        jc.fit_slopes(bare, patterns, solver=ORDINARY)
    with pytest.raises(ValueError, match="1 blocks; expected 2 or more"):
        jc.fit_slopes(network, patterns, blocks=1, solver=ORDINARY)
    with pytest.raises(ValueError, match="static slopes: expected numbers above 0"):
        jc.fit_slopes(network, patterns, start=np.array([1.0, -1.0]), solver=ORDINARY)

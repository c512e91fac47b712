"""What equations of sampled torque leave out: against means that are integrated finely."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import EquationPoint, MotionEquations, triangle_mean
from tests import arms


K = np.array([0.5, 0.3, -0.1, 0.2, 0.4])


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum("viscous", "dry")


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fast, and never backwards."""
    t = time[:, None]
    return 6 * t + np.sin(5 * t), 6 + 5 * np.cos(5 * t), -25 * np.sin(5 * t)


@pytest.mark.parametrize("uneven", [0.0, 0.2])
def test_equations_are_means_of_torque(pendulum: jc.CSLC, uneven: float) -> None:
    rng = np.random.default_rng(0)
    intervals = 0.01 * (1.0 + uneven * rng.uniform(-1.0, 1.0, 199))
    time = np.concatenate([[0.0], np.cumsum(intervals)])
    q = motion(time)[0]
    equations = MotionEquations(pendulum, intervals)
    one_way, slopes = np.ones((198, 1)), np.zeros(1)
    at = EquationPoint(K, slopes, q, -one_way, one_way)
    predicted = equations.torque(at)
    part = np.zeros(200, int)
    missing = equations.truncation(at, time, part)
    recorded = triangle_mean(time, np.asarray(pendulum.torque(K, *motion(time))))
    # The same mean by Gauss's quadrature over both sides of each triangle.
    nodes, weights = np.polynomial.legendre.leggauss(5)
    x, weight = (nodes + 1) / 2, weights / 2
    before, after = intervals[:-1], intervals[1:]
    mean = np.zeros((198, 1))
    for side in (-before, after):
        for node, share in zip(x, weight, strict=True):
            torque = np.asarray(pendulum.torque(K, *motion(time[1:-1] + node * side)))
            part_of_mean = 2.0 * np.abs(side) / (before + after) * (1.0 - node) * share
            mean += part_of_mean[:, None] * torque
    inner = slice(3, -3)
    second_order = np.abs(predicted - mean)[inner].max()
    assert second_order > 2e-3
    # Uneven intervals leave a part of third order.
    share = 0.01 if uneven == 0.0 else 0.15
    assert_allclose((predicted + missing)[inner], mean[inner], atol=share * second_order)
    assert_allclose((predicted + missing)[inner], recorded[inner], atol=share * second_order)


def test_two_recordings(pendulum: jc.CSLC) -> None:
    """Nothing is taken over from one to the other."""
    time = 0.01 * np.arange(120)
    q = np.concatenate([motion(time[:60])[0], 1.0 - motion(time[:60])[0]])
    part = np.repeat([0, 1], 60)
    ahead, slopes = np.ones((118, 1)), np.zeros(1)
    direction = np.where(np.arange(118)[:, None] < 59, 1.0, -1.0)
    both = MotionEquations(pendulum, np.full(119, 0.01)).truncation(
        EquationPoint(K, slopes, q, -ahead, direction), time, part
    )
    alone = MotionEquations(pendulum, np.full(59, 0.01)).truncation(
        EquationPoint(K, slopes, q[60:], -ahead[60:], direction[60:]), time[60:], part[:60]
    )
    assert_allclose(both[60:], alone, atol=1e-12)
    assert_allclose(both[58:60], 0.0, atol=1e-12)


def test_errors_of_exact_torque_are_those_of_noise(pendulum: jc.CSLC) -> None:
    """At 100 Hz and without noise of torque, they would be several standard errors."""
    time = 0.01 * np.arange(400)
    torque = np.asarray(pendulum.torque(K, *motion(time)))
    deviations = []
    for seed in range(4):
        noise = 1e-5 * np.random.default_rng(seed).normal(size=(400, 1))
        recording = jc.Recording(time, motion(time)[0] + noise, torque)
        result = jc.MaximumLikelihood(torque_sampling="sampled", resolution=(0.0,)).fit(
            pendulum, recording
        )
        assert result.converged
        deviations.append((np.asarray(result.k) - K) / np.asarray(result.fit.standard_error))
    # Motion one way tells dry and viscous friction apart by its changes of speed.
    assert 0.3 < np.sqrt(np.mean(np.square(deviations))) < 1.6

"""Counts as intervals: densities, derivatives, what is outside, and the spread of scores."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from jaxcslc.likelihood._laws import Intervals, interval, score_share


EDGE = 0.03
RESIDUAL = np.linspace(-0.6, 0.6, 241)  # steps


def edges(width: float = EDGE) -> np.ndarray:
    return np.full_like(RESIDUAL, width)


def test_it_is_the_probability_of_a_count() -> None:
    expected = ndtr((0.5 - RESIDUAL) / EDGE) - ndtr((-0.5 - RESIDUAL) / EDGE)
    assert_allclose(np.exp(-0.5 * interval(RESIDUAL, edges()).value), expected, rtol=1e-10)
    # Residuals of all sizes are possible, and their densities add up to one step.
    wide = np.linspace(-1.0, 1.0, 4001)
    density = np.exp(-0.5 * interval(wide, np.full_like(wide, EDGE)).value)
    assert_allclose(np.trapezoid(density, wide), 1.0, rtol=1e-4)


def test_derivatives_are_those_of_the_value() -> None:
    step = 1e-5
    low, middle, high = (interval(RESIDUAL + x, edges()) for x in (-step, 0.0, step))
    slope = 0.5 * (high.value - low.value) / (2 * step)
    assert_allclose(middle.weight * middle.residual, slope, atol=1e-5)
    score = (high.weight * high.residual - low.weight * low.residual) / (2 * step)
    assert_allclose(middle.weight, np.maximum(score, 1e-2), rtol=1e-5, atol=1e-3)


def test_far_outside_it_counts_by_its_size() -> None:
    far = interval(np.array([1.0, 2.0, 3.0, -3.0]), np.full(4, EDGE))
    first, second, third, mirrored = far.value
    assert_allclose(third - second, second - first, rtol=1e-9)
    assert_allclose(mirrored, third, rtol=1e-12)
    assert np.all(far.weight > 0.0)


def test_mixed_readings() -> None:
    """A joint of counts beside one of normally distributed readings."""
    rng = np.random.default_rng(0)
    step, weight = 1e-3, rng.uniform(1.0, 2.0, (50, 2))
    residual = step * rng.uniform(-0.5, 0.5, (50, 2))
    share = rng.uniform(0.1, 1.0, (50, 2))
    edge = np.tile([EDGE, 0.0], (50, 1))
    working = Intervals(share, np.full((50, 2), step), edge).working(residual, weight)
    assert_allclose(working.value[:, 1], weight[:, 1] * residual[:, 1] ** 2)
    assert_allclose(working.weight[:, 1], weight[:, 1])
    alone = interval(residual[:, 0] / step, edge[:, 0])
    assert_allclose(working.value[:, 0], share[:, 0] * alone.value)
    assert_allclose(working.weight[:, 0] * step**2, share[:, 0] * alone.weight)


@pytest.mark.parametrize("width", [0.01, 0.04])
def test_errors_of_a_mean_are_those_of_the_sandwich(width: float) -> None:
    """A constant read with uniform noise: the maximum's spread, over many draws."""
    rng = np.random.default_rng(1)
    readings, draws = 1000, 200
    noise = rng.uniform(-0.5, 0.5, (draws, readings))
    value, edge = np.zeros((draws, 1)), np.full((draws, readings), width)
    for _ in range(15):
        working = interval(noise - value, edge)
        change = np.sum(working.weight * working.residual, axis=1) / np.sum(working.weight, axis=1)
        value += np.clip(change, -width, width)[:, None]
    bound = 1.0 / np.mean(np.sum(interval(noise - value, edge).weight, axis=1))
    expected = np.sqrt(bound * score_share(np.array([width]))[0])
    assert_allclose(np.std(value), expected, rtol=0.15)
    # Several times better than the mean of the readings.
    assert np.std(value) < 0.5 / np.sqrt(12 * readings)

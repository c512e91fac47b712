"""Savitzky-Golay smoothing: what it reproduces exactly, an independent fit, and what it refuses."""

import re

import numpy as np
import pytest

from jaxcslc.recordings import SavitzkyGolay


INTERVAL = 0.002


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("samples", [15, 200])
def test_polynomials_of_its_order_are_reproduced(
    rng: np.random.Generator, order: int, samples: int
) -> None:
    """At the ends of the record too."""
    time = np.arange(samples) * INTERVAL
    scale = time[-1]
    polynomials = [
        np.polynomial.Polynomial(c, domain=[0.0, scale], window=[-1.0, 1.0])
        for c in rng.standard_normal((3, order + 1))
    ]
    position = np.stack([p(time) for p in polynomials], axis=1)
    for derivative, values in enumerate(SavitzkyGolay(15, order).smooth(time, position)):
        truth = np.stack([p.deriv(derivative)(time) for p in polynomials], axis=1)
        np.testing.assert_allclose(values, truth, atol=1e-8 * np.max(np.abs(truth)))


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_each_sample_is_the_middle_of_a_fitted_polynomial(
    rng: np.random.Generator, order: int
) -> None:
    position = rng.standard_normal((60, 2))
    smoothed = SavitzkyGolay(11, order).smooth(np.arange(60) * INTERVAL, position)
    for sample in (5, 17, 54):
        near = position[sample - 5 : sample + 6]
        coefficients = np.polynomial.polynomial.polyfit(np.arange(-5, 6), near, order)
        for derivative, values in enumerate(smoothed):
            expected = (1, 1, 2)[derivative] * coefficients[derivative] / INTERVAL**derivative
            np.testing.assert_allclose(values[sample], expected, rtol=1e-8)


def test_orders_differ_only_where_their_powers_have_a_part(rng: np.random.Generator) -> None:
    time, position = np.arange(80) * INTERVAL, rng.standard_normal((80, 1))
    two, three, four = (SavitzkyGolay(21, order).smooth(time, position) for order in (2, 3, 4))
    inside = slice(10, 70)
    for even, odd in ((two[0], three[0]), (two[2], three[2]), (three[1], four[1])):
        np.testing.assert_allclose(even[inside], odd[inside], atol=1e-9 * np.max(np.abs(odd)))
    assert not np.allclose(three[2][inside], four[2][inside])


def test_it_is_linear_and_reverses_with_time(rng: np.random.Generator) -> None:
    time = np.arange(100) * INTERVAL
    one, other = rng.standard_normal((2, 100, 3))
    smoothing = SavitzkyGolay(13, 4)
    together = smoothing.smooth(time, 2.0 * one - other)
    singly = zip(smoothing.smooth(time, one), smoothing.smooth(time, other), strict=True)
    for both, (a, b) in zip(together, singly, strict=True):
        np.testing.assert_allclose(both, 2.0 * a - b, atol=1e-9 * np.max(np.abs(both)))
    back = smoothing.smooth(time, one[::-1])
    for sign, there, reverse in zip((1, -1, 1), smoothing.smooth(time, one), back, strict=True):
        np.testing.assert_allclose(sign * reverse[::-1], there, atol=1e-9 * np.max(np.abs(there)))


def test_low_pass_is_its_position(rng: np.random.Generator) -> None:
    time, signal = np.arange(50) * INTERVAL, rng.standard_normal((50, 2))
    smoothing = SavitzkyGolay(9)
    assert np.array_equal(smoothing.low_pass(time, signal), smoothing.smooth(time, signal)[0])


@pytest.mark.parametrize(
    ("window", "order", "message"),
    [
        (10, 3, "window is 10 samples; expected an odd number from 3 on"),
        (1, 2, "window is 1 samples"),
        (9, 1, "polynomial order is 1; expected at least 2"),
        (5, 5, "less than the window of 5 samples"),
    ],
)
def test_settings_that_make_no_sense(window: int, order: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SavitzkyGolay(window, order)


def test_recordings_that_it_cannot_use() -> None:
    time = np.arange(20) * INTERVAL
    with pytest.raises(ValueError, match="20 samples; expected 21 or more for a window"):
        SavitzkyGolay(21).smooth(time, time[:, None])
    with pytest.raises(ValueError, match=re.escape("time is not uniform")):
        SavitzkyGolay(5).smooth(time**2, time[:, None])

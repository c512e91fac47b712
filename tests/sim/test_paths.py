"""Paths: what each of them promises of its shape, its ends and its rest."""

import numpy as np

import sim
from sim._paths import MinimumJerk, Oscillation


def test_minimum_jerk_is_a_rest_to_rest_quintic():
    s = np.linspace(0, 1, 11)
    path = np.polynomial.Polynomial.fit(s, sim.minimum_jerk(s), 5)
    path = path.convert()
    assert path.degree() == 5
    for derivative in (path.deriv(1), path.deriv(2)):
        np.testing.assert_allclose([derivative(0.0), derivative(1.0)], 0.0, atol=1e-9)
    beyond = np.array([-0.5, 0.0, 1.0, 3.0])
    assert sim.minimum_jerk(beyond).tolist() == [0.0, 0.0, 1.0, 1.0]


def test_minimum_jerk_path_runs_straight_from_where_it_begins(rng: np.random.Generator):
    origin, end = rng.normal(size=(4, 3)), rng.normal(size=3)
    path = MinimumJerk(end, 2.0)
    at = [path.position(np.full((4, 1), time), origin) for time in (0.0, 1.0, 2.0, 5.0)]
    for found, expected in zip(at, [origin, (origin + end) / 2, end, end], strict=True):
        np.testing.assert_allclose(found, np.broadcast_to(expected, (4, 3)), atol=1e-15)


def test_oscillation_begins_at_rest_and_has_its_mean():
    mean, amplitude, period = np.array([0.3, -1.0]), np.array([0.2, 0.0]), 0.8
    path = Oscillation(mean, amplitude, period)
    time = np.linspace(0.0, period, 1000, endpoint=False)[:, None]
    positions = path.position(time, np.zeros((1000, 2)))
    np.testing.assert_allclose(positions.mean(0), mean, atol=1e-14)
    np.testing.assert_allclose(positions[0], mean - amplitude)
    np.testing.assert_allclose(positions[500], mean + amplitude)
    # At rest: it leaves with the square of the time, 2 (π / 1000)² of an amplitude a sample.
    np.testing.assert_allclose(positions[1] - positions[0], 2e-5 * amplitude, rtol=0.02)

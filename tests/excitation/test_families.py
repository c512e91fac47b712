"""Families of motions: derivatives, rest at both ends, bounds at all times, scaling."""

from collections.abc import Callable

import numpy as np
import pytest

from jaxcslc.excitation import AbstractFamily, BSplines, FourierSeries, MinimumJerkMoves


FAMILIES = [
    FourierSeries(5.0, 5),
    FourierSeries(5.0, 5, periodic=False),
    BSplines(5.0, 12),
    MinimumJerkMoves(5.0, 4),
]
JOINTS = 3


@pytest.fixture(params=FAMILIES, ids=lambda family: family.description)
def family(request: pytest.FixtureRequest) -> AbstractFamily:
    return request.param


@pytest.fixture
def parameters(family: AbstractFamily, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(family.size, JOINTS))


def test_starts_where_its_first_row_says_at_rest_unaccelerated(
    family: AbstractFamily, parameters: np.ndarray
) -> None:
    q, qd, qdd = family.motion(parameters, np.array([0.0, family.duration]))
    np.testing.assert_allclose(q[0], parameters[0], atol=1e-12)
    np.testing.assert_allclose([qd, qdd], 0.0, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_are_those_of_central_differences(
    family: AbstractFamily, parameters: np.ndarray, order: int
) -> None:
    time = np.linspace(0.013, family.duration - 0.013, 401)  # beside the knots
    step = 1e-5
    before, after = (family.derivative(parameters, time + x, order - 1) for x in (-step, step))
    exact = family.derivative(parameters, time, order)
    scale = np.abs(exact).max()
    error = np.abs((after - before) / (2 * step) - exact) / scale
    assert np.quantile(error, 0.99) < 1e-6  # jerk of moves jumps where they meet


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_bounds_hold_at_all_times(
    family: AbstractFamily, parameters: np.ndarray, order: int
) -> None:
    time = np.linspace(0.0, family.duration, 4001)
    reached = np.abs(family.derivative(parameters, time, order)).max(0)
    bound = family.bound(parameters, order)
    assert np.all(reached <= bound * (1 + 1e-9))
    assert np.all(reached > 0.1 * bound)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_what_lies_between_samples_is_bounded(
    family: AbstractFamily, parameters: np.ndarray, order: int
) -> None:
    interval = 0.05
    coarse, fine = (np.arange(0.0, 5.0 + 1e-9, step) for step in (interval, interval / 20))
    seen, all_of_it = (
        np.abs(family.derivative(parameters, time, order)).max(0) for time in (coarse, fine)
    )
    between = family.between_samples(parameters, order, interval)
    assert np.all(all_of_it <= seen + between * (1 + 1e-9))


def test_scaling_is_about_the_start(family: AbstractFamily, parameters: np.ndarray) -> None:
    time = np.linspace(0.0, family.duration, 50)
    whole = family.derivative(parameters, time)
    half = family.derivative(family.scaled(parameters, 0.5), time)
    np.testing.assert_allclose(half - parameters[0], (whole - parameters[0]) / 2, atol=1e-10)


def test_periodic_series_end_where_they_start(rng: np.random.Generator) -> None:
    family = FourierSeries(3.0, 4)
    q = family.derivative(rng.normal(size=(family.size, 2)), np.array([0.0, 3.0]))
    np.testing.assert_allclose(q[0], q[1], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BSplines(0.0), "duration is 0.0; expected more than 0 s"),
        (lambda: BSplines(1.0, 2), "intervals: expected 3 or more, got 2"),
        (lambda: FourierSeries(1.0, 1), "harmonics: expected 2 or more, got 1"),
        (lambda: MinimumJerkMoves(1.0, 0), "moves: expected 1 or more, got 0"),
    ],
)
def test_wrong_sizes_are_named(make: Callable[[], AbstractFamily], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()

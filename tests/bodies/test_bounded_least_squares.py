"""Least squares within lower bounds, against SciPy's trust regions."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from jaxcslc.bodies._principal_programme import BoundedMinimum, bounded_least_squares


# Both end where the sum of squares changes by less than 1e-10 of itself.
TOLERANCE = 1e-10


def searched(
    residual: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    low: np.ndarray,
    evaluations: int = 400,
) -> BoundedMinimum:
    return bounded_least_squares(
        residual, jacobian, start, low, tolerance=TOLERANCE, evaluations=evaluations
    )


@pytest.mark.parametrize("unknowns", [1, 4, 12])
def test_linear_problems_have_the_bounded_solution(rng: np.random.Generator, unknowns: int) -> None:
    matrix, target = rng.normal(size=(30, unknowns)), rng.normal(size=30)
    low = np.where(np.arange(unknowns) % 3 == 2, -np.inf, 0.0)
    start = np.ones(unknowns)
    minimum = searched(lambda x: matrix @ x - target, lambda x: matrix, start, low)
    exact = lsq_linear(matrix, target, (low, np.full(unknowns, np.inf)), tol=1e-14).x
    assert minimum.converged
    assert np.all(minimum.x >= low)
    np.testing.assert_allclose(minimum.x, exact, atol=1e-6)


@pytest.mark.parametrize("beyond", [0.0, 2.0])
def test_curved_problems_have_the_minimum_of_scipy(rng: np.random.Generator, beyond: float) -> None:
    """Products of unknowns, as masses times centres; `beyond` moves the minimum over the bounds."""
    matrix, weights = rng.normal(size=(20, 3)), np.full(3, 0.1)
    target = matrix @ np.array([1.5, 0.6, -beyond])

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([matrix @ [x[0], x[0] * x[1], x[2]] - target, weights * (x - 1.0)])

    def jacobian(x: np.ndarray) -> np.ndarray:
        by_unknown = np.array([[1.0, 0.0, 0.0], [x[1], x[0], 0.0], [0.0, 0.0, 1.0]])
        return np.concatenate([matrix @ by_unknown, np.diag(weights)])

    start, low = np.ones(3), np.array([0.1, -np.inf, 0.0])
    minimum = searched(residual, jacobian, start, low)
    bounds = (low, np.full(3, np.inf))
    exact = least_squares(residual, start, jacobian, bounds, ftol=1e-14, xtol=1e-14, gtol=1e-14)
    assert minimum.converged
    assert minimum.value <= 2.0 * exact.cost * (1.0 + 1e-9)
    np.testing.assert_allclose(minimum.x, exact.x, atol=1e-4)
    assert (minimum.x[2] == 0.0) == (beyond > 0.0)


def test_a_valley_that_is_too_long_is_reported() -> None:
    """Rosenbrock's, whose minimum is (1, 1)."""

    def residual(x: np.ndarray) -> np.ndarray:
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])

    start, low = np.array([-1.2, 1.0]), np.full(2, -np.inf)
    assert not searched(residual, jacobian, start, low, evaluations=5).converged
    minimum = searched(residual, jacobian, start, low)
    assert minimum.converged
    np.testing.assert_allclose(minimum.x, 1.0, atol=1e-6)

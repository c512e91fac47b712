"""Minima of many functions at once are those of one after the other."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from jaxcslc._bounded_search import bounded_minima


def value(x: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Smooth, bent, flat beside a step, with its minimum at a bound, and with two minima."""
    return np.select(
        [kind == 0, kind == 1, kind == 2, kind == 3],
        [np.cosh(3.0 * (x - 0.2)), np.abs(x - 0.61), np.where(x < 0.4, 2.0, x), -x],
        np.sin(9.0 * x) + x,
    )


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5])
def test_every_step_is_that_of_scipy(tolerance: float) -> None:
    kinds = np.arange(5)
    low, high = np.array([-1.0, 0.0, 0.0, 0.0, -0.5]), np.array([1.0, 2.0, 1.0, 1.5, 1.0])
    points: list[list[float]] = [[] for _ in kinds]

    def function(x: np.ndarray, functions: np.ndarray) -> np.ndarray:
        for number, at in zip(functions, x, strict=True):
            points[number].append(float(at))
        return value(x, kinds[functions])

    minima = bounded_minima(function, low, high, np.full(5, tolerance))
    for kind in kinds:
        visited: list[float] = []

        def alone(x: float, kind: int = int(kind), visited: list[float] = visited) -> float:
            visited.append(float(x))
            return float(value(np.array(x), np.array(kind)))

        expected = minimize_scalar(
            alone, bounds=(low[kind], high[kind]), method="bounded", options={"xatol": tolerance}
        )
        assert visited == points[kind]
        assert minima[kind] == expected.x


def test_no_functions() -> None:
    nothing = np.zeros(0)
    assert bounded_minima(lambda x, _: x, nothing, nothing, nothing).size == 0

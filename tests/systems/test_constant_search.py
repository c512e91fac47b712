"""Constants that enter nonlinearly: against SciPy's fit of everything, and an exhaustive search."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc.recordings import Patterns
from jaxcslc.systems import (
    Constant,
    ConstantSearch,
    DescriptionError,
    Simulation,
    System,
    SystemRecording,
    Variable,
    identify_system,
    search_constants,
)
from jaxcslc.systems._search import ProjectedError


jax.config.update("jax_enable_x64", True)

x, y, z = sp.symbols("x y z")
a, b, n, w = sp.symbols("a b n w")
BOUNDS = {"n": (0.1, 3.0), "w": (2.0, 30.0)}


def patterns_of(system: System, **columns: np.ndarray) -> Patterns:
    q = np.stack([columns[variable.name] for variable in system.variables], axis=1)
    still = np.zeros_like(q)
    known = np.asarray(system.network.known(q, still, still))
    mask = np.ones(known.shape, bool)
    return Patterns(0.01 * np.arange(len(q)), q, still, still, known, mask, mask)


def powers() -> System:
    """Two equations that share the exponent and a coefficient."""
    return System(
        "powers",
        {"first": sp.Eq(y, a * x**n), "second": sp.Eq(z, a * x + b * x ** (2 * n))},
        (Variable(x), Variable(y), Variable(z)),
        (Constant(a), Constant(b), Constant(n, bounds=BOUNDS["n"])),
    )


@pytest.fixture(scope="module")
def power_search() -> tuple[Patterns, ConstantSearch]:
    rng = np.random.default_rng(5)
    system, values = powers(), rng.uniform(0.2, 2.0, 400)
    patterns = patterns_of(
        system,
        x=values,
        y=1.5 * values**0.7 + 0.02 * rng.normal(size=400),
        z=1.5 * values - 0.4 * values**1.4 + 0.05 * rng.normal(size=400),
    )
    solver = jc.LeastSquares(errors="independent")
    return patterns, search_constants(system, patterns, solver, starts=8, candidates=32)


def test_values_and_errors_agree_with_a_fit_of_all_constants_at_once(
    power_search: tuple[Patterns, ConstantSearch],
) -> None:
    patterns, search = power_search
    values, first, second = np.asarray(patterns.q).T
    weights = 1.0 / np.asarray(search.fit.torque_error)

    def residual(constants: np.ndarray) -> np.ndarray:
        a, b, n = constants
        return np.concatenate(
            [
                weights[0] * (first - a * values**n),
                weights[1] * (second - a * values - b * values ** (2 * n)),
            ]
        )

    oracle = scipy.optimize.least_squares(residual, [1.0, 0.0, 1.0], xtol=1e-12, ftol=1e-12)
    variance = np.sum(oracle.fun**2) / (len(oracle.fun) - 3)
    errors = np.sqrt(variance * np.diag(np.linalg.inv(oracle.jac.T @ oracle.jac)))
    order = [search.fit.names.index(name) for name in ("a", "b", "n")]
    np.testing.assert_allclose(np.asarray(search.fit.k)[order], oracle.x, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(search.fit.standard_error)[order], errors, rtol=1e-3)
    assert search.values["n"] == pytest.approx(float(search.fit.k[order[2]]))
    assert abs(search.values["n"] - 0.7) < 4 * errors[2]
    assert (
        search.minima[0].starts == search.starts
        and len(search.minima) == 1
        and search.at_bound == ()
    )
    assert "no other was seen" in str(search)
    assert "±" in str(search)


def test_the_gradient_of_the_projected_error_is_exact(
    power_search: tuple[Patterns, ConstantSearch],
) -> None:
    """Kaufman's approximation leaves out a part that the error is orthogonal to."""
    patterns, _ = power_search
    network = powers().network
    problem = ProjectedError.of(network, patterns, np.array([1.0, 0.5]))
    residual = jax.jit(lambda point: problem.residual(point))
    point, step = jnp.array([0.2]), 1e-5
    cost = lambda point: 0.5 * float(np.sum(np.asarray(residual(point)) ** 2))
    slope = (cost(point + step) - cost(point - step)) / (2 * step)
    jacobian = jax.jacfwd(residual)(point)
    assert float((jacobian.T @ residual(point))[0]) == pytest.approx(slope, rel=1e-6)
    # And the error is that of NumPy's least squares at these values.
    values = float(problem.values(point)[0])
    at, first, second = np.asarray(patterns.q).T
    rows = np.concatenate(
        [
            np.stack([at**values, 0 * at], axis=1),
            0.5 * np.stack([at, at ** (2 * values)], axis=1),
        ]
    )
    target = np.concatenate([first, 0.5 * second])
    oracle = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
    np.testing.assert_allclose(np.abs(residual(point)), np.abs(oracle), atol=1e-9)


def test_among_many_minima_the_best_is_that_of_an_exhaustive_search() -> None:
    rng = np.random.default_rng(2)
    values = np.sort(rng.uniform(0.0, 4.0, 300))
    system = System(
        "wave",
        {"height": sp.Eq(y, a * sp.sin(w * x) + b * sp.cos(w * x))},
        (Variable(x), Variable(y)),
        (Constant(a), Constant(b), Constant(w, bounds=BOUNDS["w"])),
    )
    height = np.sin(11.3 * values + 0.4) + 0.1 * rng.normal(size=300)
    patterns = patterns_of(system, x=values, y=height)
    search = search_constants(system, patterns, starts=16, candidates=256)
    grid = np.linspace(*BOUNDS["w"], 5601)

    def error(frequency: float) -> float:
        rows = np.stack([np.sin(frequency * values), np.cos(frequency * values)], axis=1)
        coefficients = np.linalg.lstsq(rows, height, rcond=None)[0]
        return float(np.sqrt(np.mean((height - rows @ coefficients) ** 2)))

    errors = np.array([error(frequency) for frequency in grid])
    assert search.values["w"] == pytest.approx(grid[np.argmin(errors)], abs=0.006)
    assert search.minima[0].error[0] == pytest.approx(np.min(errors), rel=1e-3)
    # Each minimum in the list is one of the exhaustive search, with its error.
    inner = np.flatnonzero((errors[1:-1] < errors[:-2]) & (errors[1:-1] < errors[2:])) + 1
    assert len(search.minima) > 3
    for minimum in search.minima:
        nearest = np.argmin(np.abs(grid[inner] - minimum.values[0]))
        low, high = BOUNDS["w"]
        if low + 0.01 < minimum.values[0] < high - 0.01:
            assert grid[inner][nearest] == pytest.approx(minimum.values[0], abs=0.006)
        assert minimum.error[0] == pytest.approx(error(minimum.values[0]), rel=1e-6)
        assert minimum.ratio == pytest.approx(minimum.error[0] / search.minima[0].error[0])
    assert sum(minimum.starts for minimum in search.minima) == 16
    assert search.minima[0].starts < 16 and 0.0 < search.unexplored <= 1.0
    assert "Others: w = " in str(search)


def test_a_constant_at_its_bound_stays_there_and_is_named(
    power_search: tuple[Patterns, ConstantSearch],
) -> None:
    patterns, _ = power_search
    system = powers()
    constants = (Constant(a), Constant(b), Constant(n, bounds=(1.0, 1.5)))
    bounded = System(system.name, system.equations, system.variables, constants)
    search = search_constants(bounded, patterns, starts=2, candidates=8)
    assert search.at_bound == ("n",)
    assert search.values["n"] == pytest.approx(1.0, abs=1e-4)
    assert search.fit.names == bounded.network.names
    assert "at its bound" in str(search)


def test_a_report_has_searched_constants_and_simulated_motion() -> None:
    """A tank that drains by an unknown power of its level, of exact measurements."""
    level, inflow = dynamicsymbols("level inflow")
    tank = System(
        "tank",
        {"volume": sp.Eq(inflow, a * level.diff() + b * level**n)},
        (Variable(level), Variable(inflow)),
        (Constant(a), Constant(b), Constant(n, bounds=(0.2, 1.5))),
    )

    def recording(speed: float) -> SystemRecording:
        time = 0.05 * np.arange(400)
        height = 2.0 + np.sin(speed * time)
        flow = 3.0 * speed * np.cos(speed * time) + 0.5 * np.sqrt(height)
        return SystemRecording(time, {"level": height, "inflow": flow})

    report = identify_system(tank, recording(1.0), recording(0.8))
    assert report.search is not None
    assert report.search.values["n"] == pytest.approx(0.5, abs=1e-4)
    np.testing.assert_allclose(np.asarray(report.k), [3.0, 0.5], rtol=1e-3)
    assert report.fit.names == ("a", "b")
    assert isinstance(report.simulation, Simulation)
    assert report.simulation.relative_error[0] < 1e-3
    # The known side does not depend on the exponent here; the output does.
    assert float(report.errors["validation"].rms[0][0]) < 1e-3
    assert "searched constants" in str(report) and "simulation, validation" in str(report)


def test_wrong_calls_are_named(power_search: tuple[Patterns, ConstantSearch]) -> None:
    patterns, _ = power_search
    fixed = powers().with_values({"n": 0.7})
    with pytest.raises(DescriptionError, match="no constant is to be searched"):
        search_constants(fixed, patterns)
    with pytest.raises(ValueError, match="starts is 0"):
        search_constants(powers(), patterns, starts=0)

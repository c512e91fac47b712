"""Simulation of identified systems, against solutions in closed form and SciPy's integrator."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
import scipy
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

from jaxcslc.recordings import Patterns
from jaxcslc.systems import Constant, DescriptionError, System, Variable, simulate_system


jax.config.update("jax_enable_x64", True)

x, y, u = symbols = dynamicsymbols("x y u")
a, b, c = sp.symbols("a b c")
# Of an integrator of fifth order with steps of 2.5 ms, relative to motions of about one.
INTEGRATED = 1e-9


def system_of(equations: dict[str, sp.Expr], *constants: Any) -> System:
    used = [v for v in symbols if any(e.has(v) for e in equations.values())]
    variables = tuple(Variable(v) for v in used)
    return System("test", equations, variables, tuple(Constant(k) for k in constants))


def patterns_of(system: System, time: np.ndarray, **columns: np.ndarray) -> Patterns:
    """Of exact values and derivatives: (samples,), or (samples, up to 3 orders)."""
    motion = np.zeros((3, len(time), len(system.variables)))
    for index, variable in enumerate(system.variables):
        values = np.asarray(columns[variable.name], float).reshape(len(time), -1)
        motion[: values.shape[1], :, index] = values.T
    shape = (len(time), len(system.outputs))
    q, qd, qdd = motion
    known = np.asarray(system.network.known(q, qd, qdd))
    return Patterns(time, q, qd, qdd, known, np.ones(shape, bool), np.ones(shape, bool))


@pytest.fixture(scope="module")
def lag() -> System:
    return system_of({"balance": sp.Eq(u, a * x.diff() + b * x)}, a, b)


def test_a_first_order_lag_follows_its_closed_form(lag: System) -> None:
    """a x' + b x = u of a ramp u = t: linear interpolation of the input is exact."""
    time = np.linspace(1.0, 3.0, 201)
    slope, rate = 0.5, 2.0 / 0.5
    t = time - time[0]
    # x = (t + 1) / 2 - 1 / 8 + C exp(-4 t) solves 0.5 x' + 2 x = t + 1.
    exact = (t + 1.0) / 2.0 - 0.125 + 0.3 * np.exp(-rate * t)
    patterns = patterns_of(lag, time, x=exact, u=t + 1.0)
    k = lag.separation.values({"a": slope, "b": 2.0})
    simulation = simulate_system(lag, k, patterns)
    np.testing.assert_allclose(simulation.simulated[:, 0], exact, atol=INTEGRATED)
    assert simulation.names == ("x",)
    assert simulation.follows_for() == pytest.approx(2.0)
    # Another coefficient: the closed form of the other solution, and the error between them.
    other = (t + 1.0) / 2.5 - 0.08 + (exact[0] - 0.32) * np.exp(-5.0 * t)
    wrong = simulate_system(lag, lag.separation.values({"a": 0.5, "b": 2.5}), patterns)
    np.testing.assert_allclose(wrong.simulated[:, 0], other, atol=INTEGRATED)
    assert wrong.error[0] == pytest.approx(np.sqrt(np.mean((other - exact) ** 2)))
    assert wrong.relative_error[0] == pytest.approx(wrong.error[0] / np.std(exact))
    first = np.flatnonzero(np.abs(other - exact) > 0.3 * np.std(exact))[0]
    assert wrong.follows_for(0.3) == pytest.approx(t[first])
    assert "RMS difference" in str(wrong)


def test_coupled_second_and_first_order_states_agree_with_scipy() -> None:
    """A pendulum on a cart whose speed is a state; the mass matrix depends on the motion."""
    system = system_of(
        {
            "hinge": sp.Eq(0, a * x.diff().diff() + b * sp.cos(x) * y.diff() + 9.81 * sp.sin(x)),
            "rail": sp.Eq(u, c * y.diff() + b * sp.cos(x) * x.diff().diff() - x.diff() ** 2),
        },
        *(a, b, c),
    )
    constants = {"a": 1.2, "b": 0.4, "c": 2.0}

    def derivative(t: float, state: np.ndarray) -> list[float]:
        angle, rate, _ = state
        mass = np.array([[1.2, 0.4 * np.cos(angle)], [0.4 * np.cos(angle), 2.0]])
        force = np.array([-9.81 * np.sin(angle), 1.0 + 0.5 * t + rate**2])
        acceleration, speed_rate = np.linalg.solve(mass, force)
        return [rate, acceleration, speed_rate]

    time = np.linspace(0.0, 2.0, 201)
    truth = scipy.integrate.solve_ivp(
        derivative, (0.0, 2.0), [0.7, -0.2, 0.1], t_eval=time, rtol=1e-11, atol=1e-12
    ).y.T
    accelerations = np.array([derivative(t, s)[1:] for t, s in zip(time, truth, strict=True)])
    patterns = patterns_of(
        system,
        time,
        x=np.column_stack([truth[:, :2], accelerations[:, 0]]),
        y=np.column_stack([truth[:, 2], accelerations[:, 1]]),
        u=1.0 + 0.5 * time,
    )
    np.testing.assert_allclose(
        system.network.residual(system.separation.values(constants), *_motion(patterns)),
        0.0,
        atol=1e-9,
    )
    simulation = simulate_system(system, system.separation.values(constants), patterns)
    np.testing.assert_allclose(simulation.simulated, truth[:, [0, 2]], atol=1e-7)


def test_a_variable_can_be_prescribed_although_its_derivative_is_in_the_equations(
    lag: System,
) -> None:
    """a x' = b y' + u with y recorded: x is the integral."""
    system = system_of({"sum": sp.Eq(a * x.diff() - y.diff(), u)}, a)
    time = np.linspace(0.0, 1.0, 101)
    patterns = patterns_of(
        system,
        time,
        x=time**2,
        y=np.column_stack([time**2, 2.0 * time]),
        u=2.0 * time,
    )
    with pytest.raises(DescriptionError, match=r"1 equation.* 2 variables \(x, y\)"):
        simulate_system(system, np.array([2.0]), patterns)
    simulation = simulate_system(system, np.array([2.0]), patterns, recorded=("y",))
    np.testing.assert_allclose(simulation.simulated[:, 0], time**2, atol=INTEGRATED)
    with pytest.raises(DescriptionError, match="no variable is called 'v'"):
        simulate_system(system, np.array([2.0]), patterns, recorded=("v",))


@pytest.mark.parametrize(
    ("equation", "message"),
    [
        pytest.param(lambda: sp.Eq(u, a * x.diff() ** 3), "another way than linearly", id="cubic"),
        pytest.param(lambda: sp.Eq(u, a * x * x.diff()), "cannot be solved", id="singular"),
        pytest.param(lambda: sp.Eq(u, a * x), "expected as many", id="algebraic"),
    ],
)
def test_what_cannot_be_simulated_is_named(equation: Callable[[], sp.Expr], message: str) -> None:
    system = system_of({"balance": equation()}, a)
    time = np.linspace(-1.0, 1.0, 51)  # x passes zero
    motion = np.column_stack([time, np.ones(51)])
    patterns = patterns_of(system, time, x=motion, u=time)
    with pytest.raises(DescriptionError, match=message):
        simulate_system(system, np.array([1.0]), patterns)


def test_wrong_numbers_are_named(lag: System) -> None:
    time = np.linspace(0.0, 1.0, 11)
    patterns = patterns_of(lag, time, x=time, u=time)
    with pytest.raises(ValueError, match=r"k: expected shape \(2,\)"):
        simulate_system(lag, np.ones(3), patterns)
    with pytest.raises(ValueError, match="substeps is 0"):
        simulate_system(lag, np.ones(2), patterns, substeps=0)


def test_a_simulation_without_bounds_is_not_finite_and_says_how_long_it_followed(
    lag: System,
) -> None:
    time = np.linspace(0.0, 2.0, 201)  # as above: compiled once
    exact = np.exp(-time)
    patterns = patterns_of(lag, time, x=exact, u=0 * time)
    simulation = simulate_system(lag, lag.separation.values({"a": -1e-3, "b": 1.0}), patterns)
    assert not np.all(np.isfinite(simulation.simulated))
    assert simulation.follows_for() == pytest.approx(time[1])


def _motion(patterns: Patterns) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(values) for values in (patterns.q, patterns.qd, patterns.qdd))

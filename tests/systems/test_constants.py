"""Constants follow from coefficients, where these determine them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.systems import System, constants_from
from tests.systems.test_identify import load_from


POLE = """
variables = { x = {}, theta = {}, force = {} }
[constants]
M = { unit = "kg", sign = "positive" }
m = { unit = "kg", sign = "positive" }
l = { unit = "m", sign = "positive" }
b = { unit = "N s/m" }
[equations]
cart = "force = (M + m)*ddot(x) + m*l*(ddot(theta)*cos(theta) - dot(theta)^2*sin(theta)) + b*dot(x)"
pole = "0 = m*l^2*ddot(theta) + m*l*ddot(x)*cos(theta) - m*9.81*l*sin(theta)"
"""
TRUE = {"M": 1.3, "m": 0.2, "l": 0.45, "b": -0.1}


@pytest.fixture(scope="module")
def pole() -> System:
    return load_from(POLE)


def identified(system: System, rng: np.random.Generator, error: float) -> jc.Identification:
    """A fit of true coefficients with errors of a part of each, as from a recording."""
    q, qd, qdd = rng.normal(size=(3, 50, len(system.variables)))
    k = system.separation.values(TRUE)
    torque = np.asarray(system.network.torque(k, q, qd, qdd))
    mask = np.ones(torque.shape, bool)
    patterns = jc.Patterns(np.arange(50.0), q, qd, qdd, torque, mask, mask)
    fit = jc.LeastSquares(errors="independent").fit(system.network, patterns)
    errors = error * np.abs(k)
    return dataclasses.replace(
        fit,
        k=jnp.asarray(k + errors * rng.normal(size=len(k))),
        standard_error=jnp.asarray(errors),
        covariance=jnp.asarray(np.diag(errors**2)),
    )


def test_exact_coefficients_give_exact_constants(pole: System, rng: np.random.Generator) -> None:
    estimates = constants_from(pole, identified(pole, rng, 1e-12))
    assert {row.name: pytest.approx(row.value, rel=1e-6) for row in estimates} == TRUE


def test_errors_are_those_of_many_fits(pole: System, rng: np.random.Generator) -> None:
    """Standard errors to first order are the deviations of estimates from coefficients with
    errors of a hundredth."""
    fit = identified(pole, rng, 0.01)
    k, errors = pole.separation.values(TRUE), np.asarray(fit.standard_error)
    draws = [
        constants_from(pole, dataclasses.replace(fit, k=jnp.asarray(k + errors * noise)))
        for noise in rng.normal(size=(60, len(k)))
    ]
    deviation = np.std([[row.value for row in draw] for draw in draws], axis=0)
    expected = [row.standard_error for row in draws[0]]
    np.testing.assert_allclose(deviation, expected, rtol=0.4)  # of 60 draws: 9 % and more


def test_coefficients_of_no_such_system_give_none(pole: System, rng: np.random.Generator) -> None:
    """A negative square of a length, far beyond the errors."""
    fit = identified(pole, rng, 1e-3)
    sign = np.where(np.array(pole.network.names) == "k3", -1.0, 1.0)
    assert constants_from(pole, dataclasses.replace(fit, k=fit.k * sign)) == ()

"""The nearest body that can exist, against a general solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcslc.bodies import nearest_body, pseudo_inertia
from jaxcslc.payload import possible_body


def _body(rng: np.random.Generator, mass: float) -> np.ndarray:
    """Of twenty mass points."""
    at, weight = rng.normal(0.05, 0.05, (20, 3)), rng.uniform(size=20)
    points = np.concatenate([at, np.ones((20, 1))], axis=1)
    j = (points * (mass * weight / weight.sum())[:, None]).T @ points
    x, y, z = np.diag(j)[:3]
    return np.array([y + z, x + z, x + y, -j[0, 1], -j[0, 2], -j[1, 2], *j[:3, 3], j[3, 3]])


def _estimate(rng: np.random.Generator, mass: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """A noisy estimate of a body, and its covariance."""
    mixing = rng.normal(size=(10, 10))
    deviation = scale * np.array([0.02] * 6 + [0.003] * 3 + [0.02])
    covariance = (mixing @ mixing.T / 10 + np.eye(10)) * deviation * deviation[:, None]
    return rng.multivariate_normal(_body(rng, mass), covariance), covariance


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scale", [0.1, 1.0])
def test_it_is_the_nearest(seed: int, scale: float) -> None:
    """As near as what a semidefinite solver finds, and at the same place."""
    rng = np.random.default_rng(seed)
    estimate, covariance = _estimate(rng, rng.uniform(0.7, 2.0), scale)
    information = np.linalg.inv(covariance)
    nearest = np.asarray(possible_body(jnp.asarray(estimate), jnp.asarray(information)))
    other = nearest_body(estimate, covariance, least=1e-6)
    assert other is not None

    def distance(body: np.ndarray) -> float:
        return float((body - estimate) @ information @ (body - estimate))

    assert distance(nearest) < distance(other) + 0.02
    apart = nearest - other
    assert apart @ information @ apart < 0.05
    assert np.min(np.linalg.eigvalsh(pseudo_inertia(nearest))) > 0


def test_what_can_exist_is_left_as_it_is(rng: np.random.Generator) -> None:
    body = _body(rng, 1.5)
    nearest = possible_body(jnp.asarray(body), jnp.asarray(1e8 * np.eye(10)), steps=30)
    np.testing.assert_allclose(nearest, body, atol=1e-4)


@pytest.mark.parametrize("mass", [-0.5, 0.0, 1e-3])
@pytest.mark.parametrize("steps", [1, 12])
def test_however_few_steps_and_whatever_the_estimate(mass: float, steps: int) -> None:
    rng = np.random.default_rng(3)
    for scale in (1e-3, 1.0, 100.0):
        estimate, covariance = _estimate(rng, abs(mass), scale)
        estimate[9] = mass
        information = jnp.asarray(np.linalg.inv(covariance))
        nearest = possible_body(jnp.asarray(estimate), information, steps=steps)
        # The least eigenvalue is below rounding of the largest where there is hardly a body.
        values = np.linalg.eigvalsh(pseudo_inertia(np.asarray(nearest)))
        assert np.min(values) > -1e-14 * np.max(values) and nearest[9] > 0


def test_transforms(rng: np.random.Generator) -> None:
    pairs = [_estimate(rng, 1.0, 0.5) for _ in range(3)]
    estimates = jnp.asarray(np.stack([estimate for estimate, _ in pairs]))
    information = jnp.asarray(np.stack([np.linalg.inv(covariance) for _, covariance in pairs]))
    mapped = jax.jit(jax.vmap(possible_body))(estimates, information)
    np.testing.assert_allclose(mapped[2], possible_body(estimates[2], information[2]), atol=1e-8)

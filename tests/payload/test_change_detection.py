"""Evidence that a payload was picked up, put down or exchanged."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from jaxcslc.payload._equations import (
    PRIOR_DEVIATION,
    RecursiveEquations,
    absence_evidence,
    likelihood_ratio,
    payload_evidence,
)


SIZE = np.array([0.04] * 6 + [0.2] * 3 + [1.0])  # of a typical payload
SAMPLES = 40


def _equations(rows: np.ndarray, values: np.ndarray, weight: np.ndarray) -> RecursiveEquations:
    return RecursiveEquations(
        jnp.asarray(rows.T @ (weight[:, None] * rows)),
        jnp.asarray(rows.T @ (weight * values)),
        jnp.zeros((10, 3)),
    )


def _drawn(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows in the units of a payload, and weights."""
    return rng.normal(size=(SAMPLES, 10)) / SIZE, rng.uniform(0.01, 0.1, SAMPLES)


def test_the_evidence_is_the_ratio_of_the_marginal_densities(rng: np.random.Generator) -> None:
    """Oracle: SciPy's normal densities of all the equations at once."""
    rows, weight = _drawn(rng)
    values = rows @ (SIZE * rng.normal(size=10)) + rng.normal(size=SAMPLES) / np.sqrt(weight)
    noise = np.diag(1.0 / weight)
    some = multivariate_normal(np.zeros(SAMPLES), noise + (rows * SIZE**2) @ rows.T).logpdf(values)
    none = multivariate_normal(np.zeros(SAMPLES), noise).logpdf(values)
    evidence = payload_evidence(_equations(rows, values, weight))
    assert_allclose(evidence, some - none, rtol=1e-9)


def test_the_likelihood_ratio_is_that_of_the_densities(rng: np.random.Generator) -> None:
    rows, weight = _drawn(rng)
    body, values = SIZE * rng.normal(size=10), rng.normal(size=SAMPLES) / np.sqrt(weight)
    densities = [
        multivariate_normal(mean, np.diag(1.0 / weight)).logpdf(values)
        for mean in (rows @ body, np.zeros(SAMPLES))
    ]
    ratio = likelihood_ratio(_equations(rows, values, weight), jnp.asarray(body))
    assert_allclose(ratio, densities[0] - densities[1], rtol=1e-9)


def test_predictions_add_up_to_the_marginal_density(rng: np.random.Generator) -> None:
    """Sample by sample, each after the equations before it; oracle: SciPy's, of all at once."""
    rows, weight = _drawn(rng)
    rows, weight = rows[:15].reshape(5, 3, 10), weight[:15].reshape(5, 3)
    weight[2, 1] = 0.0  # a joint at rest
    values = rows @ (SIZE * rng.normal(size=10)) + rng.normal(size=(5, 3))
    equations, evidence = RecursiveEquations.empty(10, 3, jnp.zeros(()).dtype), 0.0
    for row, value, w in zip(rows, values, weight, strict=True):
        sample = jnp.asarray(row), jnp.asarray(value), jnp.asarray(w)
        evidence += float(absence_evidence(equations, *sample))
        more = RecursiveEquations.of_sample(sample[0], jnp.zeros((3, 3)), *sample[1:])
        equations = equations.with_sample(more, 1.0)
    counted = weight > 0
    a, y, noise = rows[counted], values[counted], np.diag(1.0 / weight[counted])
    spread = (a * PRIOR_DEVIATION**2) @ a.T
    densities = [
        multivariate_normal(np.zeros(len(y)), covariance).logpdf(y)
        for covariance in (noise, noise + spread)
    ]
    assert_allclose(evidence, densities[0] - densities[1], rtol=1e-8)


def test_false_alarms_are_as_rare_as_stated(rng: np.random.Generator) -> None:
    """Of 2000 sequences of noise, at most exp(−h) ever exceed h, at whatever sample."""
    sequences, level = 2000, 2.0
    rows, weight = _drawn(rng)
    noise = rng.normal(size=(sequences, SAMPLES)) / np.sqrt(weight)
    terms = rows[:, :, None] * rows[:, None, :] * weight[:, None, None]
    information = jnp.asarray(np.cumsum(terms, axis=0))
    moment = jnp.asarray(np.cumsum(rows * (weight * noise)[..., None], axis=1))

    def of_sequence(moments: jax.Array) -> jax.Array:
        def of_sample(information: jax.Array, moment: jax.Array) -> jax.Array:
            return payload_evidence(RecursiveEquations(information, moment, jnp.zeros((10, 3))))

        return jnp.max(jax.vmap(of_sample)(information, moments))

    greatest = np.asarray(jax.jit(lambda moments: jax.lax.map(of_sequence, moments))(moment))
    bound = np.exp(-level)
    assert np.mean(greatest > level) < bound + 3.0 * np.sqrt(bound / sequences)
    assert np.mean(greatest > 0.5 * level) > 0.3 * np.exp(-0.5 * level)  # nor much rarer


def test_no_equations_speak_for_nothing() -> None:
    empty = RecursiveEquations.empty(10, 3, jnp.zeros(()).dtype)
    assert float(payload_evidence(empty)) == 0.0
    assert float(likelihood_ratio(empty, jnp.ones(10))) == 0.0


def test_equations_are_forgotten_and_replaced(rng: np.random.Generator) -> None:
    rows, arm = jnp.asarray(rng.normal(size=(2, 10))), jnp.asarray(rng.normal(size=(2, 3)))
    weight, residual = jnp.array([2.0, 3.0]), jnp.array([1.0, -1.0])
    sample = RecursiveEquations.of_sample(rows, arm, residual, weight)
    assert_allclose(sample.moment, rows.T @ (weight * residual))
    assert_allclose(sample.cross, rows.T @ (weight[:, None] * arm))
    twice = sample.with_sample(sample, 0.5)
    assert_allclose(twice.information, 1.5 * sample.information)
    for when, expected in ((True, sample), (False, twice)):
        assert_allclose(twice.replaced(sample, jnp.asarray(when)).moment, expected.moment)
    assert not np.any(np.asarray(twice.reset(jnp.asarray(True)).information))


def test_the_prior_is_wider_than_what_is_expected() -> None:
    assert np.all(pytest.approx(5.0 * SIZE) == PRIOR_DEVIATION)

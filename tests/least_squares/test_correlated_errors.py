"""Standard errors for noise that is correlated in time and across joints."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import t as student

import jaxcslc as jc
from jaxcslc.least_squares import Errors, Rows, effective_counts, equations_of
from jaxcslc.least_squares._errors import COMPONENTS
from tests.patterns import ORDINARY, Motion, patterns_of


SAMPLES = 512
TRUE = np.array([0.5, 2.0, 1.0, 0.3, 0.1, 0.2, 0.7, 0.4, 0.2])


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """Two links in a plane, without gravity."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, 0, -9.81), friction=("viscous",)
    )
    return jc.derive(robot, lengths="numeric")


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Two joints that swing at several frequencies."""
    t = 0.01 * np.arange(SAMPLES)[:, None]
    rates = np.array([2.1, 3.3])
    q = np.sin(rates * t) + 0.3 * np.sin(2.7 * rates * t)
    qd = rates * (np.cos(rates * t) + 0.81 * np.cos(2.7 * rates * t))
    qdd = -(rates**2) * (np.sin(rates * t) + 2.187 * np.sin(2.7 * rates * t))
    return q, qd, qdd


Noise = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def red(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of slow changes, alike in both joints."""
    white = rng.normal(size=shape)
    white[:, 1] = 0.7 * white[:, 0] + 0.3 * white[:, 1]
    return lfilter([0.3], [1.0, -0.9], white, axis=0)


def blue(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of quick changes, as accelerations have it from positions."""
    return np.diff(rng.normal(size=(shape[0] + 1, *shape[1:])), axis=0)


@eqx.filter_jit
def fits_of(
    network: jc.CSLC, patterns: jc.Patterns, torques: jax.Array, errors: Errors
) -> jc.Identification:
    """A fit of each recording; compiled once for all tests."""

    def fit(torque: jax.Array) -> jc.Identification:
        solver = jc.LeastSquares(joint_weights="equal", errors=errors)
        return solver.fit(network, eqx.tree_at(lambda p: p.torque, patterns, torque), throw=False)

    return eqx.filter_vmap(fit)(torques)


def coverage(
    network: jc.CSLC, motion: Motion, noises: list[np.ndarray], errors: Errors
) -> tuple[float, float]:
    """How often 95 % intervals held the truth, and mean standard error over true deviation."""
    k = TRUE[: network.size]
    clean = patterns_of(network, jnp.asarray(k), motion)
    torque = jnp.asarray(np.asarray(clean.torque) + np.stack(noises))
    fits = fits_of(network, jax.tree.map(jnp.asarray, clean), torque, errors)
    quantile = student.ppf(0.975, np.asarray(fits.degrees_of_freedom))[:, None]
    covered = np.abs(np.asarray(fits.k) - k) <= quantile * np.asarray(fits.standard_error)
    ratio = np.sqrt(np.mean(np.asarray(fits.standard_error) ** 2, axis=0)) / np.std(
        np.asarray(fits.k), axis=0
    )
    return float(covered.mean()), float(np.median(ratio))


# 100 recordings of seven coefficients whose errors are correlated: some 300 trials, of which four
# standard deviations are 0.05.
_FOUR_DEVIATIONS = 0.05


@pytest.mark.parametrize(
    ("noise", "seed"), [(red, 777727220), (blue, 1790247513)], ids=["red", "blue"]
)
def test_intervals_hold_the_truth(arm: jc.CSLC, motion: Motion, noise: Noise, seed: int) -> None:
    rng = np.random.default_rng(seed)
    noises = [noise(rng, motion[0].shape) for _ in range(100)]
    covered, ratio = coverage(arm, motion, noises, "correlated")
    assert abs(covered - 0.95) < _FOUR_DEVIATIONS
    # In five seconds even the lowest components hold some of the quicker noise.
    assert 0.85 < ratio < 1.3
    # What allowing for it is good for: as if noise were white, both are wrong, either way.
    naive, _ = coverage(arm, motion, noises, "independent")
    assert naive < 0.85 if noise is red else naive > 0.98


def test_white_noise_needs_no_allowance(
    arm: jc.CSLC, motion: Motion, rng: np.random.Generator
) -> None:
    noises = [rng.normal(size=motion[0].shape) for _ in range(100)]
    covered, ratio = coverage(arm, motion, noises, "correlated")
    assert abs(covered - 0.95) < _FOUR_DEVIATIONS
    assert 0.9 < ratio < 1.1


def test_equals_its_formula(arm: jc.CSLC, motion: Motion, rng: np.random.Generator) -> None:
    """Oracle: the estimator transcribed, with a mask and weights, from the dense regressor."""
    p = arm.size
    noise = red(rng, motion[0].shape)
    patterns = patterns_of(arm, jnp.asarray(TRUE[:p]), motion, noise)
    patterns = eqx.tree_at(lambda x: x.backlash_mask, patterns, rng.random(noise.shape) < 0.7)
    weights = np.array([2.0, 0.5])
    fit = jc.LeastSquares(joint_weights=weights, errors="correlated").fit(arm, patterns)

    counts = np.asarray(patterns.backlash_mask)
    rows = np.asarray(arm.regressor(*motion))
    error = np.where(counts, np.asarray(patterns.torque) - rows @ np.asarray(fit.k), 0.0)
    scores = np.einsum("tj,tjp->tp", weights**2 * error, rows)
    weighted = (rows * weights[:, None] * counts[..., None]).reshape(-1, p)
    effective = np.asarray(fit.effective_equations)
    components = int(np.clip(np.round(0.4 * effective.min() ** (2 / 3)), 8, COMPONENTS))
    assert float(fit.degrees_of_freedom) == components
    inverse_gram = np.linalg.inv(weighted.T @ weighted)
    hat = weighted @ inverse_gram @ weighted.T
    left = np.zeros(p)
    phase = (np.arange(SAMPLES) + 0.5) / SAMPLES
    total = np.zeros((p, p))
    for k in range(1, components + 1):
        shape = np.sqrt(2) * np.cos(np.pi * k * phase)
        off = inverse_gram @ (shape @ scores)
        total += np.outer(off, off) / components
        # White noise of covariance I scores at the coefficients through these rows.
        through = (np.repeat(shape, 2)[:, None] * weighted) @ inverse_gram
        left += np.diag(through.T @ (through - hat @ through)) / components
    root = np.sqrt(left / np.diag(inverse_gram))
    expected = total / np.outer(root, root)
    assert_allclose(fit.covariance, expected, rtol=1e-6, atol=1e-12)
    assert_allclose(fit.standard_error, np.sqrt(np.diag(expected)), rtol=1e-6)


def test_effective_counts_of_known_processes(rng: np.random.Generator) -> None:
    """White: all. Autoregressive of coefficient a: N (1 - a²) / (1 + a²) of them."""
    long = (20_000, 1)
    everything = jnp.ones(long)
    white = effective_counts(jnp.asarray(rng.normal(size=long)), everything)
    assert 0.95 < white[0] / long[0] <= 1.0
    for a in (0.8, -0.8):
        series = lfilter([1.0], [1.0, -a], rng.normal(size=long), axis=0)
        share = effective_counts(jnp.asarray(series), everything)[0] / long[0]
        assert_allclose(share, (1 - a**2) / (1 + a**2), rtol=0.15)
    none = effective_counts(jnp.zeros((100, 2)), jnp.zeros((100, 2)))
    assert np.all(np.asarray(none) == 0.0)


def test_kept_rows_are_the_patterns_rows(
    arm: jc.CSLC, motion: Motion, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kept, computed again chunk by chunk, or traced: the same factors, residuals and sums."""
    monkeypatch.setattr("jaxcslc.least_squares._errors._CHUNK", 100)
    k = jnp.asarray(TRUE[: arm.size])
    patterns = patterns_of(arm, k, motion, rng.normal(size=motion[0].shape))
    counts = rng.random(motion[0].shape) < 0.7
    patterns = eqx.tree_at(lambda p: p.backlash_mask, patterns, counts)
    kept = Rows.from_equations(equations_of(arm, patterns, None), SAMPLES)
    again = Rows.from_patterns(arm, patterns)
    at = np.flatnonzero(np.any(counts, axis=1))
    residual = rng.normal(size=motion[0].shape) * counts
    weights, used = np.array([2.0, 0.5]), np.array([1.0, 1.0, 0.0])
    other_k = TRUE[: arm.size] + 0.1
    ones = np.ones(motion[0].shape)

    def of_rows(rows: Rows) -> tuple[Any, ...]:
        sums = rows.cosine_sums(residual, weights, used)
        return *sums, rows.residuals(other_k), *rows.factors(ones).triangles

    traced = eqx.filter_jit(lambda p: of_rows(Rows.from_patterns(arm, p)))(
        jax.tree.map(jnp.asarray, patterns)
    )
    computed = of_rows(again)
    for one, other in zip(traced[:4], computed[:4], strict=True):
        assert_allclose(one, other, rtol=1e-7, atol=1e-5)  # cosines are interpolated on the host
    sums = kept.cosine_sums(residual[at], weights, used)
    for one, other in zip(computed[:3], sums, strict=True):
        assert_allclose(one, other, atol=1e-8)
    assert_allclose(again.residuals(other_k)[at], kept.residuals(other_k), atol=1e-10)
    triangles = traced[4:], computed[4:], kept.factors(ones[at]).triangles
    for one, two, three in zip(*triangles, strict=True):
        assert_allclose(one.T @ one, two.T @ two, atol=1e-8)
        assert_allclose(two.T @ two, three.T @ three, atol=1e-8)


def test_same_under_jit(arm: jc.CSLC, motion: Motion, rng: np.random.Generator) -> None:
    """Eager fits keep their rows, traced ones compute them again."""
    patterns = patterns_of(arm, jnp.asarray(TRUE[: arm.size]), motion, red(rng, motion[0].shape))
    fit = lambda p: jc.LeastSquares(joint_weights="residual", errors="correlated").fit(
        arm, p, throw=False
    )
    eager, traced = fit(patterns), eqx.filter_jit(fit)(jax.tree.map(jnp.asarray, patterns))
    assert_allclose(traced.standard_error, eager.standard_error, rtol=1e-6)
    assert float(traced.degrees_of_freedom) == float(eager.degrees_of_freedom)


def test_filtered_alike(arm: jc.CSLC, motion: Motion, rng: np.random.Generator) -> None:
    """With a parallel filter, of a recording some of which does not count."""
    covered: list[np.ndarray] = []
    k = jnp.asarray(TRUE[: arm.size])
    counts = (np.arange(SAMPLES) // 100 % 4 > 0)[:, None] & np.array([True, True])
    clean = eqx.tree_at(lambda p: p.backlash_mask, patterns_of(arm, k, motion), counts)
    for _ in range(60):
        torque = np.asarray(clean.torque) + red(rng, motion[0].shape)
        patterns = eqx.tree_at(lambda p: p.torque, clean, torque)
        fit = jc.LeastSquares(joint_weights="equal", errors="correlated", cutoff=8.0).fit(
            arm, patterns
        )
        low, high = fit.confidence_interval().T
        covered.append((low < k) & (k < high))
    # Some 120 independent trials, each of no more than some 40 independent errors a joint.
    assert 0.87 < np.mean(covered) <= 1.0


def test_without_noise_nothing_is_uncertain(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    fit = jc.LeastSquares(joint_weights="equal", errors="correlated").fit(
        puma, patterns_of(puma, puma_k, exciting_motion)
    )
    assert np.all(np.asarray(fit.standard_error) < 1e-10)


def test_undetermined_coefficients_stay_open(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    q, qd, qdd = rng.normal(size=(3, 400, 6)) * np.array([1.0, 1, 1, 0, 0, 0])
    patterns = patterns_of(puma, puma_k, (q, qd, qdd), rng.normal(size=(400, 6)))
    fit = jc.LeastSquares(joint_weights="equal", errors="correlated").fit(puma, patterns)
    plain = ORDINARY.fit(puma, patterns)
    assert_allclose(fit.k, plain.k)
    assert np.array_equal(np.isinf(fit.standard_error), np.isinf(plain.standard_error))
    assert np.all(np.isinf(fit.confidence_interval()[~np.asarray(fit.determined)]))

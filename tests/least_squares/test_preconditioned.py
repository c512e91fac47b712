"""Factors by matrix products: as good as those of Householder's reflections."""

import shutil

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.least_squares import (
    JointFactors,
    Preconditioner,
    Unknowns,
    dense_factors,
    factors_of,
    host_kernel_of,
    joined_factors,
    minimum,
)
from scripts.benchmarks.exact_solution import exact_coefficients
from tests.patterns import ORDINARY, Motion, patterns_of


pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler (cc) on this machine"
)
SAMPLES = 3000
# Factors agree to rounding of some 10^4 rows, in lengths of columns.
_ROUNDING = 1e-13
# Standard errors of coefficients, for signals of 10^3 standard deviations of the noise. Residuals
# are orthogonal to columns up to rounding, which counts condition-number-fold.
_STANDARD_ERRORS = 1e-9
_PER_CONDITION = 1e-13


def motion_of(
    network: jc.CSLC, k: jax.Array, exciting: Motion, scale: np.ndarray, noise: float
) -> tuple[np.ndarray, ...]:
    """Positions, velocities, accelerations of joints scaled; torques with noise; weights 1."""
    q, qd, qdd = (0.5 * x * scale for x in exciting)
    torque = np.asarray(network.torque(k, q, qd, qdd))
    rng = np.random.default_rng(1)
    return q, qd, qdd, torque + noise * rng.normal(size=q.shape), np.ones(q.shape)


def products(
    network: jc.CSLC, motion: tuple[np.ndarray, ...]
) -> tuple[JointFactors, Preconditioner]:
    factors, preconditioner = factors_of(network, motion, host_kernel_of(network))
    assert preconditioner is not None
    return factors, preconditioner


def reflected(network: jc.CSLC, motion: tuple[np.ndarray, ...]) -> JointFactors:
    q, qd, qdd, torque, weight = motion
    pairs = weight != 0.0
    return dense_factors(
        network, jc.Patterns(np.arange(len(q)) * 1.0, q, qd, qdd, torque, pairs, pairs)
    )


def scaled(*small: float) -> np.ndarray:
    """Joints in the order of PUMA's, the last ones moved by these."""
    return np.array([1.0] * (6 - len(small)) + list(small))


# Names, how far joints move, and condition numbers of columns of unit length.
MOTIONS = {
    "all joints": (scaled(), 1e1),
    "small": (np.full(6, 3e-2), 1e5),
    "smaller": (np.full(6, 2e-3), 1e7),
    "wrist hardly": (scaled(1e-6, 1e-6, 1e-6), 1e8),
    "wrist still": (scaled(0.0, 0.0, 0.0), 1e2),
    "third joint still": (np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0]), 1e2),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_factors_are_those_of_reflections(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, name: str
) -> None:
    """R'R alike to rounding, the same rank, and the same coefficients with the same errors."""
    scale, largest = MOTIONS[name]
    motion = motion_of(puma, puma_k, exciting_motion, scale, 1e-2)
    expected, (factors, _) = reflected(puma, motion), products(puma, motion)
    assert_array_equal(factors.counts, expected.counts)
    for mine, theirs in zip(factors.triangles, expected.triangles, strict=True):
        lengths = np.linalg.norm(theirs, axis=0)
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        assert_allclose(
            (mine / lengths).T @ (mine / lengths),
            (theirs / lengths).T @ (theirs / lengths),
            atol=_ROUNDING,
        )
    unknowns, weights = Unknowns.of(puma), np.ones(6)
    mine, theirs = (minimum(unknowns, x, weights, None) for x in (factors, expected))
    assert theirs.condition < largest
    assert mine.rank == theirs.rank
    determined = theirs.determined
    assert_array_equal(mine.determined, determined)
    deviation = np.sqrt(theirs.variance * np.diag(theirs.inverse_gram))[determined]
    limit = _STANDARD_ERRORS + _PER_CONDITION * theirs.condition
    assert np.all(np.abs(mine.k - theirs.k)[determined] < limit * deviation)


@pytest.mark.parametrize("name", ["all joints", "small", "smaller"])
def test_coefficients_are_as_near_to_the_exact_ones(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, name: str
) -> None:
    """Oracle: the normal equations of the same rows in numbers of 400 bits."""
    q, qd, qdd = (x[:150] for x in exciting_motion)
    motion = motion_of(puma, puma_k, (q, qd, qdd), MOTIONS[name][0], 0.1)
    exact = exact_coefficients(puma, motion)
    unknowns, weights = Unknowns.of(puma), np.ones(6)
    by_products = minimum(unknowns, products(puma, motion)[0], weights, None)
    by_reflections = minimum(unknowns, reflected(puma, motion), weights, None)
    deviation = np.sqrt(by_reflections.variance * np.diag(by_reflections.inverse_gram))
    errors = [
        np.sqrt(np.mean(((fit.k - exact) / deviation) ** 2))
        for fit in (by_products, by_reflections)
    ]
    assert errors[0] < 5.0 * errors[1] + 1e-12


def test_noise_free_torques(puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion) -> None:
    """The torque's column depends on the others: what is left of it is rounding."""
    motion = motion_of(puma, puma_k, exciting_motion, scaled(), 0.0)
    fit = minimum(Unknowns.of(puma), products(puma, motion)[0], np.ones(6), None)
    assert_allclose(fit.k, puma_k, atol=1e-12)
    assert fit.variance < 1e-24


def test_another_motions_preconditioner(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    """Of patterns in which most joints stand: further passes make up for it."""
    still = motion_of(puma, puma_k, exciting_motion, scaled(0.0, 0.0, 0.0, 0.0), 1e-2)
    _, preconditioner = products(puma, still)
    motion = motion_of(puma, puma_k, exciting_motion, scaled(), 1e-2)
    factors, served = factors_of(puma, motion, host_kernel_of(puma), preconditioner)
    expected = reflected(puma, motion)
    assert served is not preconditioner
    fits = [minimum(Unknowns.of(puma), x, np.ones(6), None) for x in (factors, expected)]
    assert_allclose(fits[0].k, fits[1].k, atol=1e-12)
    assert fits[0].rank == fits[1].rank == 43


def test_a_preconditioner_is_an_inverse(rng: np.random.Generator) -> None:
    """Also of rows with a column of zeros, and one twice; in any units."""
    rows = rng.normal(size=(40, 6)) * 10.0 ** rng.uniform(-8, 8, 6)
    rows[:, 2], rows[:, 4] = 0.0, 3.0 * rows[:, 1]
    (inverse,), (factor,) = Preconditioner.from_rows([rows])
    assert_allclose(factor @ inverse, np.eye(6), atol=1e-7)
    kept = [0, 1, 3, 5]
    gram = inverse.T @ (rows.T @ rows) @ inverse
    assert_allclose(np.sort(np.linalg.eigvalsh(gram))[-4:], np.ones(4), atol=1e-7)
    assert len(kept) == np.sum(np.linalg.eigvalsh(gram) > 0.5)


def test_a_preconditioner_of_products(rng: np.random.Generator) -> None:
    """Independent columns become orthonormal; what depends on them vanishes up to rounding."""
    rows = rng.normal(size=(40, 6)) * 10.0 ** rng.uniform(-8, 8, 6)
    rows[:, 2], rows[:, 4] = 0.0, 3.0 * rows[:, 1] - rows[:, 0]
    (inverse,), (factor,) = Preconditioner.from_products([rows.T @ rows])
    assert_allclose(factor @ inverse, np.eye(6), atol=1e-7)
    transformed = rows @ inverse
    lengths = np.linalg.norm(transformed, axis=0)
    assert_allclose(np.sort(lengths), [0.0, 0.0, 1.0, 1.0, 1.0, 1.0], atol=1e-7)
    independent = transformed[:, lengths > 0.5]
    assert_allclose(independent.T @ independent, np.eye(4), atol=1e-12)


def test_patterns_without_weight(puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion) -> None:
    motion = motion_of(puma, puma_k, exciting_motion, scaled(), 1e-2)
    factors, _ = products(puma, (*motion[:4], np.zeros((SAMPLES, 6))))
    assert_array_equal(factors.counts, np.zeros(6))
    assert all(np.all(triangle == 0.0) for triangle in factors.triangles)


def test_patterns_that_are_not_finite(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    patterns = patterns_of(puma, puma_k, exciting_motion)
    torque = np.array(patterns.torque)
    torque[5, 2] = np.nan
    broken = jc.Patterns(
        *(patterns.time, patterns.q, patterns.qd, patterns.qdd, torque),
        *(patterns.backlash_mask, patterns.friction_mask),
    )
    fit = ORDINARY.fit_stream(puma, [broken], throw=False)
    assert fit.result == jc.RESULTS.nonfinite


def test_joins_do_not_depend_on_the_order(rng: np.random.Generator) -> None:
    sets = [
        JointFactors.from_rows(
            (rng.normal(size=(50, 4)), rng.normal(size=(60, 3))), np.array([5e1, 6e1])
        )
        for _ in range(20)
    ]
    forwards, backwards = joined_factors(sets), joined_factors(sets[::-1])
    assert_array_equal(forwards.counts, [1000.0, 1200.0])
    for one, other in zip(forwards.triangles, backwards.triangles, strict=True):
        assert_allclose(one.T @ one, other.T @ other, atol=1e-11)
    with pytest.raises(ValueError, match="no factors to join"):
        joined_factors([])

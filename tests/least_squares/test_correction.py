"""One step of refinement: coefficients to a billionth of a standard error."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.least_squares import (
    Unknowns,
    corrected,
    factors_of,
    host_kernel_of,
    minimum,
    needs_correction,
    residual_sums,
)
from scripts.benchmarks.exact_solution import exact_coefficients
from tests.patterns import ORDINARY, Motion, patterns_of


SAMPLES = 150
# Of standard errors: what remains is rounding of torques predicted, of the coefficients, and of the
# step: 2^-53 of it times the condition, here 10^6.
_STANDARD_ERRORS = 2e-10
# Of them with torques of 10^5 standard deviations of the noise, of which rounding is 10^-11.
_OF_ACCURATE_TORQUES = 3e-9
# Lower halves of products are rounded, by 2^-53 of 2^-26 of them.
_LOWER_HALVES = 1e-23

_sums = jax.jit(residual_sums, static_argnums=0, static_argnames="on_gpu")


def motion_of(
    network: jc.CSLC, k: jax.Array, exciting: Motion, scale: float, samples: int = SAMPLES
) -> tuple[np.ndarray, ...]:
    """States scaled, torques with noise of a thousandth of them, weights 1."""
    q, qd, qdd = (scale * x[:samples] for x in exciting)
    torque = np.asarray(network.torque(k, q, qd, qdd))
    noise = 1e-3 * torque.std() * np.random.default_rng(2).normal(size=q.shape)
    return q, qd, qdd, torque + noise, np.ones(q.shape)


@pytest.mark.parametrize("scale, least", [(1.0, 1.0), (5e-4, 1e6)])
@pytest.mark.parametrize("on_gpu", [False, True])
def test_corrected_coefficients_are_the_exact_ones(
    puma: jc.CSLC,
    puma_k: jax.Array,
    exciting_motion: Motion,
    scale: float,
    least: float,
    on_gpu: bool,
) -> None:
    """Oracle: the normal equations of the same rows in numbers of 400 bits."""
    motion = motion_of(puma, puma_k, exciting_motion, scale)
    unknowns, weights = Unknowns.of(puma), np.ones(6)
    solution = minimum(unknowns, factors_of(puma, motion, host_kernel_of(puma))[0], weights, None)
    assert least < solution.condition < 20.0 * least
    sums = np.asarray(_sums(puma, solution.k, *map(jnp.asarray, motion), on_gpu=on_gpu))
    fit = corrected(unknowns, solution, weights, sums[None])
    deviation = np.sqrt(solution.variance * np.diag(solution.inverse_gram))
    error = np.abs(fit.k - exact_coefficients(puma, motion)) / deviation
    assert np.max(error) < _STANDARD_ERRORS


def test_sums_are_exact(puma: jc.CSLC, exciting_motion: Motion) -> None:
    """Oracle: fractions. Torques alone, so that residuals are what is known."""
    still = (np.zeros((SAMPLES, 6)), *(x[:SAMPLES] for x in exciting_motion[1:]))
    torque = exciting_motion[0][:SAMPLES] * 10.0 ** np.linspace(-8, 8, SAMPLES)[:, None]
    motion = (*still, torque, np.ones(torque.shape))
    none = np.zeros(puma.size)
    sums = np.asarray(_sums(puma, none, *map(jnp.asarray, motion), on_gpu=False))
    entry = 0
    for columns, right in zip(puma.columns(*(x.T for x in still)), torque.T, strict=True):
        for column in np.asarray(columns):
            terms = [Fraction(x) * Fraction(y) for x, y in zip(column, right, strict=True)]
            error = sum(map(Fraction, sums[:, entry])) - sum(terms)
            assert abs(error) <= _LOWER_HALVES * float(sum(map(abs, terms)))
            entry += 1


def test_what_needs_correction(puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion) -> None:
    """Neither well conditioned equations of noisy torques, nor such that are not finite."""
    unknowns, weights = Unknowns.of(puma), np.ones(6)

    def needed(scale: float, noise: float) -> bool:
        *states, torque, weight = motion_of(puma, puma_k, exciting_motion, scale)
        torque = torque + noise * np.random.default_rng(3).normal(size=torque.shape)
        factors, _ = factors_of(puma, (*states, torque, weight), host_kernel_of(puma))
        with np.errstate(invalid="ignore"):
            solution = minimum(unknowns, factors, weights, None)
        return needs_correction(unknowns, factors, solution, weights)

    assert not needed(1.0, 1.0)
    assert needed(2e-4, 1.0)
    assert not needed(1.0, np.nan)


def test_a_fit_in_pieces_is_corrected(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torques of next to no noise: rounding is more of a standard error than elsewhere."""
    q, qd, qdd = (x[:600] for x in exciting_motion)
    noise = 1e-4 * np.random.default_rng(4).normal(size=q.shape)
    patterns = patterns_of(puma, puma_k, (q, qd, qdd), noise)
    monkeypatch.setattr("jaxcslc.least_squares._blocks._CPU_LENGTH", 128)
    monkeypatch.setattr("jaxcslc.least_squares._blocks.LONG", 128)
    fit = ORDINARY.fit(puma, patterns)
    exact = exact_coefficients(puma, (q, qd, qdd, np.asarray(patterns.torque)))
    assert np.max(np.abs(fit.k - exact) / np.asarray(fit.standard_error)) < _OF_ACCURATE_TORQUES

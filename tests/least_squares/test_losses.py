"""Robust losses: the functions themselves, and iteratively reweighted least squares."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares._errors import ERRORS
from jaxcslc.least_squares._least_squares import check_choice
from jaxcslc.least_squares._losses import LOSSES, Loss, influence, robust_scale, slope, weight
from tests import arms
from tests.patterns import ORDINARY, Motion, patterns_of


ROBUST: tuple[Loss, ...] = ("huber", "bisquare")


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """One joint with an upright axis: inertia, viscous and dry friction."""
    return arms.turntable()


TRUE = np.array([0.5, 2.0, 1.0])


def recorded(network: jc.CSLC, rng: np.random.Generator, outliers: float) -> jc.Patterns:
    """Normal noise of 0.1, and a part of the torques that are off by ten or so."""
    motion: Motion = tuple(rng.normal(size=(3, 512, 1)))  # type: ignore[assignment]
    noise = 0.1 * rng.normal(size=(512, 1))
    noise += np.where(rng.random((512, 1)) < outliers, 10.0 + rng.normal(size=(512, 1)), 0.0)
    return patterns_of(network, jnp.asarray(TRUE), motion, noise)


@pytest.mark.parametrize("loss", ROBUST)
def test_slope_is_the_derivative_of_influence(loss: Loss) -> None:
    u = jnp.linspace(-6.0, 6.0, 98)  # none of them at a corner
    assert_allclose(jax.vmap(jax.grad(lambda x: influence(loss, x)))(u), slope(loss, u), atol=1e-12)
    assert_allclose(weight(loss, u) * u, influence(loss, u), atol=1e-12)


@pytest.mark.parametrize("loss", ROBUST)
def test_small_errors_count_in_full(loss: Loss) -> None:
    assert float(weight(loss, jnp.array(0.0))) == 1.0
    assert float(slope(loss, jnp.array(0.0))) == 1.0


@pytest.mark.parametrize("loss", ROBUST)
def test_tuning_has_95_percent_of_the_efficiency(loss: Loss) -> None:
    """(E psi')² / E psi² under the normal distribution, by quadrature."""
    u = jnp.linspace(-10.0, 10.0, 20_001)
    density = jnp.exp(-0.5 * u**2) / jnp.sqrt(2 * jnp.pi) * (u[1] - u[0])
    efficiency = jnp.sum(slope(loss, u) * density) ** 2 / jnp.sum(influence(loss, u) ** 2 * density)
    assert_allclose(efficiency, 0.95, atol=1e-3)


def test_scale_is_the_median_of_what_counts(rng: np.random.Generator) -> None:
    error = rng.normal(size=(501, 3))
    counts = (rng.random((501, 3)) < 0.5).astype(float)
    counts[:, 2] = 0.0
    scale = robust_scale(jnp.asarray(error), jnp.asarray(counts))
    expected = [np.median(np.abs(error[counts[:, j] > 0, j])) / 0.6744897501960817 for j in (0, 1)]
    assert_allclose(scale, [*expected, 0.0], rtol=1e-12)


def reweighted(
    rows: np.ndarray, target: np.ndarray, loss: Loss, start: np.ndarray | None = None
) -> np.ndarray:
    """Oracle: iteratively reweighted least squares as textbooks write it."""
    k = np.linalg.lstsq(rows, target, rcond=None)[0] if start is None else start
    for _ in range(200):
        error = target - rows @ k
        u = np.abs(error) / (np.median(np.abs(error)) / 0.6744897501960817)
        if loss == "huber":
            w = np.minimum(1.0, 1.345 / np.maximum(u, 1e-300))
        else:
            w = np.where(u < 4.685, (1 - (u / 4.685) ** 2) ** 2, 0.0)
        root = np.sqrt(w)
        k = np.linalg.lstsq(rows * root[:, None], target * root, rcond=None)[0]
    return k


def test_equals_textbook_reweighting(arm: jc.CSLC, rng: np.random.Generator) -> None:
    patterns = recorded(arm, rng, 0.1)
    rows = np.asarray(arm.regressor(patterns.q, patterns.qd, patterns.qdd))[:, 0]
    target = np.asarray(patterns.torque)[:, 0]
    huber = reweighted(rows, target, "huber")
    assert_allclose(
        jc.LeastSquares(joint_weights="equal", loss="huber", errors="independent")
        .fit(arm, patterns)
        .k,
        huber,
        atol=1e-7,
    )
    bisquare = reweighted(rows, target, "bisquare", huber)
    assert_allclose(
        jc.LeastSquares(joint_weights="equal", loss="bisquare", errors="independent")
        .fit(arm, patterns)
        .k,
        bisquare,
        atol=1e-7,
    )


def test_outliers_have_less_influence(arm: jc.CSLC, rng: np.random.Generator) -> None:
    """On average: in a single recording the noise of the others may decide between the two."""
    recordings = [recorded(arm, rng, 0.1) for _ in range(10)]
    errors: dict[Loss, float] = {}
    for loss in ("squared", *ROBUST):
        solver = dataclasses.replace(ORDINARY, loss=loss)
        fits = [np.asarray(solver.fit(arm, patterns).k) for patterns in recordings]
        errors[loss] = float(np.mean([np.abs(k - TRUE).max() for k in fits]))
    assert errors["bisquare"] < errors["huber"] < errors["squared"]
    assert errors["bisquare"] < 0.03


@pytest.mark.parametrize("loss", ROBUST)
def test_intervals_of_a_robust_fit_hold_the_truth(
    arm: jc.CSLC, rng: np.random.Generator, loss: Loss
) -> None:
    """100 recordings of three coefficients: four standard deviations of 0.95 are 0.05."""
    several = [recorded(arm, rng, 0.03) for _ in range(100)]
    batch = jax.tree.map(lambda *x: jnp.stack(x), *several)
    fits = eqx.filter_jit(
        eqx.filter_vmap(
            lambda p: jc.LeastSquares(joint_weights="equal", loss=loss, errors="independent").fit(
                arm, p, throw=False
            )
        )
    )(batch)
    covered = np.abs(np.asarray(fits.k) - TRUE) < 1.964 * np.asarray(fits.standard_error)
    assert abs(covered.mean() - 0.95) < 0.05


def test_noise_free_patterns_are_met_exactly(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    patterns = patterns_of(puma, puma_k, exciting_motion)
    fit = jc.LeastSquares(joint_weights="residual", loss="bisquare", errors="independent").fit(
        puma, patterns
    )
    assert_allclose(fit.k, puma_k, atol=1e-9)


def test_with_a_cutoff(arm: jc.CSLC, rng: np.random.Generator) -> None:
    """The filtered equations are reweighted: a fit without outliers hardly moves."""
    patterns = recorded(arm, rng, 0.0)
    plain = jc.LeastSquares(joint_weights="equal", errors="independent", cutoff=10.0).fit(
        arm, patterns
    )
    robust = jc.LeastSquares(
        joint_weights="equal", loss="bisquare", errors="independent", cutoff=10.0
    ).fit(arm, patterns)
    assert np.all(np.abs(plain.k - robust.k) < 2 * plain.standard_error)
    assert_allclose(plain.equations, robust.equations)


def test_unknown_words() -> None:
    word: Any = "cauchy"
    with pytest.raises(ValueError, match="loss is 'cauchy'; expected 'squared' or 'huber'"):
        check_choice("loss", word, LOSSES)
    with pytest.raises(ValueError, match="errors is 'cauchy'; expected 'independent' or"):
        check_choice("errors", word, ERRORS)
    for name in ("loss", "errors"):  # the tests' type checker is there before the message
        with pytest.raises((ValueError, TypeCheckError), match="cauchy"):
            jc.LeastSquares(**{name: word})

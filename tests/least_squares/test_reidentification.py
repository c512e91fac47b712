"""Learning a part of the coefficients: against NumPy, against all of them, and what it refuses."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.network import carrier
from tests import arms
from tests.patterns import ORDINARY, Motion, patterns_of


# Rounding of a factorisation of some 10^4 rows, times a condition number of order 10.
_ROUNDING = 1e-10
_OPTIONS: list[dict[str, Any]] = [
    {},
    {"joint_weights": "residual"},
    {"loss": "huber"},
    {"loss": "bisquare", "joint_weights": "residual", "errors": "correlated"},
    {"errors": "correlated"},
    {"cutoff": 10.0, "errors": "correlated"},
]


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """Two joints in a vertical plane: 4 inertial coefficients and 4 of friction."""
    return arms.planar_arm()


def _drawn(network: jc.CSLC, k: Any, rng: np.random.Generator, samples: int, noise: float):
    n = network.joint_count
    q, qd, qdd = rng.uniform(-2, 2, (3, samples, n))
    return patterns_of(network, jnp.asarray(k), (q, qd, qdd), noise * rng.normal(size=(samples, n)))


def _stacked(trees: list[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def test_recovers_friction_that_has_changed(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    """From six samples, which are 36 equations: too few for all 43 coefficients."""
    cleaned = puma_k.at[puma.layout.friction].multiply(0.6)
    q, qd, qdd = exciting_motion
    short = patterns_of(puma, cleaned, (q[:6], qd[:6], qdd[:6]))
    fit = jc.reidentify(puma, short, puma_k, solver=ORDINARY)
    assert_allclose(fit.k, cleaned, atol=_ROUNDING)
    rigid = puma.layout.inertial
    assert np.array_equal(fit.k[rigid], puma_k[rigid])
    assert int(fit.rank) == 12 and fit.unidentifiable == ()
    assert fit.result == jc.RESULTS.successful
    with pytest.raises(RuntimeError, match="Fewer equations"):
        ORDINARY.fit(puma, short)


def test_equals_numpy_on_the_columns_that_are_fitted(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    """Oracle: dense least squares, and the law by which errors of the fixed columns spread."""
    before = ORDINARY.fit(puma, _drawn(puma, puma_k, rng, 300, 0.5))
    q, qd, qdd = exciting_motion
    motion = (q[:200], qd[:200], qdd[:200])
    patterns = patterns_of(puma, puma_k, motion, rng.normal(size=motion[0].shape))
    counts = rng.random(motion[0].shape) < 0.7
    patterns = dataclasses.replace(patterns, backlash_mask=counts)
    fit = jc.reidentify(puma, patterns, before, groups=("dry", "gravity", "kv3"), solver=ORDINARY)

    free = puma.layout.indices("dry", "gravity", "kv3")
    fixed = np.setdiff1d(np.arange(43), free)
    rows, target = np.asarray(puma.regressor(*motion))[counts], np.asarray(patterns.torque)[counts]
    target = target - rows[:, fixed] @ np.asarray(before.k)[fixed]
    k, squares, rank, _ = np.linalg.lstsq(rows[:, free], target, rcond=None)
    inverse_gram = np.linalg.inv(rows[:, free].T @ rows[:, free])
    variance = squares[0] / (len(target) - rank)
    follow = -inverse_gram @ rows[:, free].T @ rows[:, fixed]
    fixed_covariance = np.asarray(before.covariance)[np.ix_(fixed, fixed)]
    covariance = variance * inverse_gram + follow @ fixed_covariance @ follow.T
    assert_allclose(np.asarray(fit.k)[free], k, atol=_ROUNDING)
    assert_allclose(np.asarray(fit.covariance)[np.ix_(free, free)], covariance, rtol=1e-6)
    assert_allclose(
        np.asarray(fit.covariance)[np.ix_(free, fixed)],
        follow @ fixed_covariance,
        rtol=1e-6,
        atol=1e-12,
    )
    assert_allclose(fit.standard_error[fixed], before.standard_error[fixed], rtol=1e-12)
    scaled = rows[:, free] / np.linalg.norm(rows[:, free], axis=0)
    assert_allclose(fit.condition, np.linalg.cond(scaled), rtol=1e-8)
    errors = np.where(counts, np.asarray(puma.torque(fit.k, *motion)) - patterns.torque, 0.0)
    assert_allclose(fit.torque_error, np.sqrt((errors**2).sum(0) / counts.sum(0)), rtol=1e-8)


@pytest.mark.parametrize("options", _OPTIONS, ids=str)
def test_all_groups_are_least_squares(
    options: dict[str, Any], arm: jc.CSLC, rng: np.random.Generator
) -> None:
    patterns = _drawn(arm, rng.normal(size=arm.size), rng, 400, 0.3)
    whole = dataclasses.replace(ORDINARY, **options).fit(arm, patterns)
    fit = jc.reidentify(
        arm,
        patterns,
        np.zeros(arm.size),
        groups=arm.names,
        solver=dataclasses.replace(ORDINARY, **options),
    )
    assert_allclose(fit.k, whole.k, rtol=1e-9)
    assert_allclose(fit.covariance, whole.covariance, rtol=1e-6, atol=1e-14)
    assert_allclose(fit.degrees_of_freedom, whole.degrees_of_freedom)


@pytest.mark.parametrize("options", _OPTIONS, ids=str)
def test_a_part_equals_a_network_of_that_part(
    options: dict[str, Any], arm: jc.CSLC, rng: np.random.Generator
) -> None:
    """Oracle: the payload's columns alone are a robot without mass that carries a body."""
    alone = jc.derive(carrier(arm.robot), lengths="numeric")
    loaded = arm.with_payload()
    # The algebra determines which numbers of a payload are identifiable, one by one.
    names = [f"p{c.expression.replace('m2*r', 'h').rstrip('2')}" for c in alone.coefficients]
    k = rng.normal(size=loaded.size)
    patterns = _drawn(loaded, k, rng, 400, 0.3)
    fixed = np.where([name in names for name in loaded.names], 0.0, k)
    fixed_torque = np.asarray(loaded.torque(fixed, patterns.q, patterns.qd, patterns.qdd))
    reduced = dataclasses.replace(patterns, torque=np.asarray(patterns.torque) - fixed_torque)
    fit = jc.reidentify(
        loaded, patterns, k, groups=names, solver=dataclasses.replace(ORDINARY, **options)
    )
    whole = dataclasses.replace(ORDINARY, **options).fit(alone, reduced)
    indices = [loaded.names.index(name) for name in names]
    assert_allclose(np.asarray(fit.k)[indices], whole.k, rtol=1e-8)
    assert_allclose(
        np.asarray(fit.standard_error)[indices], whole.standard_error, rtol=1e-6, atol=1e-14
    )


def test_what_was_found_in_the_same_patterns_is_found_again(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    """A minimum over all coefficients is one over each part of them."""
    noise = rng.normal(size=exciting_motion[0].shape)
    patterns = patterns_of(puma, puma_k, exciting_motion, noise)
    whole = ORDINARY.fit(puma, patterns)
    fit = jc.reidentify(puma, patterns, whole, groups=("viscous", "mass"), solver=ORDINARY)
    assert_allclose(fit.k, whole.k, atol=_ROUNDING)


def test_standard_errors_cover_the_truth(arm: jc.CSLC, rng: np.random.Generator) -> None:
    """Short recordings of noise of their own, after a noisy identification: both errors count.

    All motion is forwards and from nearly one place, where weight looks like dry friction.
    """
    k = rng.normal(size=arm.size)
    draws = 60
    first = [_drawn(arm, k, rng, 60, 1.0) for _ in range(draws)]
    then: list[jc.Patterns] = []
    for _ in range(draws):
        q, qd, qdd = rng.uniform(-2, 2, (3, 60, 2))
        motion = (0.1 * q, np.abs(qd), qdd)
        then.append(patterns_of(arm, jnp.asarray(k), motion, 0.3 * rng.normal(size=(60, 2))))

    def learn(first: jc.Patterns, then: jc.Patterns) -> tuple[jax.Array, jax.Array]:
        before = ORDINARY.fit(arm, first, throw=False)
        fits = [
            jc.reidentify(arm, then, previous, throw=False, solver=ORDINARY)
            for previous in (before, before.k)
        ]
        both, alone = (jnp.abs(fit.k - k) < 2 * fit.standard_error for fit in fits)
        return both[-4:], alone[-4:]

    inside, noise_alone = jax.jit(jax.vmap(learn))(_stacked(first), _stacked(then))
    # 240 trials of probability 0.954, not all independent: four standard deviations are 0.07.
    assert abs(np.mean(inside) - 0.954) < 0.07
    assert np.mean(noise_alone) < 0.85


def test_a_vector_is_exact(arm: jc.CSLC, rng: np.random.Generator) -> None:
    k = rng.normal(size=arm.size)
    fit = jc.reidentify(arm, _drawn(arm, k, rng, 60, 0.3), k, groups="dry", solver=ORDINARY)
    assert np.all(fit.standard_error[:-2] == 0.0) and np.all(fit.standard_error[-2:] > 0.0)
    assert np.all(fit.determined)


def test_what_a_short_recording_leaves_open_is_named(
    arm: jc.CSLC, rng: np.random.Generator
) -> None:
    """A joint that stands still leaves its friction undetermined."""
    q, qd, qdd = rng.uniform(-2, 2, (3, 50, 2))
    qd[:, 1] = 0.0
    k = rng.normal(size=arm.size)
    fit = jc.reidentify(arm, patterns_of(arm, jnp.asarray(k), (q, qd, qdd)), k, solver=ORDINARY)
    assert fit.result == jc.RESULTS.rank_deficient and int(fit.rank) == 2
    assert fit.unidentifiable == (
        "kv2: nothing in the patterns depends on it",
        "kd2: nothing in the patterns depends on it",
    )
    assert np.isinf(fit.standard_error[arm.names.index("kv2")])
    assert_allclose(fit.k, k, atol=_ROUNDING)  # undetermined coefficients keep their values


def test_last_coefficients_may_be_missing_if_they_are_fitted(
    arm: jc.CSLC, rng: np.random.Generator
) -> None:
    k = rng.normal(size=arm.size)
    fit = jc.reidentify(arm, _drawn(arm, k, rng, 60, 0.0), k[:-2], groups=("dry",), solver=ORDINARY)
    assert_allclose(fit.k, k, atol=_ROUNDING)


def test_jit_and_vmap(arm: jc.CSLC, rng: np.random.Generator) -> None:
    """Over recordings and over what is known of the rest."""
    k = rng.normal(size=arm.size)
    patterns = [_drawn(arm, k, rng, 60, 0.1) for _ in range(3)]
    previous = [ORDINARY.fit(arm, _drawn(arm, k, rng, 60, 0.1)) for _ in range(3)]
    learn = lambda p, f: jc.reidentify(
        arm, p, f, throw=False, solver=jc.LeastSquares(joint_weights="equal", errors="correlated")
    )
    fits = jax.jit(jax.vmap(learn))(_stacked(patterns), _stacked(previous))
    for i in range(3):
        fit = jc.reidentify(
            arm,
            patterns[i],
            previous[i],
            solver=jc.LeastSquares(joint_weights="equal", errors="correlated"),
        )
        assert_allclose(fits.k[i], fit.k, atol=_ROUNDING)
        assert_allclose(fits.standard_error[i], fit.standard_error, rtol=1e-6)


def test_failures(arm: jc.CSLC, puma: jc.CSLC, rng: np.random.Generator) -> None:
    k = rng.normal(size=arm.size)
    patterns = _drawn(arm, k, rng, 60, 0.1)
    fit = ORDINARY.fit(arm, patterns)
    with pytest.raises(
        ValueError, match="there is no 'wet'; expected some of base, viscous, dry, and"
    ):
        jc.reidentify(arm, patterns, k, groups=("viscous", "wet"), solver=ORDINARY)
    with pytest.raises(ValueError, match="none is given"):
        jc.reidentify(arm, patterns, k, groups=(), solver=ORDINARY)
    with pytest.raises(ValueError, match=f"expected {arm.size} coefficients, got 3"):
        jc.reidentify(arm, patterns, k[:3], solver=ORDINARY)
    with pytest.raises(ValueError, match="expected 43 coefficients"):
        jc.reidentify(puma, patterns, fit, solver=ORDINARY)
    other = dataclasses.replace(fit, names=tuple(f"{name}x" for name in fit.names))
    with pytest.raises(ValueError, match="its coefficients are kB1x to kd2x"):
        jc.reidentify(arm, patterns, other, solver=ORDINARY)
    with pytest.raises(RuntimeError, match="NaN"):
        jc.reidentify(arm, patterns, np.where(np.arange(arm.size) == 0, np.nan, k), solver=ORDINARY)
    nothing = dataclasses.replace(patterns, backlash_mask=np.zeros((60, 2), bool))
    with pytest.raises(RuntimeError, match="Fewer equations"):
        jc.reidentify(arm, nothing, k, solver=ORDINARY)
    assert (
        jc.reidentify(arm, nothing, k, throw=False, solver=ORDINARY).result
        == jc.RESULTS.no_equations
    )

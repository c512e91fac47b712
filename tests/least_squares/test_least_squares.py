import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares import dense_factors, rows_of
from tests import arms
from tests.patterns import ORDINARY, Motion, patterns_of


# Rounding of a factorisation of some 10^4 rows, times a condition number of order 10.
_ROUNDING = 1e-10


def masked(patterns: jc.Patterns, mask: np.ndarray) -> jc.Patterns:
    return eqx.tree_at(lambda p: p.backlash_mask, patterns, mask)


def test_recovers_the_coefficients_of_noise_free_patterns(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    fit = ORDINARY.fit(puma, patterns_of(puma, puma_k, exciting_motion))
    assert_allclose(fit.k, puma_k, atol=_ROUNDING)
    assert int(fit.rank) == 43
    assert fit.unidentifiable == ()
    assert fit.result == jc.RESULTS.successful


def test_equals_numpy_on_the_stacked_regressor(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    """Oracle: numpy's least squares on the dense matrix, pairs left out by hand."""
    noise = rng.normal(size=exciting_motion[0].shape)
    patterns = masked(
        patterns_of(puma, puma_k, exciting_motion, noise), rng.random(noise.shape) < 0.7
    )
    fit = ORDINARY.fit(puma, patterns)

    rows = np.asarray(puma.regressor(*exciting_motion))[np.asarray(patterns.backlash_mask)]
    target = np.asarray(patterns.torque)[np.asarray(patterns.backlash_mask)]
    k, squares, rank, _ = np.linalg.lstsq(rows, target, rcond=None)
    assert_allclose(fit.k, k, atol=_ROUNDING)
    assert int(fit.rank) == rank
    variance = squares[0] / (len(target) - rank)
    covariance = variance * np.linalg.inv(rows.T @ rows)
    assert_allclose(fit.covariance, covariance, rtol=1e-6, atol=1e-12)
    assert_allclose(fit.standard_error, np.sqrt(np.diag(covariance)), rtol=1e-6)
    errors = np.where(
        patterns.backlash_mask, np.asarray(puma.torque(k, *exciting_motion)) - patterns.torque, 0.0
    )
    per_joint = np.sqrt((errors**2).sum(axis=0) / np.asarray(patterns.backlash_mask).sum(axis=0))
    assert_allclose(fit.torque_error, per_joint, rtol=1e-8)
    scaled = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)
    assert_allclose(fit.condition, scaled[0] / scaled[-1], rtol=1e-8)


def test_standard_errors_cover_the_truth(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    """Over 40 draws of noise, 95.4 % of the coefficients should be within two standard errors."""
    inside = []
    q, qd, qdd = (x[:512] for x in exciting_motion)
    clean = patterns_of(puma, puma_k, (q, qd, qdd))
    for _ in range(40):
        torque = np.asarray(clean.torque) + 0.5 * rng.normal(size=q.shape)
        fit = ORDINARY.fit(puma, dataclasses.replace(clean, torque=torque))
        inside.append(np.abs(fit.k - puma_k) < 2 * fit.standard_error)
    # 1,720 trials of probability 0.954: four standard deviations are 0.02.
    assert abs(np.mean(inside) - 0.954) < 0.02


def test_joint_weights_equal_weighted_rows(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    deviations = np.array([3.0, 1.0, 0.3, 0.1, 2.0, 0.05])
    noise = deviations * rng.normal(size=exciting_motion[0].shape)
    patterns = patterns_of(puma, puma_k, exciting_motion, noise)
    by_deviation = jc.LeastSquares(joint_weights=1 / deviations, errors="independent").fit(
        puma, patterns
    )
    rows = np.asarray(puma.regressor(*exciting_motion)) / deviations[:, None]
    target = np.asarray(patterns.torque) / deviations
    expected = np.linalg.lstsq(rows.reshape(-1, 43), target.ravel(), rcond=None)[0]
    assert_allclose(by_deviation.k, expected, atol=1e-9)
    by_residual = jc.LeastSquares(joint_weights="residual", errors="independent").fit(
        puma, patterns
    )
    assert_allclose(by_residual.torque_error, deviations, rtol=0.1)
    equal = ORDINARY.fit(puma, patterns)
    assert jnp.linalg.norm(by_residual.k - puma_k) < jnp.linalg.norm(equal.k - puma_k)


def test_stream_equals_one_piece(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    noise = rng.normal(size=exciting_motion[0].shape)
    patterns = masked(
        patterns_of(puma, puma_k, exciting_motion, noise), rng.random(noise.shape) < 0.8
    )
    edges = [0, 1, 700, 701, 2400, 3000]
    pieces = [
        jax.tree.map(lambda x, a=a, b=b: x[a:b], patterns) for a, b in itertools.pairwise(edges)
    ]
    whole, stream = ORDINARY.fit(puma, patterns), ORDINARY.fit_stream(puma, pieces)
    assert_allclose(stream.k, whole.k, atol=_ROUNDING)
    assert_allclose(stream.standard_error, whole.standard_error, rtol=1e-8)
    assert_allclose(stream.equations, whole.equations)


def test_factors_do_not_grow_with_the_patterns(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    patterns = patterns_of(puma, puma_k, exciting_motion)
    some, all_ = (dense_factors(puma, rows_of(patterns, slice(n))) for n in (300, 3000))
    assert [t.shape for t in some.triangles] == [t.shape for t in all_.triangles]
    # 22, 28, 22, 13, 11 and 4 coefficients reach the six joints, and one column is the torque.
    assert [len(t) for t in all_.triangles] == [23, 29, 23, 14, 12, 5]


def test_jit_and_vmap_over_recordings(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    several = [
        patterns_of(puma, puma_k, exciting_motion, rng.normal(size=(3000, 6))) for _ in range(3)
    ]
    batch = jax.tree.map(lambda *x: jnp.stack(x), *several)
    solve = lambda patterns: ORDINARY.fit(puma, patterns, throw=False)
    fits = eqx.filter_jit(eqx.filter_vmap(solve))(batch)
    for i, patterns in enumerate(several):
        assert_allclose(fits.k[i], ORDINARY.fit(puma, patterns).k, atol=1e-9)


class TestUndetermined:
    """Motion that leaves coefficients undetermined."""

    def test_a_locked_arm_names_what_it_cannot_tell(
        self, puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
    ) -> None:
        """Only joint 1 moves: of its inertia terms one combination shows at a fixed posture."""
        q, qd, qdd = (np.zeros((400, 6)) for _ in range(3))
        q[:, 1:] = [0.3, -0.5, 0.2, 0.7, 0.1]
        q[:, 0], qd[:, 0], qdd[:, 0] = rng.normal(size=(3, 400))
        patterns = patterns_of(puma, puma_k, (q, qd, qdd))
        fit = ORDINARY.fit(puma, patterns)
        assert fit.result == jc.RESULTS.rank_deficient
        text = " ".join(fit.unidentifiable)
        assert "kv2" in text and "nothing in the patterns depends on it" in text
        assert "kv1" not in text and "kd1" not in text
        names = list(puma.names)
        for name in ("kv1", "kd1"):
            i = names.index(name)
            assert bool(fit.determined[i])
            assert_allclose(fit.k[i], puma_k[i], atol=1e-8)
        assert np.isinf(fit.standard_error[names.index("kv2")])
        assert_allclose(puma.torque(fit.k, q, qd, qdd), patterns.torque, atol=1e-8)

    def test_no_motion_at_all_has_an_infinite_condition(self) -> None:
        """A joint about the vertical, which motion alone loads, at rest."""
        network = jc.derive(jc.examples.turntable("viscous"))
        still, mask = np.zeros((50, 1)), np.ones((50, 1), bool)
        for kind in (np.asarray, jnp.asarray):
            arrays = (kind(x) for x in (still, still, still, still + 1.0, mask, mask))
            fit = ORDINARY.fit(network, jc.Patterns(np.arange(50.0), *arrays))
            assert (int(fit.rank), float(fit.condition)) == (0, np.inf)
            assert not fit.meaningful and not np.any(np.asarray(fit.determined))

    def test_null_vectors_change_no_torque(
        self, puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
    ) -> None:
        q, qd, qdd = rng.normal(size=(3, 200, 6)) * np.array([1.0, 1, 1, 0, 0, 0])
        fit = ORDINARY.fit(puma, patterns_of(puma, puma_k, (q, qd, qdd)))
        assert int(fit.rank) < 43
        null = np.asarray(fit.undetermined)
        assert np.count_nonzero(np.linalg.norm(null, axis=1)) == 43 - int(fit.rank)
        changes = np.asarray(puma.regressor(q, qd, qdd)) @ null.T
        assert np.abs(changes).max() < 1e-9 * np.abs(null).max()

    def test_a_combination_is_named_with_its_numbers(self) -> None:
        """Two rotors of parallel axes that always turn alike: only the sum shows."""
        robot = jc.Manipulator.from_modified_dh(
            [(0, 0, 0, 0)], gravity=(0, -9.81, 0), friction=("viscous",)
        )
        network = jc.derive(robot, lengths="numeric")
        t = np.linspace(0, 3, 300)[:, None]
        # Exponential motion: qdd = 2 qd, so inertia and viscous friction are indistinguishable
        # once gravity is off.
        still = jc.derive(robot.with_gravity((0, 0, -9.81)), lengths="numeric")
        assert network.size == 4 and still.size == 2
        qd = np.exp(2 * t)
        everything = np.ones(t.shape, bool)
        torque = np.asarray(still.torque(jnp.array([0.5, 0.2]), qd / 2, qd, 2 * qd))
        patterns = jc.Patterns(t[:, 0], qd / 2, qd, 2 * qd, torque, everything, everything)
        fit = ORDINARY.fit(still, patterns)
        assert fit.unidentifiable == ("kB1, kv1: only the combination kB1 + 0.5*kv1 is determined",)
        assert_allclose(fit.k[0] + 0.5 * fit.k[1], 0.6, atol=1e-9)

    def test_units_do_not_decide_rank(
        self, puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
    ) -> None:
        """A torque scaled by a billion leaves rank and condition as they were."""
        patterns = patterns_of(puma, puma_k, exciting_motion)
        scaled = eqx.tree_at(lambda p: p.torque, patterns, 1e9 * np.asarray(patterns.torque))
        fits = [ORDINARY.fit(puma, p) for p in (patterns, scaled)]
        assert int(fits[0].rank) == int(fits[1].rank) == 43
        assert_allclose(fits[0].condition, fits[1].condition, rtol=1e-9)


class TestFailures:
    def test_nan_is_refused_by_name(
        self, puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
    ) -> None:
        patterns = patterns_of(puma, puma_k, exciting_motion)
        torque = np.array(patterns.torque)
        torque[5, 2] = np.nan
        broken = eqx.tree_at(lambda p: p.torque, patterns, torque)
        with pytest.raises(RuntimeError, match="NaN or infinite"):
            ORDINARY.fit(puma, broken)
        assert ORDINARY.fit(puma, broken, throw=False).result == jc.RESULTS.nonfinite

    def test_too_few_equations(
        self, puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
    ) -> None:
        few = jax.tree.map(lambda x: x[:5], patterns_of(puma, puma_k, exciting_motion))
        with pytest.raises(RuntimeError, match="Fewer equations"):
            ORDINARY.fit(puma, few)

    def test_wrong_joints(self, puma: jc.CSLC, exciting_motion: Motion) -> None:
        panda = arms.panda()
        everything = np.ones((3000, 6), bool)
        patterns = jc.Patterns(
            np.arange(3000.0), *exciting_motion, exciting_motion[0], everything, everything
        )
        with pytest.raises(ValueError, match="patterns have 6 joints"):
            ORDINARY.fit(panda, patterns)
        with pytest.raises(ValueError, match="patterns have 6 joints"):
            ORDINARY.fit_stream(panda, [patterns])

    def test_empty_stream(self, puma: jc.CSLC) -> None:
        with pytest.raises(ValueError, match="no patterns"):
            ORDINARY.fit_stream(puma, [])

    def test_single_precision_is_refused(
        self, puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
    ) -> None:
        patterns = patterns_of(puma, puma_k, exciting_motion)
        single = jax.tree.map(
            lambda x: x.astype(np.float32) if x.dtype == np.float64 else x,
            jax.tree.map(np.asarray, patterns),
        )
        with pytest.raises(ValueError, match="float64"):
            ORDINARY.fit(puma, single)

    def test_weights_of_the_wrong_size(
        self, puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
    ) -> None:
        patterns = patterns_of(puma, puma_k, exciting_motion)
        with pytest.raises(ValueError, match="joint_weights"):
            jc.LeastSquares(joint_weights=np.ones(5), errors="independent").fit(puma, patterns)


def test_second_fit_compiles_nothing(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    patterns = patterns_of(puma, puma_k, exciting_motion, rng.normal(size=(3000, 6)))
    ORDINARY.fit(puma, patterns)
    with jax.log_compiles(), pytest.MonkeyPatch.context() as patch:
        compiled: list[str] = []
        patch.setattr("logging.Logger.warning", lambda self, m, *a, **k: compiled.append(str(m)))
        ORDINARY.fit(puma, patterns_of(puma, puma_k, exciting_motion, 0.1))
    assert not [message for message in compiled if "Compiling" in message]


def test_results_are_immutable(puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion) -> None:
    fit = ORDINARY.fit(puma, patterns_of(puma, puma_k, exciting_motion))
    with pytest.raises(dataclasses.FrozenInstanceError):
        fit.k = fit.k  # type: ignore[misc]
    assert "rank 43" in repr(fit)

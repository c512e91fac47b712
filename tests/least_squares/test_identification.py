"""What users hold after a fit: intervals, tables, files; and its errors on validation data."""

import json
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import t as student

import jaxcslc as jc
from jaxcslc.uncertainty import HeldOut, cross_validated_error, held_out_error
from tests import arms
from tests.patterns import ORDINARY, Motion, patterns_of


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """One joint with an upright axis: inertia, viscous and dry friction."""
    return arms.turntable()


TRUE = jnp.array([0.5, 2.0, 1.0])


def recorded(network: jc.CSLC, rng: np.random.Generator, noise: float = 0.1) -> jc.Patterns:
    motion: Motion = tuple(rng.normal(size=(3, 400, 1)))  # type: ignore[assignment]
    return patterns_of(network, TRUE, motion, noise * rng.normal(size=(400, 1)))


@pytest.fixture(scope="module")
def locked(puma: jc.CSLC, puma_k: jax.Array) -> jc.Identification:
    """A fit that leaves coefficients open."""
    rng = np.random.default_rng(3)
    q, qd, qdd = rng.normal(size=(3, 300, 6)) * np.array([1.0, 1, 1, 0, 0, 0])
    noise = rng.normal(size=(300, 6))
    return ORDINARY.fit(puma, patterns_of(puma, puma_k, (q, qd, qdd), noise))


def test_intervals_are_students(arm: jc.CSLC, rng: np.random.Generator) -> None:
    fit = ORDINARY.fit(arm, recorded(arm, rng))
    assert float(fit.degrees_of_freedom) == 400 - 3
    low, high = fit.confidence_interval(0.9).T
    half = student.ppf(0.95, 397) * np.asarray(fit.standard_error)
    assert_allclose(high - low, 2 * half)
    assert_allclose(0.5 * (low + high), fit.k)
    for level in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="expected more than 0 and less than 1"):
            fit.confidence_interval(level)


def test_correlation_is_the_scaled_covariance(arm: jc.CSLC, rng: np.random.Generator) -> None:
    fit = ORDINARY.fit(arm, recorded(arm, rng))
    deviation = np.sqrt(np.diag(fit.covariance))
    assert_allclose(fit.correlation, fit.covariance / np.outer(deviation, deviation), atol=1e-12)
    assert_allclose(np.diag(fit.correlation), 1.0)


def test_correlation_where_nothing_is_uncertain(arm: jc.CSLC) -> None:
    """No division by a deviation of zero."""
    still = np.zeros((20, 1))
    motion = (still, still, np.linspace(-1, 1, 20)[:, None])
    fit = ORDINARY.fit(arm, patterns_of(arm, jnp.zeros(3), motion))
    assert np.all(np.isfinite(fit.correlation))
    assert_allclose(np.diag(fit.correlation), 1.0)


def test_table_and_words(locked: jc.Identification) -> None:
    table = locked.to_pandas(level=0.9)
    assert tuple(table.index) == locked.names
    assert_allclose(table["value"], locked.k)
    assert_allclose(table[["low", "high"]], locked.confidence_interval(0.9))
    assert not table.loc["kv6", "determined"]
    assert "errors independent" in repr(locked)
    assert len(str(locked).splitlines()) == 44
    assert "± inf" in str(locked)


def test_files_round_trip(locked: jc.Identification, tmp_path: Path) -> None:
    """Exactly, with infinite errors; a file of JSON that any language reads."""
    path = tmp_path / "fit.json"
    locked.save(path)
    again = jc.Identification.load(path)
    same = jax.tree.map(lambda a, b: bool(np.array_equal(a, b)), locked, again)
    assert all(jax.tree.leaves(same))
    assert again.names == locked.names and again.errors == locked.errors
    assert again.result == jc.RESULTS.rank_deficient
    assert again.unidentifiable == locked.unidentifiable
    assert None in json.loads(path.read_text())["standard_error"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"k": None}, "k: expected numbers of shape"),
        ({"k": [1.0]}, r"k: expected numbers of shape \(43,\), got \(1,\)"),
        ({"covariance": "much"}, "covariance: expected numbers"),
        ({"names": 3}, "names: expected a list of names"),
        ({"version": 99}, "version is 99; expected 1"),
        ({"errors": "none"}, "errors: expected 'independent', 'correlated' or 'simulated'"),
        ({"result": "fine"}, "result: expected one of successful"),
    ],
)
def test_wrong_files(
    locked: jc.Identification, tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    path = tmp_path / "fit.json"
    path.write_text(json.dumps({**locked.document(), **change}))
    with pytest.raises(ValueError, match=rf"fit\.json: {words}"):
        jc.Identification.load(path)


def test_files_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    for text, words in (("{", "not valid JSON"), ("[1]", "JSON object"), ("{}", "no entry")):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            jc.Identification.load(path)
    with pytest.raises(FileNotFoundError):
        jc.Identification.load(tmp_path / "none.json")


class TestHeldOut:
    def test_noise_alone_warns_of_nothing(self, arm: jc.CSLC, rng: np.random.Generator) -> None:
        training = recorded(arm, rng)
        for _ in range(3):
            validation = recorded(arm, rng)
            judged = held_out_error(arm, ORDINARY.fit(arm, training), training, validation)
            assert judged.beyond_chance == () and judged.warnings == ()
            assert 1.0 < judged.limit[0] < 1.3
        settings = jc.Settings(solver=jc.LeastSquares(errors="independent"))
        assert cross_validated_error(arm, training, settings).beyond_chance == ()

    def test_limit_is_passed_by_chance_one_time_in_a_hundred(
        self, arm: jc.CSLC, rng: np.random.Generator
    ) -> None:
        """For errors that are drawn, not fitted: F at 1 %. Four standard deviations are 0.02."""
        from jaxcslc.uncertainty._held_out import judged_errors

        passed: list[bool] = []
        everything = np.ones((200, 1), bool)
        for _ in range(400):
            training, validation = rng.normal(size=(2, 200, 1))
            passed.append(
                bool(judged_errors(training, everything, validation, everything, 0).beyond_chance)
            )
        assert np.mean(passed) < 0.03

    def test_following_noise_is_seen(self, arm: jc.CSLC, rng: np.random.Generator) -> None:
        """Nine patterns for three coefficients, of noise that swamps them."""
        training, validation = recorded(arm, rng, noise=5.0), recorded(arm, rng, noise=5.0)
        few = jax.tree.map(lambda x: x[:4], training)
        judged = held_out_error(arm, ORDINARY.fit(arm, few), few, validation)
        assert judged.ratio[0] > 1.3

    def test_motion_that_shows_more_is_seen(self, arm: jc.CSLC, rng: np.random.Generator) -> None:
        training, validation = recorded(arm, rng), recorded(arm, rng)
        torque = np.asarray(validation.torque) + 0.3 * np.asarray(validation.q) ** 2
        more = jc.Patterns(
            validation.time,
            validation.q,
            validation.qd,
            validation.qdd,
            torque,
            validation.backlash_mask,
            validation.friction_mask,
        )
        judged = held_out_error(arm, ORDINARY.fit(arm, training), training, more)
        assert judged.beyond_chance == (1,)
        assert "joint 1: validation RMS" in judged.warnings[0]
        assert judged.to_pandas().loc[1, "ratio"] == judged.ratio[0]

    def test_cross_validation_leaves_each_stretch_out(
        self, arm: jc.CSLC, rng: np.random.Generator
    ) -> None:
        """Oracle: the fits one by one."""
        patterns = recorded(arm, rng)
        squares = 0.0
        for fold in range(4):
            left_out = np.arange(400) * 4 // 400 == fold
            kept = jax.tree.map(lambda x, left_out=left_out: x[~left_out], patterns)
            left = jax.tree.map(lambda x, left_out=left_out: x[left_out], patterns)
            k = jc.LeastSquares(joint_weights="residual", errors="independent").fit(arm, kept).k
            squares += np.sum((left.torque - arm.torque(k, left.q, left.qd, left.qdd)) ** 2)
        judged = cross_validated_error(arm, patterns, folds=4)
        assert_allclose(judged.held_out, np.sqrt(squares / 400), rtol=1e-6)

    def test_a_joint_without_pairs(self) -> None:
        judged = HeldOut(np.array([1.0, 0.0]), np.array([1.0, np.nan]), np.array([1.1, 1.1]))
        assert judged.beyond_chance == ()
        assert np.isnan(judged.ratio[1])

    def test_wrong_input(self, arm: jc.CSLC, puma: jc.CSLC, rng: np.random.Generator) -> None:
        patterns = recorded(arm, rng)
        with pytest.raises(ValueError, match="expected 2 to 400 folds"):
            cross_validated_error(arm, patterns, folds=1)
        one = patterns.between(*np.asarray(patterns.time)[:2].tolist())
        with pytest.raises(ValueError, match="of 1 sample; expected at least 2"):
            cross_validated_error(arm, one)
        fit = ORDINARY.fit(arm, patterns)
        with pytest.raises(ValueError, match="patterns have 1 joints"):
            held_out_error(puma, fit, patterns, patterns)

"""Degree of excitation against the dense regressor's singular values."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.report import degree_of_excitation


@pytest.fixture
def patterns(rng: np.random.Generator) -> jc.Patterns:
    """Random motion of six joints, of which some pairs do not count."""
    q, qd, qdd, torque = rng.normal(size=(4, 400, 6))
    counts = rng.random((2, 400, 6)) < 0.8
    return jc.Patterns(np.arange(400.0), q, qd, qdd, torque, *counts)


def singular_values(network: jc.CSLC, patterns: jc.Patterns, columns: np.ndarray) -> np.ndarray:
    rows = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    rows = rows[np.asarray(patterns.mask)][:, columns]
    return np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)


def test_against_the_dense_regressor(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    excitation = degree_of_excitation(puma, patterns)
    groups = np.array([coefficient.group for coefficient in puma.coefficients])
    expected = singular_values(puma, patterns, np.ones(puma.size, bool))
    assert_allclose(excitation.condition, expected[0] / expected[-1], rtol=1e-9)
    assert_allclose(excitation.smallest, expected[-1], rtol=1e-9)
    for group, condition in excitation.group_condition.items():
        expected = singular_values(puma, patterns, groups == group)
        assert_allclose(condition, expected[0] / expected[-1], rtol=1e-9)
    assert list(excitation.group_condition) == ["mass", "gravity", "viscous", "dry"]


def test_is_what_a_fit_of_the_same_patterns_reports(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit(puma, patterns)
    assert_allclose(degree_of_excitation(puma, patterns).condition, fit.condition, rtol=1e-9)


def test_neither_units_nor_length_enter(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    twice = jc.Patterns(
        *(
            np.concatenate([np.asarray(x)] * 2)
            for x in (
                patterns.time,
                patterns.q,
                patterns.qd,
                patterns.qdd,
                1e3 * np.asarray(patterns.torque),
                patterns.backlash_mask,
                patterns.friction_mask,
            )
        )
    )
    once = degree_of_excitation(puma, patterns)
    assert_allclose(degree_of_excitation(puma, twice).condition, once.condition, rtol=1e-9)


def test_weakest_is_the_combination_that_shows_least(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    excitation = degree_of_excitation(puma, patterns)
    rows = np.asarray(puma.regressor(patterns.q, patterns.qd, patterns.qdd))
    rows = rows[np.asarray(patterns.mask)]
    shown = (rows / np.linalg.norm(rows, axis=0)) @ np.asarray(excitation.weakest)
    assert_allclose(np.linalg.norm(shown), excitation.smallest, rtol=1e-9)
    assert_allclose(np.linalg.norm(excitation.weakest), 1.0, rtol=1e-12)


def test_a_joint_that_rests_leaves_it_infinite(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    """No velocity, no viscous friction: its column is zero."""
    qd = np.array(patterns.qd)
    qd[:, 3] = 0.0
    still = jc.Patterns(
        patterns.time, patterns.q, qd, patterns.qdd, patterns.torque, *[np.ones(qd.shape, bool)] * 2
    )
    excitation = degree_of_excitation(puma, still)
    assert excitation.condition == np.inf
    assert excitation.group_condition["viscous"] == np.inf
    assert np.isfinite(excitation.group_condition["gravity"])


def test_rows_and_words(puma: jc.CSLC, patterns: jc.Patterns) -> None:
    excitation = degree_of_excitation(puma, patterns)
    assert [row["coefficients"] for row in excitation.rows()] == [
        "all",
        "mass",
        "gravity",
        "viscous",
        "dry",
    ]
    assert excitation.rows()[0]["condition"] == float(excitation.condition)
    worst = puma.names[int(np.argmax(np.abs(np.asarray(excitation.weakest))))]
    assert f"least determined: {worst}" in str(excitation)

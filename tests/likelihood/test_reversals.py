"""Moments of reversals that a search starts from: those of another fit to the same motion."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.likelihood._signs import LATEST_TURN, Signs
from tests import arms


SAMPLES = 400
TIME = np.arange(SAMPLES) * 5e-3


def signs_of(q: np.ndarray) -> Signs:
    stuck = np.zeros((len(q) - 1, q.shape[1]), bool)
    return Signs.of(q, TIME[: len(q)], stuck, margin=2, modelled=True)


def test_moments_are_those_of_the_samples_that_they_are_next_to() -> None:
    q = np.stack([np.sin(7 * TIME), np.cos(3 * TIME)], axis=1)
    signs = signs_of(q)
    turn = np.random.default_rng(0).uniform(-1.3, 1.3, len(signs.samples))
    moments = signs.moments(turn, SAMPLES)
    assert np.isfinite(moments).sum() == len(turn) > 4
    assert_array_equal(signs.from_moments(moments), turn)
    assert not signs.without_moments(moments).any()
    # The same moments, counted from the sample after.
    later = np.vstack([np.full((1, 2), np.nan), moments[:-1]])
    shifted = signs.from_moments(later)
    inside = np.abs(turn + 1.0) < LATEST_TURN
    assert_allclose(shifted[inside], (turn + 1.0)[inside])
    assert_array_equal(shifted[~inside], signs.turn[~inside])


def test_reversals_without_a_moment_are_said() -> None:
    signs = signs_of(np.sin(7 * TIME)[:, None])
    moments = signs.moments(signs.turn, SAMPLES)
    moments[signs.samples[1], 0] = np.nan
    assert_array_equal(np.flatnonzero(signs.without_moments(moments)[:, 0]), [signs.samples[1] - 1])


def test_reversals_at_bounds_are_said() -> None:
    signs = signs_of(np.sin(7 * TIME)[:, None])
    turn = np.zeros(len(signs.samples))
    turn[[0, 2]] = LATEST_TURN, -LATEST_TURN
    rows = np.flatnonzero(signs.at_bounds(turn)[:, 0])
    assert_array_equal(rows, signs.samples[[0, 2]] - 1)


def test_a_search_from_a_minimum_ends_there() -> None:
    network = arms.pendulum("viscous", "dry")
    time = np.arange(SAMPLES)[:, None] * 5e-3
    q, qd, qdd = np.sin(7 * time), 7 * np.cos(7 * time), -49 * np.sin(7 * time)
    torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.4]), q, qd, qdd))
    noise = 1e-3 * np.random.default_rng(0).normal(size=torque.shape)
    recording = jc.Recording(time[:, 0], 1e-5 * np.round(q / 1e-5), torque + noise)
    estimator = jc.MaximumLikelihood(torque_sampling="sampled", every=1)
    first = estimator.fit(network, recording)
    again = estimator.fit(network, recording, start=first)
    assert again.reversals == first.reversals == np.isfinite(first.reversal_moments).sum()
    assert again.steps <= first.steps // 2
    errors = np.asarray(first.fit.standard_error)
    assert_allclose(np.asarray(again.k), np.asarray(first.k), atol=0.02 * errors.min())

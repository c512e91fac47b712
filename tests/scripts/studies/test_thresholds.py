"""Thresholds of static friction refined on residuals."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxcslc as jc
import sim
from scripts.studies.thresholds import refine_thresholds
from tests import arms


INTERVAL = 0.002
K = np.array([0.5, 0.3, -0.1, 0.4, 0.6])
GAMMA, EXCESS = 0.15, 0.25
RATES, SIZES = np.array([3.1, 7.3, 12.7]), np.array([0.9, 0.5, 0.12])
SETTINGS = jc.Settings(jc.Preparation(jc.AveragedSplines(17)))


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum()


def swing(network: jc.CSLC, rng: np.random.Generator, excess: float = EXCESS) -> jc.Recording:
    """12 s of a pendulum that is read in counts of 0.1 mrad."""
    time = np.arange(6000) * INTERVAL
    phase = np.outer(time, RATES)
    q = (np.sin(phase) @ SIZES)[:, None]
    qd = (np.cos(phase) @ (SIZES * RATES))[:, None]
    qdd = (-np.sin(phase) @ (SIZES * RATES**2))[:, None]
    torque = np.asarray(network.torque(K, q, qd, qdd))
    torque = torque + excess * np.sign(qd) * np.exp(-np.abs(qd) / GAMMA)
    counts = 1e-4 * np.round(q / 1e-4 + rng.uniform(size=q.shape))
    return jc.Recording(time, counts, torque)


def index_of(network: jc.CSLC, group: str) -> int:
    return [coefficient.group for coefficient in network.coefficients].index(group)


def test_the_slope_that_was_put_in_is_found(pendulum: jc.CSLC, rng: np.random.Generator) -> None:
    # Of a single recording, the excess scatters by a quarter.
    recordings = [swing(pendulum, rng) for _ in range(3)]
    results = [refine_thresholds(pendulum, recording, SETTINGS) for recording in recordings]
    assert all(refined.converged for refined in results)
    slopes = [refined.static_friction.slope_velocity[0] for refined in results]
    excesses = [refined.static_friction.excess[0] for refined in results]
    assert np.mean(slopes) == pytest.approx(GAMMA, rel=0.35)
    assert np.mean(excesses) == pytest.approx(EXCESS, rel=0.35)
    recording, refined = recordings[0], results[0]
    thresholds = refined.settings.preparation.thresholds
    assert isinstance(thresholds, tuple)
    assert 3.0 * GAMMA < thresholds[0] < 6.0 * GAMMA
    # Beyond it, friction is what the network knows; from one hundredth on, it was not.
    start = SETTINGS.with_options(threshold_fraction=0.01)
    first = start.fit(pendulum, start.patterns(recording))
    for group in ("viscous", "dry"):
        i = index_of(pendulum, group)
        assert abs(refined.fit.k[i] - K[i]) < 0.2 * abs(first.k[i] - K[i])


def test_what_is_returned_belongs_together(pendulum: jc.CSLC, rng: np.random.Generator) -> None:
    recording = swing(pendulum, rng)
    refined = refine_thresholds(pendulum, recording, SETTINGS)
    again = refined.settings.patterns(recording)
    assert np.array_equal(
        np.asarray(again.friction_mask), np.asarray(refined.patterns.friction_mask)
    )
    np.testing.assert_allclose(
        np.asarray(refined.settings.fit(pendulum, again).k), np.asarray(refined.fit.k)
    )
    assert refined.settings.preparation.thresholds == tuple(refined.rounds[-1].tolist())
    first = 0.01 * np.max(np.abs(np.asarray(refined.patterns.qd)))
    np.testing.assert_allclose(refined.rounds[0], first)
    # Nothing but the thresholds is changed.
    kept = refined.settings.with_options(
        thresholds=None, threshold_fraction=SETTINGS.preparation.threshold_fraction
    )
    assert kept == SETTINGS


def test_without_static_friction_thresholds_stay(
    pendulum: jc.CSLC, rng: np.random.Generator
) -> None:
    refined = refine_thresholds(pendulum, swing(pendulum, rng, excess=0.0), SETTINGS)
    assert refined.converged and not refined.static_friction.significant[0]
    np.testing.assert_allclose(refined.rounds[-1], refined.rounds[0])


def test_rounds_run_out(pendulum: jc.CSLC, rng: np.random.Generator) -> None:
    refined = refine_thresholds(pendulum, swing(pendulum, rng), SETTINGS, rounds=1)
    assert len(refined.rounds) == 2
    assert not refined.converged
    with pytest.raises(ValueError, match="0 rounds; expected 1 or more"):
        refine_thresholds(pendulum, swing(pendulum, rng), SETTINGS, rounds=0)


def test_a_simulated_machine_whose_slopes_are_known(puma: jc.CSLC, puma_k: jax.Array) -> None:
    """Twice the slopes of the preset, which every joint shows at this spacing but the last:
    that one turns round so quickly that the smoothing is wider than its ramps."""
    preset = sim.puma560()
    slopes = tuple(2.0 * gamma for gamma in preset.static_velocity)
    machine = dataclasses.replace(preset, static_velocity=slopes)
    recording, _ = sim.simulate(machine, sim.training(), seed=3)
    settings = jc.Settings(jc.Preparation(jc.AveragedSplines(17), torque_alignment="mean"))
    refined = refine_thresholds(puma, recording, settings)
    assert refined.static_friction.significant.tolist()[:5] == [True] * 5
    ends = 5.0 * np.array(slopes)
    ratio = refined.rounds[-1] / ends
    assert np.all((ratio[:5] > 0.5) & (ratio[:5] < 2.0))
    start = settings.with_options(threshold_fraction=0.01)
    first = start.fit(puma, start.patterns(recording))
    dry = [i for i, c in enumerate(puma.coefficients) if c.group == "dry"][:5]
    error, before = (np.abs(np.asarray(k - puma_k))[dry] for k in (refined.fit.k, first.k))
    assert np.sum(error) < 0.5 * np.sum(before)

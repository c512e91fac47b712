"""Systematic errors: what smoothing and terms that the network lacks do to coefficients."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.report import verdicts
from jaxcslc.uncertainty import (
    TOLERATED,
    SystematicError,
    SystematicProblem,
    smoothing_bias,
    standard_uncertainty,
    systematic_error,
    uncertainty_interval,
)
from tests import arms


# Time, position, velocity and acceleration.
Motion: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

INTERVAL = 0.005  # s
TERMS = ("torque offset", "static friction", "motor saturation")
CAUSES = ("smoothing", "torque timing", *TERMS)
# Every pair counts, so that an oracle needs no masks; a smoothing that leaves this motion alone.
GENTLE = jc.Settings(
    jc.Preparation(jc.SavitzkyGolay(9, 5), thresholds=0.0, trim=10),
    jc.LeastSquares(joint_weights="equal", errors="independent"),
)


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """One joint with an upright axis: inertia, viscous and dry friction."""
    return arms.turntable()


@pytest.fixture(scope="module")
def swing() -> Motion:
    """Time, position, velocity and acceleration of a sum of three sinusoids, 8 s."""
    t = np.arange(1600)[:, None] * INTERVAL
    parts = [(0.4, 2.0, 0.3), (0.2, 5.1, 1.0), (0.1, 9.3, 2.0)]
    q, qd, qdd = (
        sum(a * w**order * np.sin(w * t + p + order * np.pi / 2) for a, w, p in parts)
        for order in range(3)
    )
    return t[:, 0], np.asarray(q), np.asarray(qd), np.asarray(qdd)


def recorded(
    network: jc.CSLC,
    motion: Motion,
    further: Callable[[np.ndarray], np.ndarray] | None = None,
    noise: np.ndarray | float = 0.0,
) -> jc.Recording:
    """A recording of an arm with inertia 0.5, viscous friction 2 and dry friction 1."""
    t, q, qd, qdd = motion
    torque = np.asarray(network.torque(np.array([0.5, 2.0, 1.0]), q, qd, qdd)) + noise
    return jc.Recording(t, q, torque if further is None else torque + further(qd))


def test_smoothing_of_a_sinusoid(arm: jc.CSLC) -> None:
    """Oracle: gains in closed form, of the Butterworth filter (bilinear transform), of central
    differences, and of the second derivative of a cubic spline at its knots.

    A gain H of the smoothing makes the inertia too large by 1 / H; once more, by the same factor.
    """
    frequency, cutoff = 2.0, 6.0
    w = 2 * np.pi * frequency
    t = np.arange(2001)[:, None] * INTERVAL  # whole periods: odd about both ends
    q, qdd = np.sin(w * t), -(w**2) * np.sin(w * t)
    recording = jc.Recording(t[:, 0], q, 0.5 * qdd)
    network = jc.derive(arm.robot.with_friction(), lengths="numeric")
    settings = jc.Settings(jc.Preparation(jc.Butterworth(cutoff), thresholds=0.0))
    fit = settings.fit(network, settings.patterns(recording))
    warped = np.tan(np.pi * frequency * INTERVAL) / np.tan(np.pi * cutoff * INTERVAL)
    angle = w * INTERVAL
    spline = 6.0 * (2.0 - 2.0 * np.cos(angle)) / (angle**2 * (4.0 + 2.0 * np.cos(angle)))
    gain = (np.sin(angle) / angle) ** 2 / (1.0 + warped**8) / spline
    expected = np.asarray(fit.k) * (1.0 / gain - 1.0)
    shift = systematic_error(network, recording, settings, fit).parts["smoothing"]
    assert_allclose(shift, expected, rtol=1e-3)
    # Signed, and of two recordings that of both.
    problem = SystematicProblem.of(network, recording, settings)
    for count in (1, 2):
        assert_allclose(smoothing_bias([problem] * count, np.asarray(fit.k)), expected, rtol=1e-3)


def test_smoothing_once_more_sees_the_reversals_of_the_recording(arm: jc.CSLC) -> None:
    """Encoder counts hide a ripple, which is no reversal in smoothed motion either.

    Oracle: the same part with the tolerance written down, six deviations of the noise of counts.
    """
    count = 1e-3
    t = np.arange(4000)[:, None] * INTERVAL
    # Near its turns the slow motion reverses with every period of the ripple.
    q = 0.3 * np.sin(t) + 0.3 * count * np.sin(9.0 * t)
    qd = 0.3 * np.cos(t) + 2.7 * count * np.cos(9.0 * t)
    qdd = -0.3 * np.sin(t) - 24.3 * count * np.sin(9.0 * t)
    torque = np.asarray(arm.torque(np.array([0.5, 2.0, 1.0]), q, qd, qdd))
    recording = jc.Recording(t[:, 0], count * np.round(q / count), torque)
    parts: list[np.ndarray] = []
    noise = jc.recordings.noise_level(recording.position)
    for tolerance in (None, float(6.0 * np.sqrt(3.0) * noise[0])):
        smoothing = jc.AveragedSplines(17, tolerance=tolerance)
        settings = jc.Settings(jc.Preparation(smoothing, thresholds=0.0))
        fit = settings.fit(arm, settings.patterns(recording))
        parts.append(systematic_error(arm, recording, settings, fit).parts["smoothing"])
    assert_allclose(parts[0], parts[1], rtol=1e-6)


def test_timing_of_a_sinusoid(arm: jc.CSLC) -> None:
    """In closed form, by complex amplitudes: the mean of two samples' torques is late by half a
    sample, and a late inertia torque is viscous friction."""
    w = 2 * np.pi
    t = np.arange(2001)[:, None] * INTERVAL
    q, qd, qdd = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
    network = jc.derive(arm.robot.with_friction("viscous"), lengths="numeric")
    recording = jc.Recording(t[:, 0], q, 0.5 * qdd + 2.0 * qd)
    fit = GENTLE.fit(network, GENTLE.patterns(recording))
    parts = systematic_error(network, recording, GENTLE, fit).parts["torque timing"]
    late = 0.5 * (1.0 - np.exp(-1j * w * INTERVAL)) * (0.5 * -(w**2) + 2.0 * 1j * w)
    assert_allclose(np.sqrt(3.0) * parts, [abs(late.real) / w**2, abs(late.imag) / w], rtol=5e-3)


def test_timing_is_what_another_alignment_changes(arm: jc.CSLC, swing: Motion) -> None:
    """Half a sample lies between the alignments 'sample' and 'mean', jumps of dry friction
    included."""
    recording = recorded(arm, swing)
    fits = [
        settings.fit(arm, settings.patterns(recording))
        for settings in (GENTLE, GENTLE.with_options(torque_alignment="mean"))
    ]
    change = np.abs(np.asarray(fits[1].k) - np.asarray(fits[0].k))
    part = systematic_error(arm, recording, GENTLE, fits[0]).parts["torque timing"]
    assert_allclose(np.sqrt(3.0) * part, change, rtol=0.05, atol=1e-4)


@pytest.mark.parametrize("cutoff", [None, 10.0])
def test_missing_terms_against_dense_least_squares(
    arm: jc.CSLC,
    swing: Motion,
    rng: np.random.Generator,
    cutoff: float | None,
) -> None:
    """Oracle: NumPy's `lstsq` with a column of ones, and a loop of the jackknife."""
    noise = 0.05 * rng.normal(size=swing[1].shape)
    recording = recorded(arm, swing, lambda qd: 0 * qd + 0.3, noise)
    settings = GENTLE.with_options(cutoff=cutoff)
    patterns = settings.patterns(recording)
    fit = settings.fit(arm, patterns)
    part = systematic_error(arm, recording, settings, fit).parts["torque offset"]

    equations = settings.solver.equations(arm, patterns)
    rows, sample = equations.rows[0], equations.sample[0]
    ones, every = np.ones((1, patterns.samples)), np.ones(patterns.samples, bool)
    offset = ones.T
    if cutoff is not None:
        offset = jc.recordings.parallel_filter(
            ones, ones[0], every, interval=INTERVAL, cutoff=cutoff
        ).regressor

    def further(kept: np.ndarray) -> float:
        wide = np.concatenate([rows[kept, :-1], offset[kept]], axis=1)
        return float(np.linalg.lstsq(wide, rows[kept, -1], rcond=None)[0][-1])

    change = np.linalg.lstsq(rows[:, :-1], offset[:, 0], rcond=None)[0]
    stretch = sample * 8 // patterns.samples
    without = np.array([further(stretch != number) for number in range(8)])
    variance = 7 / 8 * np.sum((without - without.mean()) ** 2)
    square = further(np.ones(len(rows), bool)) ** 2 - variance
    assert_allclose(part, np.abs(change) * np.sqrt(max(square, 0.0)), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("term", "torque"),
    [
        ("torque offset", lambda qd: 0 * qd + 0.5),
        ("static friction", lambda qd: 0.6 * np.sign(qd) * np.exp(-np.abs(qd) / 0.15)),
    ],
)
def test_intervals_contain_the_truth_in_spite_of_missing_terms(
    arm: jc.CSLC,
    swing: Motion,
    rng: np.random.Generator,
    term: str,
    torque: Callable[[np.ndarray], np.ndarray],
) -> None:
    """A third of the motion only: the offset is not orthogonal to the other terms."""
    t, q, qd, qdd = (x[:500] for x in swing)
    part = (t, q, qd, qdd)
    noise = 0.02 * rng.normal(size=part[1].shape)
    recording = recorded(arm, part, torque, noise)
    settings = GENTLE.with_options(thresholds=0.1)
    fit = settings.fit(arm, settings.patterns(recording))
    error = systematic_error(arm, recording, settings, fit)
    truth = np.array([0.5, 2.0, 1.0])
    off = np.abs(np.asarray(fit.k) - truth)
    worst = int(np.argmax(off / np.asarray(fit.standard_error)))
    narrow, wide = fit.confidence_interval(), uncertainty_interval(fit, error)
    assert not narrow[worst, 0] <= truth[worst] <= narrow[worst, 1]
    assert np.all((wide[:, 0] <= truth) & (truth <= wide[:, 1]))
    assert error.parts[term][worst] > 0.4 * off[worst]
    (verdict,) = [v for v in verdicts(arm, fit, systematic=error) if v.name == arm.names[worst]]
    assert re.search(
        rf"; systematic error [\d.]+ (% of|times) the value, mostly from {term}$", verdict.reason
    )


def test_noise_alone_hardly_widens(arm: jc.CSLC, swing: Motion) -> None:
    """Terms that the machine does not have: their changes are noise, which is taken off."""
    wider: list[np.ndarray] = []
    for seed in range(10):
        noise = 0.5 * np.random.default_rng(seed).normal(size=swing[1].shape)
        recording = recorded(arm, swing, noise=noise)
        fit = GENTLE.fit(arm, GENTLE.patterns(recording))
        parts = systematic_error(arm, recording, GENTLE, fit).parts
        # Half a sample's delay is possible whatever the noise.
        error = SystematicError({name: parts[name] for name in ("smoothing", *TERMS)})
        assert np.all(error.parts["smoothing"] < 0.1 * np.asarray(fit.standard_error))
        wider.append(standard_uncertainty(fit, error) / np.asarray(fit.standard_error))
    assert np.median(wider) < 1.2
    assert np.mean(wider) < 1.6


def test_terms_that_the_network_has(swing: Motion) -> None:
    network = arms.turntable("viscous", "static", "offset")
    t, q, qd, qdd = swing
    torque = np.asarray(network.torque(np.array([0.5, 2.0, 1.0, 0.2]), q, qd, qdd))
    recording = jc.Recording(t, q, torque)
    fit = GENTLE.fit(network, GENTLE.patterns(recording))
    error = systematic_error(network, recording, GENTLE, fit)
    assert tuple(error.parts) == ("smoothing", "torque timing", "motor saturation")


def test_what_no_recording_of_the_motion_can_tell_apart(arm: jc.CSLC) -> None:
    """One direction of motion: an offset looks like dry friction, and makes no part of it. A joint
    at rest: friction is not determined, and its interval stays infinite."""
    t = np.arange(800)[:, None] * INTERVAL
    qd, qdd = 2.0 + np.sin(3 * t), 3 * np.cos(3 * t)
    q = 2.0 * t - np.cos(3 * t) / 3
    one_way = recorded(arm, (t[:, 0], q, qd, qdd))
    fit = GENTLE.fit(arm, GENTLE.patterns(one_way))
    assert_allclose(systematic_error(arm, one_way, GENTLE, fit).parts["torque offset"], 0.0)

    pendulum = jc.derive(
        jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, 0, -9.81)),
        lengths="numeric",
    )
    still = np.concatenate([q, 0 * q], axis=1)
    recording = jc.Recording(t[:, 0], still, np.concatenate([qdd, 0 * qdd], axis=1))
    fit = GENTLE.fit(pendulum, GENTLE.patterns(recording))
    error = systematic_error(pendulum, recording, GENTLE, fit)
    lost = ~np.asarray(fit.determined)
    assert np.any(lost) and np.all(error.total[lost] == 0.0) and np.all(np.isfinite(error.total))
    assert np.all(np.isinf(uncertainty_interval(fit, error)[lost]))


def test_fixed_coefficients_have_none(arm: jc.CSLC, swing: Motion) -> None:
    recording = recorded(arm, swing, lambda qd: 0 * qd + 0.5)
    patterns = GENTLE.patterns(recording)
    fit = GENTLE.reidentify(arm, patterns, np.array([0.4, 2.0, 1.0]), ["viscous", "dry"])
    error = systematic_error(arm, recording, GENTLE, fit, groups=["viscous", "dry"])
    assert error.total[0] == 0.0 and np.all(error.total[1:] > 0.0)


def test_robust_loss_keeps_its_weights(
    arm: jc.CSLC, swing: Motion, rng: np.random.Generator
) -> None:
    """One torque in fifty is wild: the parts are those of the recording without them."""
    clean = 0.05 * rng.normal(size=swing[1].shape)
    wild = np.where(rng.uniform(size=clean.shape) < 0.02, 50.0, 0.0)
    settings = GENTLE.with_options(loss="bisquare")
    totals: list[np.ndarray] = []
    for noise in (clean, clean + wild):
        recording = recorded(arm, swing, lambda qd: 0 * qd + 1.0, noise)
        fit = settings.fit(arm, settings.patterns(recording))
        totals.append(systematic_error(arm, recording, settings, fit).total)
    assert_allclose(totals[1], totals[0], rtol=0.15, atol=1e-3)


def test_report(arm: jc.CSLC, swing: Motion, tmp_path: Path) -> None:
    """Table, files and verdicts with the systematic error, and without it."""
    recording = recorded(
        arm,
        (swing[0][:500], swing[1][:500], swing[2][:500], swing[3][:500]),
        lambda qd: 0 * qd + 0.8,
    )
    with_it = jc.identify(arm, recording, settings=GENTLE)
    without = jc.identify(arm, recording, settings=GENTLE, systematic=False)
    assert with_it.systematic is not None and without.systematic is None
    assert "Systematic errors included: smoothing, torque timing, torque offset" in str(with_it)
    assert "systematic" not in str(without).lower()
    for row, plain, total in zip(
        with_it.rows(), without.rows(), with_it.systematic.total, strict=True
    ):
        assert row["systematic_error"] == total and "systematic_error" not in plain
        lows, highs = ([float(r[name]) for r in (row, plain)] for name in ("low", "high"))
        assert lows[0] <= lows[1] <= highs[1] <= highs[0]
    kinds = {str(row["verdict"]) for row in with_it.rows()}
    assert "systematic error" in kinds and {row["verdict"] for row in without.rows()} != kinds
    with_it.save(tmp_path, pictures=False)
    document = json.loads((tmp_path / "identification.json").read_text())
    assert tuple(document["systematic_error"]) == (*CAUSES, *TOLERATED)
    assert_array_equal(
        document["systematic_error"]["torque offset"], with_it.systematic.parts["torque offset"]
    )
    assert "systematic_error" in (tmp_path / "coefficients.csv").read_text().splitlines()[0]


def test_intervals_scale_with_the_uncertainty(
    arm: jc.CSLC, swing: Motion, rng: np.random.Generator
) -> None:
    recording = recorded(arm, swing, noise=rng.normal(size=swing[1].shape))
    fit = GENTLE.fit(arm, GENTLE.patterns(recording))
    error = SystematicError({"smoothing": np.array([0.0, 1.0, 2.0])})
    assert_array_equal(uncertainty_interval(fit), fit.confidence_interval())
    ratio = np.ptp(uncertainty_interval(fit, error, 0.9), axis=1) / np.ptp(
        fit.confidence_interval(0.9), axis=1
    )
    se = np.asarray(fit.standard_error)
    assert_allclose(ratio, np.sqrt(se**2 + np.array([0.0, 1.0, 4.0])) / se)
    with pytest.raises(ValueError, match="level is 2"):
        uncertainty_interval(fit, error, 2.0)

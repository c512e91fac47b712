"""Alignment, masks, and the patterns that they make."""

import itertools

import numpy as np
import pytest

from jaxcslc.recordings import (
    AveragedSplines,
    Butterworth,
    CentralDifferences,
    Patterns,
    Preparation,
    Recording,
    SavitzkyGolay,
    align_torque,
    away_from_reversals,
    choose_spacing,
    encoder_resolution,
    friction_mask,
    friction_thresholds,
    left_out_error,
    noise_level,
    possible_backlash,
    prepare,
)


COUNTS = np.array([0.10035e-3, 0.073156e-3])


def swinging(samples: int = 1500, interval: float = 0.002) -> Recording:
    """Two joints of different periods, in counts of the PUMA 560's first two encoders."""
    time = np.arange(samples) * interval
    omega = 2 * np.pi / np.array([1.713, 0.7307])
    position = COUNTS * np.round(np.sin(omega * time[:, None]) / COUNTS)
    velocity = omega * np.cos(omega * time[:, None])
    acceleration = -(omega**2) * np.sin(omega * time[:, None])
    return Recording(time, position, acceleration + np.sign(velocity), velocity, acceleration)


def test_alignment_by_hand() -> None:
    torque = np.array([[1.0, 8.0], [2.0, 6.0], [4.0, 2.0]])
    assert align_torque(torque, "sample") is torque
    assert align_torque(torque, "previous").tolist() == [[1.0, 8.0], [1.0, 8.0], [2.0, 6.0]]
    assert align_torque(torque, "mean").tolist() == [[1.0, 8.0], [1.5, 7.0], [3.0, 4.0]]


def test_a_held_torque_is_in_step_with_smoothed_motion_in_the_mean() -> None:
    # A unit mass under a held force: exact positions, and derivatives symmetric in time.
    interval = 0.01
    time = np.arange(2000) * interval
    force = np.sin(2 * np.pi * 0.5 * time)
    velocity = np.concatenate([[0.0], np.cumsum(force[:-1]) * interval])
    steps = velocity[:-1] * interval + 0.5 * force[:-1] * interval**2
    recording = Recording(time, np.concatenate([[0.0], np.cumsum(steps)])[:, None], force[:, None])

    def misfit(alignment: str) -> float:
        patterns = prepare(
            recording,
            smoothing=AveragedSplines(5, sections=False),
            torque_alignment=alignment,  # pyright: ignore[reportArgumentType]
            trim=50,
        )
        return float(np.max(np.abs(patterns.torque - patterns.qdd)))

    # Half an interval of delay at 1 Hz, π times 0.5 Hz times the interval.
    delay = np.pi * 0.5 * interval
    assert misfit("sample") == pytest.approx(delay, rel=0.1)
    assert misfit("previous") == pytest.approx(delay, rel=0.1)
    assert misfit("mean") < delay / 20
    # Of a checker of annotations, where one is at work, or of the function itself.
    with pytest.raises((TypeError, ValueError), match="next"):
        misfit("next")


def test_backlash_mask_against_a_literal_loop(rng: np.random.Generator) -> None:
    qd, qdd, torque = rng.standard_normal((3, 50, 4))
    mask = possible_backlash(qd, qdd, torque)
    for n, i in itertools.product(range(50), range(4)):
        literal = np.sign(torque[n, i]) == np.sign(qd[n, i]) and np.sign(torque[n, i]) == np.sign(
            qdd[n, i]
        )
        assert mask[n, i] == literal


def test_a_zero_may_have_had_either_sign() -> None:
    for signs in itertools.product((-1.0, 0.0, 1.0), repeat=3):
        choices = [(-1.0, 1.0) if sign == 0.0 else (sign,) for sign in signs]
        possible = any(len(set(choice)) == 1 for choice in itertools.product(*choices))
        qd, qdd, torque = (np.array([sign]) for sign in signs)
        assert possible_backlash(qd, qdd, torque).tolist() == [possible]


def test_thresholds_and_sliding() -> None:
    qd = np.array([[0.02, -1.0], [-2.0, 0.01], [0.5, 0.0]])
    thresholds = friction_thresholds(qd, 0.01)
    assert thresholds.tolist() == [0.02, 0.01]
    # Strictly above: a velocity at the threshold is not.
    assert friction_mask(qd, thresholds).tolist() == [[False, True], [True, False], [True, False]]
    assert friction_mask(qd, 0.0).tolist() == [[True, True], [True, True], [True, False]]
    with pytest.raises(ValueError, match=r"shape \(3,\); expected one number, or one for each of"):
        friction_mask(qd, [0.1, 0.1, 0.1])
    for bad in (-0.1, [0.1, np.nan]):
        with pytest.raises(ValueError, match="expected none below 0"):
            friction_mask(qd, bad)
    with pytest.raises(ValueError, match="threshold fraction is 1"):
        friction_thresholds(qd, 1.0)


def test_reversal_margin_against_a_literal_loop(rng: np.random.Generator) -> None:
    qd = np.round(np.cumsum(rng.standard_normal((200, 3)), axis=0) / 2)
    for margin in (0, 1, 2, 7):
        expected = np.ones(qd.shape, dtype=bool)
        for i, n in itertools.product(range(3), range(200)):
            later = next((m for m in range(n + 1, 200) if qd[m, i] != 0.0), None)
            if margin and qd[n, i] != 0.0 and later and qd[n, i] * qd[later, i] < 0.0:
                expected[max(n - margin + 1, 0) : later + margin, i] = False
        assert np.array_equal(away_from_reversals(qd, margin), expected)
    with pytest.raises(ValueError, match="reversal margin is -1"):
        away_from_reversals(qd, -1)


def test_patterns_are_what_their_parts_say() -> None:
    recording = swinging()
    patterns = prepare(
        recording,
        smoothing=AveragedSplines((17, 11)),
        torque_alignment="mean",
        thresholds=(0.2, 0.4),
        backlash=True,
        reversal_margin=5,
        trim=20,
    )
    kept = slice(20, -20)
    q, qd, qdd = (
        values[kept]
        for values in AveragedSplines((17, 11)).smooth(recording.time, recording.position)
    )
    torque = align_torque(recording.torque, "mean")[kept]
    assert np.array_equal(patterns.time, recording.time[kept])
    for mine, expected in (
        (patterns.q, q),
        (patterns.qd, qd),
        (patterns.qdd, qdd),
        (patterns.torque, torque),
        (patterns.backlash_mask, ~possible_backlash(qd, qdd, torque)),
        (patterns.friction_mask, friction_mask(qd, [0.2, 0.4]) & away_from_reversals(qd, 5)),
        (patterns.mask, patterns.backlash_mask & patterns.friction_mask),
    ):
        assert np.array_equal(mine, expected)
    assert (patterns.samples, patterns.joints) == (1460, 2)
    # One joint's masks leave the other's pairs alone.
    assert np.any(patterns.mask[:, 0] & ~patterns.mask[:, 1])


def test_defaults() -> None:
    recording = swinging()
    patterns = prepare(recording)
    expected = AveragedSplines(9).smooth(recording.time, recording.position)
    assert np.array_equal(patterns.q, expected[0][9:-9])
    assert np.array_equal(patterns.torque, recording.torque[9:-9])
    assert np.all(patterns.backlash_mask)
    assert np.array_equal(
        patterns.friction_mask, np.abs(patterns.qd) > 0.03 * np.max(np.abs(patterns.qd), axis=0)
    )
    # Half a period of 20 Hz is 12.5 samples of 2 ms.
    filtered = prepare(recording, smoothing=Butterworth(20.0))
    assert filtered.samples == recording.samples - 2 * 13


@pytest.mark.parametrize(
    "smoothing", [AveragedSplines(9), Butterworth(20.0)], ids=["splines", "Butterworth"]
)
def test_torque_is_smoothed_by_the_same_filter(smoothing: AveragedSplines | Butterworth) -> None:
    recording = swinging()
    patterns = prepare(recording, smoothing=smoothing, smooth_torque=True, trim=0)
    expected = smoothing.low_pass(recording.time, recording.torque)
    assert np.array_equal(patterns.torque, expected)


def test_motion_as_recorded() -> None:
    recording = swinging()
    assert recording.velocity is not None and recording.acceleration is not None
    motion = recording.position, recording.velocity, recording.acceleration
    patterns = Preparation(trim=3).patterns(recording, motion)
    assert np.array_equal(patterns.qd, recording.velocity[3:-3])
    assert np.array_equal(patterns.qdd, recording.acceleration[3:-3])


def test_patterns_of_a_stretch_of_time() -> None:
    patterns = prepare(swinging())
    first, second = patterns.between(0.0, 2.0), patterns.between(2.0, np.inf)
    assert first.samples + second.samples == patterns.samples
    assert first.time[-1] < 2.0 <= second.time[0]
    assert np.array_equal(np.concatenate([first.torque, second.torque]), patterns.torque)
    assert isinstance(first, Patterns)


def test_selections_that_leave_nothing() -> None:
    recording = swinging()
    with pytest.raises(
        ValueError,
        match=r"nothing of 1482 samples of 2 joints \(none is above .* at joint 1, 2\); expected",
    ):
        prepare(recording, thresholds=100.0)
    still = Recording(recording.time, np.zeros((1500, 2)), recording.torque)
    with pytest.raises(ValueError, match="none is above the friction threshold at joint 1, 2"):
        prepare(still)
    # A torque that always pushes the way the joints move and speed up.
    parabola = np.stack([recording.time**2, 1.0 - recording.time**2], axis=1)
    pushed = Recording(recording.time, parabola, parabola - [0.0, 100.0] + [1.0, 0.0])
    with pytest.raises(ValueError, match="all may be in backlash at joint 1, 2"):
        prepare(pushed, smoothing=CentralDifferences(), backlash=True, trim=2)
    with pytest.raises(ValueError, match="trim of 750 samples at both ends leaves nothing of 1500"):
        prepare(recording, trim=750)
    with pytest.raises(ValueError, match="trim of -1"):
        prepare(recording, trim=-1)


def test_a_joint_that_is_left_out_is_no_error() -> None:
    recording = swinging()
    patterns = prepare(recording, thresholds=(0.1, 100.0))
    assert np.asarray(patterns.mask).any(axis=0).tolist() == [True, False]
    assert np.asarray(prepare(recording).mask).any(axis=0).all()


def test_resolution_of_encoders(rng: np.random.Generator) -> None:
    recording = swinging()
    np.testing.assert_allclose(encoder_resolution(recording.position), COUNTS, rtol=1e-6)
    # Counts need not start at zero, and angles may be written with few digits.
    np.testing.assert_allclose(encoder_resolution(recording.position + 0.7), COUNTS, rtol=1e-6)
    np.testing.assert_allclose(
        encoder_resolution(np.round(recording.position, 7)), COUNTS, rtol=2e-3
    )
    noisy = rng.standard_normal((500, 1))
    assert encoder_resolution(np.concatenate([noisy, 0 * noisy], axis=1)).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("scatter", [1e-6, 1e-4, 1e-2])
def test_noise_level_against_known_noise(rng: np.random.Generator, scatter: float) -> None:
    time = np.arange(4000) * 0.002
    position = np.sin(3 * time) + scatter * rng.standard_normal(4000)
    assert noise_level(position[:, None])[0] == pytest.approx(scatter, rel=0.1)


@pytest.mark.parametrize("per_period", [40, 100])
def test_noise_level_is_not_that_of_the_motion(rng: np.random.Generator, per_period: int) -> None:
    """A fast motion that is sampled slowly, of which third differences see much."""
    noise = 1e-5 * rng.standard_normal((4000, 1))
    motion = np.sin(2 * np.pi / per_period * np.arange(4000))[:, None]
    assert np.median(np.abs(np.diff(motion + noise, n=3, axis=0))) > 5 * 3e-5
    assert noise_level(motion + noise)[0] == pytest.approx(1e-5, rel=0.1)


@pytest.mark.parametrize("spacing", [2, 5, 12])
def test_left_out_error_is_that_of_the_splines_that_do_not_know(spacing: int) -> None:
    recording = swinging(600)
    smoothing = AveragedSplines(spacing, sections=False)
    errors: list[np.ndarray] = []
    q, _, _ = smoothing.smooth(recording.time, recording.position)
    # Far from the ends, whose fitted values know their neighbours.
    for n in range(250, 350):
        moved = recording.position.copy()
        moved[n] += 1.0
        influence = smoothing.smooth(recording.time, moved)[0][n] - q[n]
        np.testing.assert_allclose(influence, 1.0 / spacing, rtol=1e-9)
        without = (q[n] - influence * recording.position[n]) / (1.0 - influence)
        errors.append(recording.position[n] - without)
    inside = slice(250, 350)
    residual = recording.position[inside] - q[inside]
    np.testing.assert_allclose(np.array(errors), residual * spacing / (spacing - 1.0), atol=1e-12)
    assert np.all(left_out_error(recording.time, recording.position, smoothing) < 2 * COUNTS)


def test_chosen_spacing_follows_the_motion() -> None:
    recording = swinging(2500)
    candidates = (5, 9, 13, 17, 21, 25, 31, 41)
    slow, fast = choose_spacing(recording.time, recording.position, candidates=candidates)
    assert slow > fast
    assert recording.acceleration is not None
    inside = slice(41, -41)
    for joint, selected in enumerate((slow, fast)):
        errors = {
            spacing: np.std(
                AveragedSplines(spacing).smooth(recording.time, recording.position)[2][
                    inside, joint
                ]
                - recording.acceleration[inside, joint]
            )
            for spacing in candidates
        }
        assert errors[selected] < 1.5 * min(errors.values())
    with pytest.raises(ValueError, match="no candidate spacings"):
        choose_spacing(recording.time, recording.position, candidates=())
    with pytest.raises(ValueError, match="spacing is 1; expected 2 samples or more"):
        left_out_error(recording.time, recording.position, AveragedSplines(1))


def test_a_joint_that_stands_still_has_no_direction() -> None:
    """What smoothing leaves of a constant is rounding: no velocity, and no sign of one."""
    time = np.arange(400) * 0.005
    position = np.column_stack([np.sin(time), np.full(400, 0.3), np.zeros(400)])
    for smoothing in (AveragedSplines(9), Butterworth(20.0), SavitzkyGolay(15)):
        patterns = prepare(Recording(time, position, 0 * position), smoothing=smoothing)
        assert not np.any(patterns.qd[:, 1:]) and not np.any(patterns.qdd[:, 1:])
        assert not np.any(patterns.friction_mask[:, 1:])
        assert np.any(patterns.friction_mask[:, 0])

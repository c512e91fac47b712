"""Zero-phase filters, differences, resampling and the parallel filter."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt, sosfreqz

from jaxcslc.recordings import (
    Butterworth,
    CentralDifferences,
    Recording,
    RecordingError,
    decimated_low_pass,
    decimation_for,
    parallel_filter,
    resample,
    uniform_interval,
    zero_phase,
)


INTERVAL = 0.002
# What filters remember of how a record goes on at its ends, and in 10 periods of 12 Hz.
AT_THE_ENDS, FORGOTTEN = 1e-5, 1e-11


def test_differences_by_hand() -> None:
    # Eqns 7.2-1 and 7.2-2.
    position = np.array([0.0, 1.0, 4.0, 2.0, 7.0, 3.0, 5.0])[:, None]
    q, qd, qdd = CentralDifferences().smooth(np.arange(7) * 0.5, position)
    assert np.array_equal(q, position)
    for n in range(1, 6):
        assert qd[n, 0] == pytest.approx(position[n + 1, 0] - position[n - 1, 0])
    for n in range(2, 5):
        expected = position[n + 2, 0] - 2 * position[n, 0] + position[n - 2, 0]
        assert qdd[n, 0] == pytest.approx(expected)


@pytest.mark.parametrize("order", [1, 2, 4, 5])
@pytest.mark.parametrize("frequency", [2.0, 20.0, 35.0])
def test_two_passes_square_the_magnitude_and_leave_the_phase(order: int, frequency: float) -> None:
    time = np.arange(4000) * INTERVAL
    wave = np.sin(2 * np.pi * frequency * time)[:, None]
    filtered = Butterworth(20.0, order).low_pass(time, wave)
    sections = butter(order, 20.0, fs=1 / INTERVAL, output="sos")
    _, response = sosfreqz(sections, worN=[frequency], fs=1 / INTERVAL)
    inside = slice(1000, 3000)
    expected = np.abs(response[0]) ** 2 * wave
    np.testing.assert_allclose(filtered[inside], expected[inside], atol=1e-9)
    if frequency == 20.0:
        np.testing.assert_allclose(filtered[inside], 0.5 * wave[inside], atol=1e-9)


# Coefficients of sections with poles near 1 lose as many digits as the cut-off has periods to the
# square in a sampling rate.
@pytest.mark.parametrize(
    ("cutoff", "rounding"), [(0.5, 1e-10), (2.0, 1e-11), (60.0, 1e-13), (240.0, 1e-13)]
)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 8])
def test_zero_phase_is_scipys(
    order: int, cutoff: float, rounding: float, rng: np.random.Generator
) -> None:
    signal = np.cumsum(rng.standard_normal((1000, 2, 3)), axis=0)
    sections = butter(order, cutoff, fs=1 / INTERVAL, output="sos")
    padding = min(int(np.ceil(5.0 / (cutoff * INTERVAL))), 999)
    expected = sosfiltfilt(sections, signal, axis=0, padlen=padding)
    filtered = zero_phase(signal, INTERVAL, cutoff=cutoff, order=order)
    scale = float(np.max(np.abs(expected)))
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=rounding * scale)


def test_filtering_is_linear_and_reverses_with_time(rng: np.random.Generator) -> None:
    one, other = rng.standard_normal((2, 300, 3))

    def filtered(signal: np.ndarray) -> np.ndarray:
        return zero_phase(signal, INTERVAL, cutoff=15.0)

    np.testing.assert_allclose(
        filtered(2 * one - other), 2 * filtered(one) - filtered(other), atol=1e-12
    )
    inside = slice(100, 200)
    np.testing.assert_allclose(filtered(one[::-1])[::-1][inside], filtered(one)[inside], atol=1e-4)


def test_straight_lines_pass() -> None:
    time = np.arange(500) * INTERVAL
    line = (3.0 - 2.0 * time)[:, None]
    q, qd, qdd = Butterworth(10.0).smooth(time, line)
    np.testing.assert_allclose(q, line, atol=1e-6)
    np.testing.assert_allclose(qd, -2.0, atol=1e-4)
    np.testing.assert_allclose(qdd, 0.0, atol=1e-2)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, np.nan])
def test_cutoffs_that_are_none(cutoff: float) -> None:
    with pytest.raises(ValueError, match=r"cut-off is .* Hz; expected more than 0"):
        Butterworth(cutoff)


def test_filters_that_the_record_does_not_allow() -> None:
    time = np.arange(100) * INTERVAL
    with pytest.raises(ValueError, match="less than half the sampling rate of 500 Hz"):
        Butterworth(250.0).smooth(time, np.zeros((100, 1)))
    with pytest.raises(ValueError, match="at least 1e-06 times and less than half"):
        Butterworth(1e-4).smooth(time, np.zeros((100, 1)))
    with pytest.raises(ValueError, match="filter order is 0"):
        Butterworth(10.0, order=0)
    with pytest.raises(ValueError, match="10 samples; expected 15 or more"):
        Butterworth(10.0).smooth(time[:10], np.zeros((10, 1)))
    time = np.delete(time, 50)
    with pytest.raises(ValueError, match=r"0\.004 s from sample 50 to the next, .*resample"):
        Butterworth(10.0).smooth(time, np.zeros((99, 1)))


def test_uniform_means_to_a_part_in_a_thousand() -> None:
    time = np.arange(100) * INTERVAL
    assert uniform_interval(np.round(time, 6)) == pytest.approx(INTERVAL)
    time[40] += 1e-5
    with pytest.raises(ValueError, match="time is not uniform"):
        uniform_interval(time)
    with pytest.raises(ValueError, match="1 samples; expected two or more"):
        uniform_interval(time[:1])


def test_resampling_a_uniform_recording_returns_it(rng: np.random.Generator) -> None:
    values = rng.standard_normal((4, 50, 2))
    recording = Recording(1.0 + np.arange(50) * 0.01, *values)
    again = resample(recording)
    np.testing.assert_allclose(again.time, recording.time, rtol=0, atol=1e-12)
    for name in ("position", "torque", "velocity", "acceleration"):
        np.testing.assert_allclose(getattr(again, name), getattr(recording, name), atol=1e-9)


def test_resampling_fills_in_without_overshoot(rng: np.random.Generator) -> None:
    time = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 2000))
    position = np.stack([np.sin(4 * time), 1e-3 * np.round(np.cos(time) / 1e-3)], axis=1)
    even = resample(Recording(time, position, position), 1e-3, drop_stale=False)
    assert uniform_interval(even.time) == pytest.approx(1e-3)
    assert even.time[0] == time[0]
    assert time[-1] - 1e-3 < even.time[-1] <= time[-1]
    np.testing.assert_allclose(even.position[:, 0], np.sin(4 * even.time), atol=1e-5)
    # Between two counts of a quantised position lies nothing but what is between them.
    assert np.all(np.diff(even.position[:, 1]) <= 1e-15)


def test_stale_samples_are_no_support() -> None:
    time = np.arange(20) * 0.1
    position = time.copy()
    position[7] = position[6]
    recording = Recording(time, position[:, None], position[:, None])
    assert resample(recording).position[7, 0] == pytest.approx(0.7)
    assert resample(recording, drop_stale=False).position[7, 0] == pytest.approx(0.6)
    with pytest.raises(ValueError, match="resampling interval is 0"):
        resample(recording, 0.0)
    with pytest.raises(RecordingError, match="expected at least 5"):
        resample(recording, 1.0)


@pytest.fixture
def equations(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A smooth regressor of two joints and four coefficients, its torque, a mask, the truth."""
    time = np.arange(2000) * INTERVAL
    regressor = np.sin(
        2 * np.pi * rng.uniform(0.3, 4.0, (1, 2, 4)) * time[:, None, None] + rng.random((2, 4))
    )
    regressor[:, 1, 0] = 0.0
    truth = rng.standard_normal(4)
    mask = np.abs(np.sin(5 * time[:, None] + np.array([0.0, 1.0]))) > 0.3
    return regressor, regressor @ truth, mask, truth


@pytest.mark.parametrize("cutoff", [2.0, 15.0, 100.0])
def test_filtered_equations_are_true(
    equations: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], cutoff: float
) -> None:
    regressor, torque, mask, truth = equations
    # What a masked pair says must not matter.
    torque = np.where(mask, torque, 1e3)
    for joint in range(2):
        filtered = parallel_filter(
            regressor[:, joint].T,
            torque[:, joint],
            mask[:, joint],
            interval=INTERVAL,
            cutoff=cutoff,
        )
        assert filtered.regressor.shape == (filtered.torque.size, 4)
        np.testing.assert_allclose(filtered.regressor @ truth, filtered.torque, atol=1e-10)


def test_every_column_goes_through_the_same_filter(
    equations: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    regressor, torque, _, _ = equations
    all_count, every = np.ones(2000, dtype=bool), np.arange(2000)
    for joint in range(2):
        columns, right = regressor[:, joint].T, torque[:, joint]
        filtered = parallel_filter(
            columns, right, all_count, interval=INTERVAL, cutoff=12.0, kept=every
        )
        assert filtered.sample.tolist() == every.tolist()
        expected = zero_phase(regressor[:, joint], INTERVAL, cutoff=12.0)
        assert np.ptp(filtered.regressor - expected) < AT_THE_ENDS
        inside = slice(400, -400)
        np.testing.assert_allclose(filtered.regressor[inside], expected[inside], atol=FORGOTTEN)


def test_equations_far_from_what_counts_are_dropped(
    equations: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    regressor, torque, _, _ = equations
    mask = np.zeros(2000, dtype=bool)
    mask[500:900] = True
    joint = regressor[:, 0].T, torque[:, 0]
    filtered = parallel_filter(*joint, mask, interval=INTERVAL, cutoff=10.0)
    assert np.all((filtered.sample > 480) & (filtered.sample < 920))
    # The share of each filter that lies on samples that count is that of a column of ones.
    (shares,) = decimated_low_pass(1.0 * mask[None], filtered.sample, INTERVAL, cutoff=10.0)
    assert np.all(shares >= 0.05 - 1e-12)
    assert filtered.torque.size == pytest.approx(400 / 25, abs=2)
    nothing = parallel_filter(*joint, np.zeros_like(mask), interval=INTERVAL, cutoff=10.0)
    assert nothing.regressor.shape == (0, 4)
    assert nothing.torque.shape == nothing.sample.shape == (0,)


def test_decimated_noise_is_as_good_as_white(rng: np.random.Generator) -> None:
    samples = 400_000
    filtered = parallel_filter(
        np.zeros((1, samples)),
        rng.standard_normal(samples),
        np.ones(samples, dtype=bool),
        interval=INTERVAL,
        cutoff=20.0,
    )
    noise = filtered.torque
    assert noise.size == -(-samples // decimation_for(20.0, INTERVAL))
    correlation = np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2)
    assert abs(correlation) < 0.2


@pytest.mark.parametrize("cutoff", [5.0, 0.3, 2e-4])
def test_decimation_takes_samples_of_the_filtered_signal(
    cutoff: float, rng: np.random.Generator
) -> None:
    # The last remembers ten million samples.
    signal, kept = rng.normal(size=(2, 2000)), np.arange(5, 2000, 20)
    filtered = decimated_low_pass(signal, kept, 0.005, cutoff=cutoff)
    expected = zero_phase(signal.T, 0.005, cutoff=cutoff).T[:, kept]
    np.testing.assert_allclose(filtered, expected, atol=1e-5)


def test_decimation_follows_from_the_cutoff() -> None:
    assert decimation_for(20.0, 0.002) == 12
    assert decimation_for(25.0, 0.002) == 10
    assert decimation_for(249.0, 0.002) == 1


def test_a_wrong_time_stamp_is_refused_before_anything_is_filled_in() -> None:
    time = np.arange(100) * 0.002
    time[1:] += 1.7e9
    position = np.sin(np.arange(100.0))[:, None]
    with pytest.raises(RecordingError, match=r"no sample between 0 s and 1\.7e\+09 s; .*between"):
        resample(Recording(time, position, position))

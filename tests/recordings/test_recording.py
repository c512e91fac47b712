"""What a recording is, and what it may not be."""

from typing import Any

import numpy as np
import pytest

from jaxcslc.recordings import (
    Recording,
    RecordingError,
    fresh_rows,
    restore_clock,
    stale_rows,
    without_repetition,
    without_stale_rows,
)


def arrays(samples: int = 8, joints: int = 2) -> dict[str, Any]:
    time = np.arange(samples) * 0.002
    grid = np.arange(samples * joints, dtype=float).reshape(samples, joints)
    return {"time": time, "position": grid, "torque": grid + 0.5}


def test_arrays_become_float64() -> None:
    recording = Recording(
        time=[0, 1, 2, 3, 4],
        position=np.arange(5, dtype=np.float32)[:, None],
        torque=[[1], [2], [3], [4], [5]],
    )
    assert recording.time.dtype == recording.position.dtype == recording.torque.dtype == np.float64
    assert (recording.samples, recording.joints) == (5, 1)
    assert recording.velocity is None
    assert recording.acceleration is None


def test_recording_keeps_its_own_copy() -> None:
    parts = arrays()
    recording = Recording(**parts)
    parts["position"][0, 0] = 99.0
    assert recording.position[0, 0] == 0.0


def test_rows_take_every_quantity() -> None:
    parts = arrays()
    recording = Recording(**parts, velocity=parts["position"], acceleration=-parts["torque"])
    part = recording.rows(slice(1, 7))
    assert part.time.tolist() == parts["time"][1:7].tolist()
    assert part.velocity is not None and part.acceleration is not None
    assert np.array_equal(part.acceleration, -parts["torque"][1:7])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(
            {"torque": np.zeros((8, 3))},
            r"torque has shape \(8, 3\); expected \(8, 2\): one row for each of the 8 times",
            id="columns",
        ),
        pytest.param(
            {"velocity": np.zeros((7, 2))}, r"velocity has shape \(7, 2\); expected", id="rows"
        ),
        pytest.param({"position": np.zeros(8)}, r"position has shape \(8,\)", id="dimensions"),
        pytest.param(
            {"position": np.zeros((8, 0)), "torque": np.zeros((8, 0))}, "no columns", id="jointless"
        ),
        pytest.param({"position": np.array([["a", "b"]])}, "position is not an array", id="text"),
    ],
)
def test_shapes_that_disagree(change: dict[str, Any], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        Recording(**{**arrays(), **change})


def test_too_few_samples() -> None:
    with pytest.raises(RecordingError, match="4 samples; expected at least 5"):
        Recording(**arrays(samples=4))


def test_values_that_no_joint_shows() -> None:
    """Their squares would overflow, and a fit's error be NaN or zero."""
    position = np.ones((8, 2))
    position[2, 1] = -1e160
    message = r"sample 3, position_2: -1e\+160 where a number up to 1e\+30 was expected"
    with pytest.raises(RecordingError, match=message):
        Recording(**dict[str, Any](arrays(), position=position))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("quantity", ["time", "position", "torque", "velocity", "acceleration"])
def test_values_that_are_not_finite(quantity: str, value: float) -> None:
    parts = {**arrays(), "velocity": np.ones((8, 2)), "acceleration": np.ones((8, 2))}
    if quantity == "time":
        parts["time"][3] = value
        column = "time"
    else:
        parts[quantity][3, 1] = value
        column = f"{quantity}_2"
    with pytest.raises(RecordingError, match=f"sample 4, {column}: {value} where a finite"):
        Recording(**dict[str, Any](parts))


def test_the_earliest_fault_is_named() -> None:
    parts = arrays()
    parts["position"][6, 0] = np.nan
    parts["torque"][2, 1] = np.nan
    parts["time"][4] = 0.0
    with pytest.raises(RecordingError, match=r"sample 3, torque_2"):
        Recording(**parts)
    parts["torque"][2, 1] = 0.0
    with pytest.raises(RecordingError, match=r"sample 5, time: 0\.0 s follows 0\.006 s"):
        Recording(**parts)


def test_repeated_rows_are_named_as_such() -> None:
    parts = arrays()
    for values in parts.values():
        values[5] = values[4]
    with pytest.raises(RecordingError, match="sample 6: repeats the row before it"):
        Recording(**parts)
    parts["torque"][5, 0] += 1.0
    with pytest.raises(RecordingError, match=r"sample 6, time: .* increase strictly"):
        Recording(**parts)


@pytest.mark.parametrize("start", range(3))
def test_fresh_rows_are_those_with_new_positions(start: int) -> None:
    position = np.repeat(np.arange(12.0), 3)[start:, None]
    torque = np.arange(len(position), dtype=float)[:, None]  # new in every row
    recording = Recording(np.arange(len(position)) * 0.01, position, torque)
    rows = fresh_rows(recording, 3)
    first = np.flatnonzero(np.diff(position[:, 0]))[0] + 1
    np.testing.assert_array_equal(rows.torque[:, 0], np.arange(first % 3, len(position), 3))
    with pytest.raises(ValueError, match="every is 0; expected 1 to"):
        fresh_rows(recording, 0)
    with pytest.raises(ValueError, match="expected 1 to"):  # refused before any row is looked at
        fresh_rows(recording, 10**26)


def test_between_keeps_both_ends() -> None:
    recording = Recording(**arrays(samples=9))
    assert recording.between(0.004, 0.012).time.tolist() == recording.time[2:7].tolist()
    with pytest.raises(RecordingError, match="3 samples; expected at least"):
        recording.between(0.0, 0.004)


def test_stale_rows_repeat_every_value_but_the_time() -> None:
    parts = arrays()
    parts["position"][3] = parts["position"][2]
    assert not stale_rows(Recording(**parts)).any()
    parts["torque"][3] = parts["torque"][2]
    recording = Recording(**parts)
    assert np.flatnonzero(stale_rows(recording)).tolist() == [3]
    assert without_stale_rows(recording).time.tolist() == np.delete(parts["time"], 3).tolist()


def test_the_clock_of_the_source_is_restored(rng: np.random.Generator) -> None:
    # A source at 1 kHz of which every tenth message is lost; delays of up to 0.8 ms, and an arm
    # that also rests for a while, where only the stamps can tell the time.
    ticks = np.flatnonzero(rng.random(8000) > 0.1)
    true = ticks * 1e-3
    # It sets off with an acceleration of 4 rad/s² at once, after 2 s.
    late = np.maximum(true - 2.0, 0.0)
    swing = np.where(late < 0.5, late**2, late - 0.25)
    position = np.stack([np.sin(2.0 * swing), np.sin(1.3 * swing), np.cos(swing)], axis=1)
    position += 1e-6 * rng.standard_normal(position.shape)
    stamped = Recording(np.round(true + rng.uniform(0.0, 0.8e-3, true.size), 4), position, position)
    restored = restore_clock(stamped, period=1e-3)
    assert restored.samples == true.size
    moving = true[1:] > 2.1
    periods = np.round(np.diff(restored.time) / 1e-3)
    assert np.array_equal(periods[moving], np.diff(ticks)[moving])
    # In the mean of the delays' range, give or take the period that a rest may be off by.
    assert np.max(np.abs(restored.time - true)) < 1.5e-3


def test_a_clock_that_is_not_there(rng: np.random.Generator) -> None:
    time = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 3000))
    position = np.stack([np.sin(3 * time), np.cos(2 * time)], axis=1)
    with pytest.raises(RecordingError, match=r"(no|too noisy to show a) clock of 0\.001 s"):
        restore_clock(Recording(time, position, position), period=1e-3)
    still = 1e-4 * rng.standard_normal((3000, 2))
    with pytest.raises(RecordingError, match="too slow or too noisy to show a clock"):
        restore_clock(Recording(np.arange(3000) * 1e-3, still, still), period=1e-3)
    with pytest.raises(RecordingError, match="strays from the time stamps"):
        even = np.arange(3000) * 1e-3
        position = np.stack([np.sin(3 * even), np.cos(2 * even)], axis=1)
        restore_clock(Recording(even, position, position), period=0.7e-3)
    with pytest.raises(ValueError, match="period is 0"):
        restore_clock(Recording(time, position, position), period=0.0)
    with pytest.raises(ValueError, match=r"period is 1e-300 s; expected more than 3e-09 s"):
        restore_clock(Recording(time, position, position), period=1e-300)


def sampled(values: np.ndarray) -> Recording:
    return Recording(0.01 * np.arange(len(values)), values, values**2)


def test_stretches_that_repeat_are_omitted_and_time_closes(rng: np.random.Generator) -> None:
    first, second = rng.standard_normal((2, 100, 2))
    again = without_repetition(sampled(np.concatenate([first, first, second, first[30:60]])))
    np.testing.assert_array_equal(again.position, np.concatenate([first, second]))
    np.testing.assert_allclose(again.time, 0.01 * np.arange(200), atol=1e-12)
    assert again.notes == (
        "130 of 330 rows repeat earlier ones, all values and in the same order: omitted",
    )


def test_a_repeated_log_is_omitted_whole_with_its_dwells(rng: np.random.Generator) -> None:
    """Rows at rest are all alike, and those of the second time belong to its motion."""
    motion = rng.standard_normal((60, 2))
    dwell = np.zeros((40, 2))
    once = np.concatenate([motion[:30], dwell, motion[30:], dwell + 1.0])
    again = without_repetition(sampled(np.concatenate([once, once])))
    np.testing.assert_array_equal(again.position, once)


@pytest.mark.parametrize("kind", ["new noise", "single rows", "at rest", "one column differs"])
def test_what_only_looks_like_repetition_stays(kind: str, rng: np.random.Generator) -> None:
    second = np.sin(np.arange(100.0))[:, None] * [1.0, 2.0]
    values = np.concatenate([second, second])
    if kind == "new noise":
        values += 1e-12 * rng.standard_normal(values.shape)
    elif kind == "single rows":  # held by a slow source, or equal by chance
        values = np.repeat(rng.integers(3, size=(100, 2)).astype(float), 10, axis=0)
    elif kind == "at rest":
        values = np.concatenate([second, np.zeros((100, 2)), second + 1.0, np.zeros((100, 2))])
    else:
        values[100:, 1] += 1.0
    recording = sampled(values)
    assert without_repetition(recording) is recording

"""What a recording of servos is, and what it may not be."""

from typing import Any

import numpy as np
import pytest

from jaxcslc.recordings import RecordingError
from jaxcslc.servo import ServoRecording


def arrays(samples: int = 8, joints: int = 2) -> dict[str, Any]:
    grid = np.arange(samples * joints, dtype=float).reshape(samples, joints)
    return {"time": np.arange(samples) * 0.02, "position": grid, "command": grid + 0.5}


def test_arrays_become_float64_copies() -> None:
    parts = arrays()
    recording = ServoRecording(
        parts["time"].tolist(), parts["position"].astype(np.float32), parts["command"]
    )
    parts["command"][0, 0] = 99.0
    assert recording.position.dtype == recording.command.dtype == np.float64
    assert recording.command[0, 0] == 0.5
    assert recording.velocity is None
    assert recording.current is None


def test_rows_take_every_quantity() -> None:
    parts = arrays()
    extra = {"velocity": -parts["position"], "current": 2.0 * parts["position"]}
    whole = ServoRecording(**parts, **extra, joint_names=("a", "b"), notes=("read so",))
    part = whole.rows(slice(1, 7))
    for name, values in {**parts, **extra}.items():
        np.testing.assert_array_equal(getattr(part, name), values[1:7])
    assert (part.joint_names, part.notes) == (("a", "b"), ("read so",))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(
            {"command": np.zeros((8, 3))},
            r"command has shape \(8, 3\); expected \(8, 2\): one row for each of the 8 times",
            id="columns",
        ),
        pytest.param(
            {"current": np.zeros((7, 2))}, r"current has shape \(7, 2\); expected", id="rows"
        ),
        pytest.param({"joint_names": ["a"]}, "1 names of joints; expected 2", id="names"),
        pytest.param(
            {"command": np.full((8, 2), np.nan)},
            "sample 1, command_1: nan where a finite number",
            id="not finite",
        ),
        pytest.param(
            {"time": [0.0, 0.1, 0.1, 0.3, 0.4, 0.5, 0.6, 0.7]},
            r"sample 3, time: 0.1 s follows 0.1 s",
            id="time",
        ),
        pytest.param({"time": np.zeros((8, 1))}, r"time has shape \(8, 1\)", id="axes"),
    ],
)
def test_faults_are_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        ServoRecording(**{**arrays(), **change})


def test_five_samples_are_needed() -> None:
    with pytest.raises(RecordingError, match="4 samples; expected at least 5"):
        ServoRecording(**arrays(samples=4))
    with pytest.raises(RecordingError, match="no columns"):
        ServoRecording(**arrays(joints=0))

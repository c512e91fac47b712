"""The benchmark of long recordings: its motion and its torques."""

from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.recordings import load_recording
from scripts.benchmarks import long_recording


def test_positions_are_within_limits_and_derivatives_theirs(rng: np.random.Generator) -> None:
    t = np.arange(2000) / 500.0
    q, qd, qdd = long_recording.motion(rng, t)
    for values, derivative in ((q, qd), (qd, qdd)):
        differences = np.gradient(values, t, axis=0)[1:-1]
        np.testing.assert_allclose(differences, derivative[1:-1], atol=1e-4)
    low, high = np.array([joint.limits[:2] for joint in long_recording.GEARED]).T
    assert np.all((q > low) & (q < high))


def test_recording_is_one_of_its_robot(tmp_path: Path) -> None:
    long_recording.write_recording(tmp_path, 1000)
    robot = jc.load_robot(tmp_path / "arm.urdf")
    recording = load_recording(tmp_path / "log.npz", joints=robot.joint_names)
    assert (recording.samples, recording.joints) == (1000, 7)
    assert np.median(np.diff(recording.time)) == pytest.approx(0.002)


def test_wrong_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        long_recording.main(["--samples", "10"])
    assert "--samples: expected 1000 or more, got 10" in capsys.readouterr().err

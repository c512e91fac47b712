"""Errors of a report on servos, against their definitions and Pinocchio's kinematics."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pinocchio
import pytest

import jaxcslc as jc
from jaxcslc.servo import (
    ConfoundedParameters,
    ServoDrive,
    ServoFit,
    ServoParameter,
    ServoRecording,
    ServoReport,
    servo_report,
)


DRIVES = (
    ServoDrive(8.0, 0.4, armature=0.01, offset=0.2, encoder_step=0.002),
    ServoDrive(6.0, 0.3, armature=0.01, offset=-0.1),
)
LATE = 3  # samples
# Products of numbers about 1.
ROUNDING = 1e-9


@pytest.fixture
def report(arm: jc.Manipulator) -> ServoReport:
    """Positions follow the commands three samples late, on a held-out motion of 60 samples."""
    time = np.arange(60) * 0.02
    commands = [
        np.stack([np.sin(3 * time + phase), 0.5 * np.cos(4 * time)], axis=1) for phase in (0.0, 1.0)
    ]
    recordings = [
        ServoRecording(time, x[np.maximum(np.arange(60) - LATE, 0)], x, notes=("a note",))
        for x in commands
    ]
    parameters = (
        ServoParameter(0, "gain", 8.0, 0.1, 7.8, 8.2, "N m/rad"),
        ServoParameter(1, "gain", 6.0, math.inf, -math.inf, math.inf, "N m/rad"),
    )
    pairs = tuple(
        ConfoundedParameters(j, ("delay", "damping"), "slow", "move faster") for j in (0, 1)
    )
    fit = ServoFit(arm, DRIVES, parameters, np.zeros((2, 2)), "torque", pairs)
    return servo_report(fit, {"first": recordings[0]}, {"second": recordings[1]})


def test_the_command_is_compared_at_its_best_delay(report: ServoReport) -> None:
    assert report.lag == pytest.approx(LATE * 0.02)
    np.testing.assert_allclose(report.errors(report.compared()["command"]), 0.0, atol=ROUNDING)


def test_errors_are_root_mean_squares(report: ServoReport) -> None:
    """In mrad; in encoder steps where the step is known; and over all joints."""
    measured = report.held_out["second"].position
    expected = np.sqrt(np.mean((report.simulated["second"] - measured) ** 2, axis=0))
    first, second, together = report.error_rows()
    assert (first["joint"], second["joint"], together["joint"]) == ("shoulder", "elbow", "all")
    assert first["simulation"] == pytest.approx(1e3 * expected[0])
    assert first["ticks"] == pytest.approx(expected[0] / 0.002)
    assert math.isnan(second["ticks"])
    assert together["simulation"] == pytest.approx(1e3 * np.sqrt(np.mean(expected**2)))


def test_the_error_at_the_tip(report: ServoReport, arm_file: Path) -> None:
    """Joint angles are readings minus offsets; the tip is the last body's centre of mass."""
    model = pinocchio.buildModelFromUrdf(str(arm_file))
    data = model.createData()

    def tip(reading: np.ndarray) -> np.ndarray:
        pinocchio.forwardKinematics(model, data, reading - [d.offset for d in DRIVES])
        return data.oMi[2].act(model.inertias[2].lever)

    recording = report.held_out["second"]
    pairs = zip(report.simulated["second"], recording.position, strict=True)
    squares = [np.sum((tip(a) - tip(b)) ** 2) for a, b in pairs]
    assert report.tip_error(report.simulated) == pytest.approx(np.sqrt(np.mean(squares)))


def test_what_is_not_determined_has_no_number(report: ServoReport) -> None:
    assert [(row["joint"], row["parameter"]) for row in report.parameter_rows()] == [
        ("shoulder", "gain")
    ]
    text = str(report)
    assert "not determined: elbow: gain" in text
    assert "6" not in text.split("drives:")[1].split("not determined")[0]
    assert text.count("delay and damping") == 1
    assert "confounded, shoulder, elbow: delay and damping (slow); move faster" in text
    assert text.count("note: a note") == 1


def test_robots_of_other_files_have_no_mujoco_model(report: ServoReport, tmp_path: Path) -> None:
    robot = dataclasses.replace(report.fit.robot, source=None)
    fit = dataclasses.replace(report.fit, robot=robot)
    alone = servo_report(fit, report.training)
    assert alone.model is None and not alone.replayed
    assert "the fitted motions" in alone.headline
    names = {path.name for path in alone.save(tmp_path / "out")}
    assert names == {"index.html", "servo.json", "parameters.csv", "arm.c", "arm.h"}

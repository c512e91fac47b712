"""The study of checks, with two recordings of an arm whose torques Pinocchio computes."""

import csv
from pathlib import Path

import numpy as np
import pytest

from scripts.studies.checks import study
from scripts.studies.checks.recordings import Conditions, record


def test_table_and_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--arms", "six", "--kinds", "gap", "sign", "--seeds", "1", "--clean", "0"]
    assert study.main([*options, "--lags", "1", "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "findings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["kind"], row["first"], row["right"]) for row in rows] == [
        ("gap", "gap", "True"),
        ("sign", "sign", "True"),
    ]
    printed = capsys.readouterr().out
    assert "2 of 2" in printed and "1 of 1" in printed


def test_torques_are_those_of_the_motion() -> None:
    """Work of the torques is the change of energy and what friction takes: never less than that."""
    recording = record("six", Conditions(duration=8.0, rate=250.0, noise=0.0), 3)
    velocity = np.gradient(recording.position, recording.time, axis=0)
    power = np.sum(recording.torque * velocity, axis=1)
    assert np.trapezoid(power, recording.time) > 0
    assert recording.samples == 2000 and recording.joints == 6


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("--seeds", "0", "expected 1 or more"), ("--kinds", "dust", "expected some of units, sign")],
)
def test_wrong_options_end_with_one_line(
    option: str, value: str, message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(SystemExit):
        study.main([option, value, "-o", str(tmp_path)])
    assert message in capsys.readouterr().err

"""The study of coverage: what it counts, and a tiny run."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from scripts.studies.coverage import study


def test_counts_what_was_covered() -> None:
    covered = np.array([[True, True], [True, False]])
    estimate = np.array([[1.0, 2.0], [3.0, 2.5]])
    coverage = study.Coverage("torque noise", "correlated", covered, np.ones((2, 2)), estimate)
    assert coverage.row()[2:5] == ["75.0 %", "75.0 %", "50.0 to 100.0 %"]
    rows = coverage.rows(("a", "b"), np.array([2.0, 2.0]))
    assert [row["coverage"] for row in rows] == [1.0, 0.5]
    assert rows[0]["mean error / standard deviation"] == 0.0


def test_a_tiny_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert study.main(["--recordings", "3", "-o", str(tmp_path / "study")]) == 0
    printed = capsys.readouterr().out
    assert re.search("encoders +correlated", printed)
    with (tmp_path / "study" / "coverage.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 43
    # Three recordings of 43 coefficients; intervals that never cover would be wrong by a factor.
    assert np.mean([float(row["coverage"]) for row in rows]) > 0.8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--recordings", "1"], "--recordings is 1; expected 2 or more"),
        (["--level", "1"], "--level is 1.0; expected more than 0 and less than 1"),
    ],
)
def test_wrong_options(
    capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    with pytest.raises(SystemExit):
        study.main(arguments)
    assert message in capsys.readouterr().err

"""Trainings of many recordings side by side: rows of the study, next to the direct solve."""

import csv
from pathlib import Path

import pytest

from scripts.studies.training import cslc


def test_a_short_training(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert cslc.main(["--quick", "-o", str(folder)]) == 0
    with (folder / "training.csv").open() as file:
        rows = {row["coefficients"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"backpropagation", cslc.SOLVED, "Ar+LS", "Ar+Rg", "true"}
    error = {name: float(row["training ε [N m]"]) for name, row in rows.items()}
    # The direct solve minimises squares, not ε itself: nothing does much better.
    # Joints sweep less in a short recording, and training ends sooner.
    assert error[cslc.SOLVED] < error["backpropagation"] < 2.0 * error[cslc.SOLVED]
    assert error["backpropagation"] < 0.5 * min(error["Ar+LS"], error["Ar+Rg"])
    assert float(rows[cslc.SOLVED]["over the direct solve"]) == 1.0
    assert float(rows["backpropagation"]["epochs of backpropagation"]) > 1000
    # A second run computes no row again.
    capsys.readouterr()
    assert cslc.main(["--quick", "-o", str(folder)]) == 0
    assert "backpropagation" in capsys.readouterr().out


def test_too_few_samples_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cslc.main(["--samples", "10"])
    assert "--samples is 10; expected 500 or more" in capsys.readouterr().err.splitlines()[-1]

"""The schedule of 7.5 on a short recording: methods and their errors."""

import csv
from pathlib import Path

import pytest

from scripts.studies.training import cslc


def test_a_short_training(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--machines", "A", "--samples", "800", "--epochs", "150", "--least", "1e-3"]
    assert cslc.main([*short, "--without-velocity", "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "training.csv").open() as file:
        published, direct, trained = csv.DictReader(file)
    assert [row["method"] for row in (published, direct)] == ["Ar+LS", "direct solve"]
    # The direct solve minimises squares, not ε itself: nothing does much better.
    errors = [float(row["training ε [N m]"]) for row in (published, direct, trained)]
    assert errors[1] < errors[0]
    assert errors[1] < errors[2] < 10.0
    epochs = [int(number) for number in trained["epochs"].split(" + ")]
    assert sum(epochs) <= 150
    assert float(direct["over direct"]) == 1.0
    assert trained["method"] in capsys.readouterr().out


def test_too_few_samples_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cslc.main(["--samples", "10"])
    assert "--samples is 10; expected 500 or more" in capsys.readouterr().err.splitlines()[-1]

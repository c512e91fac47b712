"""The schedule of 7.5 on a short recording: who found what, and how far it got."""

import csv
import importlib
import sys
from pathlib import Path

import pytest


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["cslc_training.py", *arguments])
    importlib.import_module("scripts.studies.training.cslc").main()


def test_a_short_training(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(
        monkeypatch,
        *("--machines", "A", "--samples", "800", "--epochs", "150", "--least", "1e-3"),
        *("--without-velocity", "-o", str(tmp_path / "out")),
    )
    with (tmp_path / "out" / "training.csv").open() as file:
        published, direct, trained = csv.DictReader(file)
    assert [row["found by"] for row in (published, direct)] == ["Ar+LS", "direct solve"]
    # The direct solve minimises squares, not ε itself: nothing does much better.
    errors = [float(row["training ε [N m]"]) for row in (published, direct, trained)]
    assert errors[1] < errors[0]
    assert errors[1] < errors[2] < 10.0
    epochs = [int(number) for number in trained["epochs"].split(" + ")]
    assert sum(epochs) <= 150
    assert float(direct["over direct"]) == 1.0
    assert trained["found by"] in capsys.readouterr().out


def test_too_few_samples_are_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run(monkeypatch, "--samples", "10")
    assert "--samples must be at least 500" in capsys.readouterr().err.splitlines()[-1]

"""The study of recordings that determine little, at toy size."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scripts.studies.degenerate import study


def test_table_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--arms", "two joints", "--kinds", "all joints move", "30 samples", "--seeds", "1"]
    options += ["-o", str(tmp_path)]
    assert study.main(options) == 0
    with (tmp_path / "degenerate.csv").open() as file:
        moving, short = csv.DictReader(file)
    assert float(moving["largest ratio"]) < 1.1 and moving["refused"] == "0 of 1"
    assert short["refused"] == "1 of 1"
    capsys.readouterr()
    nothing: Any = None
    monkeypatch.setattr(study, "specimen", nothing)  # every row is there
    assert study.main(options) == 0
    assert "30 samples" in capsys.readouterr().out


@pytest.mark.parametrize("kind", list(study.KINDS))
def test_recordings_of_each_kind(kind: str) -> None:
    some = study.specimen("two joints", 0)
    recordings = study.KINDS[kind](some, np.random.default_rng(0))
    assert all(recording.joints == 2 for recording in recordings)
    assert min(recording.samples for recording in recordings) == (
        30 if kind == "30 samples" else 100 if kind == "half a second" else 2000
    )


def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--kinds", "dust", "-o", str(tmp_path)])
    assert "no kind is called 'dust'" in capsys.readouterr().err

"""Friction alone against everything and nothing, from seconds of a cleaned PUMA 560."""

import csv
from pathlib import Path

import numpy as np
import pytest

import sim
from scripts.studies.reidentification import study


def test_a_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--seeds", "1", "--lengths", "0.2", "1", "--samples", "1500", "-o", str(tmp_path)]
    assert study.main(options) == 0
    assert "1 seeds: median" in capsys.readouterr().out
    with (tmp_path / "seeds.csv").open() as file:
        rows = list(csv.DictReader(file))
    epsilon = {(row["length"], row["method"]): float(row["epsilon"] or "nan") for row in rows}
    assert len(rows) == 6
    assert epsilon["1.0", "friction alone"] < 0.1 * epsilon["1.0", "as before"]
    assert epsilon["1.0", "friction alone"] < 0.1 * epsilon["1.0", "everything"]
    assert (tmp_path / "reidentification.png").read_bytes()[:4] == b"\x89PNG"

    kept = (tmp_path / "rows.jsonl").read_text()
    (tmp_path / "rows.jsonl").write_text(kept + '{"seed": 1, "half')
    monkeypatch.setattr(study, "draw", lambda *_: None)  # of all rows, as above
    assert study.main(options) == 0  # from the finished rows, at once
    assert (tmp_path / "rows.jsonl").read_text().startswith(kept)


def test_friction_falls_in_every_joint() -> None:
    machine = sim.disturbed(sim.puma560(), "static friction")
    after = study.cleaned(machine, 3, (0.2, 0.5))
    for name in ("viscous", "dry", "static"):
        ratio = np.array(getattr(after, name)) / np.array(getattr(machine, name))
        assert np.all((ratio >= 0.5) & (ratio <= 0.8)) and np.ptp(ratio) > 0.01


def test_bad_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = [["--seeds", "0"], ["--lengths", "0.1"], ["--fall", "0.5", "0.2"]]
    (tmp_path / "rows.jsonl").write_text("no row\n")
    for option in (*wrong, ["-o", str(tmp_path)]):
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err

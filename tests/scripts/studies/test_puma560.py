"""The thesis's experiment on a shorter recording: everything is written, and is what it says."""

import csv
from pathlib import Path

import numpy as np
import pytest

from scripts.studies.puma560 import experiment
from scripts.studies.puma560.figures import clean_turn


def test_every_table_and_figure_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "experiment"
    assert experiment.main(["--quick", "-o", str(folder)]) == 0
    assert "wrote every table and figure" in capsys.readouterr().out
    page = (folder / "index.html").read_text(encoding="utf-8")
    for number in ("2.5-1", "2.5-3", "7.2-1", "7.2-2", "7.3-1", "7.3-2", "7.4-2", "7.6-1", "7.6-4"):
        assert (folder / f"figure_{number}.png").stat().st_size > 5000
        assert f"figure_{number}.png" in page
    for machine in ("a", "b"):
        for table in ("errors", "coefficients", "thresholds", "backlash_mask"):
            assert f"{table}_{machine}.csv" in page and (folder / f"{table}_{machine}.csv").exists()
        with (folder / f"errors_{machine}.csv").open(encoding="utf-8") as file:
            rows = {row[""]: row for row in csv.DictReader(file)}
        mean = {name: float(rows["mean ε"][name]) for name in ("Ar+LS", "Ar+Rg", "CSLC", "true")}
        assert mean["CSLC"] < mean["Ar+LS"] and mean["true"] < mean["Ar+LS"]
        assert np.isfinite(list(mean.values())).all()


def test_a_clean_turn_does_not_stick() -> None:
    time = np.linspace(0.0, 1.0, 1000)
    velocity = np.where(time < 0.5, np.sin(6 * np.pi * time), 3 * np.sin(6 * np.pi * time))
    turn = clean_turn(velocity)
    assert time[turn] > 0.5 and velocity[turn] * velocity[turn + 1] <= 0

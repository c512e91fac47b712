"""Methods to identify static friction, on a recording that is too short for any of them."""

import csv
from pathlib import Path

import numpy as np
import pytest

from scripts.studies.static_friction import study


def test_rows_of_two_methods(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seeds", "1", "--samples", "1200", "--time-step", "5e-4", "-o", str(tmp_path)]
    assert study.main([*options, "--methods", "masked", "moving pairs"]) == 0
    assert "1 seeds, exact positions" in capsys.readouterr().out
    with (tmp_path / "seeds.csv").open() as file:
        masked, moving = csv.DictReader(file)
    assert masked["method"] == "masked" and masked["slopes covered"] == ""
    # The floor is what the true coefficients leave without static friction.
    assert 0.02 < float(moving["floor"]) < 0.035
    # Slopes that so short a recording determines are near the truth; other joints lose the term.
    slopes = np.array(
        [float(moving[f"slope {joint} over truth"] or "nan") for joint in range(1, 7)]
    )
    errors = np.array([float(moving[f"slope {joint} error"] or "nan") for joint in range(1, 7)])
    determined = np.isfinite(errors)
    assert determined.sum() >= 3
    assert np.all(np.abs(np.log(slopes[determined])) < np.log(1.6))


def test_bad_options(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--seeds", "0"], ["--methods", "guess"], ["--time-step", "0"]):
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err

"""The study of possible bodies: Pinocchio's torque of an exported URDF, and what it costs."""

import csv
from pathlib import Path

import numpy as np
import pytest

from scripts.studies.possible_bodies import study


def test_exported_bodies_predict_a_new_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motor inertias beside the URDF cost nothing; without them bodies cannot make up for them."""
    short = study.Conditions(duration=4.0, rate=125.0, speed=0.5)
    monkeypatch.setitem(study.MOTIONS, "wide", short)
    monkeypatch.setattr(study, "NEW", short)
    options = ["--motions", "wide", "--seeds", "1", "-o", str(tmp_path / "out")]
    assert study.main(options) == 0
    with (tmp_path / "out" / "errors.csv").open() as file:
        (row,) = csv.DictReader(file)
    errors = {
        name: np.array([float(row[f"{name}_{joint}"]) for joint in range(1, 8)])
        for name in study.PREDICTIONS
    }
    np.testing.assert_allclose(errors["urdf_and_motors"], errors["possible"], rtol=1e-3)
    torque = np.array([float(row[f"torque_{joint}"]) for joint in range(1, 8)])
    size = {name: np.linalg.norm(values / torque) for name, values in errors.items()}
    assert size["urdf_and_motors"] < 1.2 * size["free"] < 0.2 * size["urdf_alone"]
    assert "geometric mean" in capsys.readouterr().out

"""The motor linearity script: what it says and what it leaves behind."""

import csv
import importlib
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return importlib.import_module("scripts.studies.motor.linearity")


def test_tables_and_pictures_of_both_machines(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    quick = ["--masses", "0", "1.5", "4.5", "--swings", "1", "--period", "1"]
    assert script.main(["-o", str(folder), *quick]) == 0
    said = capsys.readouterr().out
    assert "limit of linearity of joint 2: none" in said
    assert "limit of linearity of joint 2: 70 N m" in said
    above = {}
    for name in ("linear", "limited"):
        with (folder / f"{name}.csv").open() as file:
            found = list(csv.DictReader(file))
        assert [float(row["mass"]) for row in found] == [0.0, 1.5, 4.5]
        above[name] = float(found[-1]["above_line"])
        assert (folder / f"{name}.png").stat().st_size > 0
    assert (folder / "motor_curve.png").stat().st_size > 0
    assert above["limited"] > 10 * abs(above["linear"])


def test_masses_that_draw_no_line(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        script.main(["-o", str(tmp_path / "out"), "--masses", "0", "1"])
    assert "masses have 2 different values" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

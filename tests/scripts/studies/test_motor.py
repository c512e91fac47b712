"""The study of motor linearity: its output and its files."""

import csv
from pathlib import Path

import pytest

from scripts.studies.motor import linearity


@pytest.mark.parametrize(("joint", "limit"), [(2, 70), (3, 25)])
def test_tables_and_pictures_of_both_machines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], joint: int, limit: int
) -> None:
    folder = tmp_path / "out"
    quick = ["--masses", "0", "1.5", "4.5", "--swings", "1", "--period", "1"]
    tested = ["--joint", str(joint), "--limit", str(limit)]
    assert linearity.main(["-o", str(folder), *quick, *tested]) == 0
    printed = capsys.readouterr().out
    assert f"limit of linearity of joint {joint}: none" in printed
    assert f"limit of linearity of joint {joint}: {limit} N m" in printed
    above = {}
    for name in ("linear", "limited"):
        with (folder / f"{name}.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert [float(row["mass"]) for row in rows] == [0.0, 1.5, 4.5]
        above[name] = float(rows[-1]["above_line"])
        assert (folder / f"{name}.png").stat().st_size > 0
    assert (folder / "motor_curve.png").stat().st_size > 0
    assert above["limited"] > 10 * abs(above["linear"])


def test_masses_that_draw_no_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        linearity.main(["-o", str(tmp_path / "out"), "--masses", "0", "1"])
    assert "masses have 2 different values" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

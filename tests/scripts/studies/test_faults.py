"""The fault study, with few runs."""

import csv
from pathlib import Path

import pytest

from scripts.studies.faults import study


def test_table_and_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seeds", "2", "--moments", "1", "--healthy", "0", "--joints", "2"]
    assert study.main([*options, "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "faults.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["fault"] for row in rows[::2]] == [
        "lost samples",
        "stuck encoder",
        "reversed torque",
    ]
    assert all(row["named"] == "True" for row in rows)
    assert all(0 < float(row["detected_after_ms"]) < 100 for row in rows)
    printed = capsys.readouterr().out
    assert "2 of 2" in printed and "healthy: 0 of 0 runs alarmed" in printed


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("--seeds", "0", "expected 1 or more"), ("--joints", "7", "expected some of 1 to 6")],
)
def test_bad_options(
    option: str, value: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        study.main([option, value])
    assert message in capsys.readouterr().err

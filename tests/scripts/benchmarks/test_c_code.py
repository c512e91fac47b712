"""The benchmark of the C code, with few calls."""

import csv
import shutil
from pathlib import Path

import pytest

from scripts.benchmarks import c_code


def test_runs_small(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")
    assert c_code.main(["--calls", "1000", "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "times.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    assert all(float(row["c_us"]) > 0 for row in rows)


def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        c_code.main(["--calls", "0"])
    assert end.value.code == 2
    assert "--calls is 0" in capsys.readouterr().err

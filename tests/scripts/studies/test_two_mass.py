"""The study of rotors and links apart: two masses of one seed, its table and resumption."""

from pathlib import Path

import pytest

from scripts.studies.likelihood import two_mass


def test_two_masses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seeds", "1", "--arms", "0", "--samples", "1600", "-o", str(tmp_path)]
    for _ in range(2):  # the second time from finished rows
        assert two_mass.main(options) == 0
        printed = capsys.readouterr().out.split("two masses, no play")[0]
        apart, rigid = (
            next(line.split() for line in printed.split("\n") if line.startswith(name))
            for name in ("apart", "rigid ")
        )
        assert float(apart[1]) < 0.1 * float(rigid[1])
        assert " ".join(apart[-4:-1]) == "1 of 1"

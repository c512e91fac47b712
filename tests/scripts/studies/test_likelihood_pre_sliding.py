"""The study of states beside maximum likelihood: one seed, its tables and resumption."""

from pathlib import Path

import pytest

from scripts.studies.likelihood import pre_sliding


def test_one_recording_of_each_length(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--seeds", "1", "--samples", "800", "-o", str(tmp_path)]
    for _ in range(2):  # the second time from finished rows
        assert pre_sliding.main(options) == 0
        tables = capsys.readouterr().out.split("\n\n")
        for length, printed in zip(pre_sliding.LENGTHS[:2], tables, strict=False):
            assert f"{1e3 * length:g} mrad" in printed
            step, states = (
                next(line for line in printed.split("\n") if line.startswith(name))
                for name in ("step", "states, true length")
            )
            assert float(states.split()[3]) < 0.2 * float(step.split()[1])

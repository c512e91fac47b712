"""The study of chosen lengths in `identify`: one recording, its table and resumption."""

from pathlib import Path

import pytest

from scripts.studies.likelihood import pre_sliding_identify


def test_one_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pre_sliding_identify, "LENGTHS", (0.03,))
    options = ["--seeds", "1", "--first", "9000", "--samples", "2000", "-o", str(tmp_path)]
    for _ in range(2):  # the second time from finished rows
        assert pre_sliding_identify.main(options) == 0
        printed = capsys.readouterr().out.split("\n\n")[0]
        assert "30 mrad" in printed
        states, step = (
            next(line for line in printed.split("\n") if line.startswith(name)).split()
            for name in ("likelihood  ", "likelihood, step")
        )
        assert float(states[1]) < 0.2 * float(step[2])
        assert states[5:8] == ["1", "of", "1"]

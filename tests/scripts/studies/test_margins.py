"""The study of margins: statistics of clean recordings next to the bounds of checks."""

from pathlib import Path

import pytest

from scripts.studies.checks import margins


def test_clean_recordings_stay_within_most_bounds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(margins, "ARMS", ("UR5",))
    assert margins.main(["--seeds", "1", "-o", str(tmp_path)]) == 0
    table = capsys.readouterr().out.splitlines()[-len(margins.STATISTICS) :]
    assert [line.split("  ")[0] for line in table] == list(margins.STATISTICS)
    beyond = [line.split()[-1] for line in table if not line.startswith("error of a stretch")]
    assert beyond == ["0"] * len(beyond)

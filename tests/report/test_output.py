"""Folders of results: all files or none, whatever ends the process that writes them."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from jaxcslc._scratch import all_or_nothing, check_output_folder


def test_files_arrive_together(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "results"
    with all_or_nothing(folder) as scratch:
        (scratch / "a.csv").write_text("1")
        assert not folder.exists()
    assert (folder / "a.csv").read_text() == "1"
    assert list(folder.parent.iterdir()) == [folder]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "a.csv").write_text("before")
    with pytest.raises(KeyboardInterrupt), all_or_nothing(folder) as scratch:
        (scratch / "a.csv").write_text("after")
        raise KeyboardInterrupt
    assert (folder / "a.csv").read_text() == "before"
    assert list(tmp_path.iterdir()) == [folder]


def test_what_a_killed_process_left_is_removed_and_no_other(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    host = platform.node()
    left = tmp_path / f".results-{host}-{ended.pid}-abc"
    kept = [
        tmp_path / f".results-{host}-{os.getppid()}-abc",  # still at work
        tmp_path / f".results-another.host-{ended.pid}-abc",  # of a shared disk
        tmp_path / ".results-by-hand",
    ]
    for folder in (left, *kept):
        folder.mkdir()
    with all_or_nothing(tmp_path / "results") as scratch:
        (scratch / "a.csv").write_text("1")
    assert sorted(tmp_path.iterdir()) == sorted([*kept, tmp_path / "results"])


def test_results_that_cannot_be_written_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for folder in (file, file / "below"):
        with pytest.raises(ValueError, match="file: expected a folder for the results, this is a"):
            check_output_folder(folder)
    monkeypatch.setattr(os, "access", lambda *_: False)  # a superuser may write anywhere
    with pytest.raises(ValueError, match="expected a folder that can be written to"):
        check_output_folder(tmp_path / "new")


def test_an_interrupted_command_ends_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from jaxcslc.cli import _app, main

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(_app, "run", interrupted)
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 130
    assert capsys.readouterr().err == "jaxcslc: interrupted\n"

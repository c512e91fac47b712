"""Folders of results: all files or none, whatever ends the process that writes them."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from jaxcslc._scratch import all_or_nothing, check_output_folder, remove_left_behind


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


HOLD = """
import sys, time
from pathlib import Path
from jaxcslc._scratch import all_or_nothing
from jaxcslc.cli._process import prepare_process

prepare_process()
with all_or_nothing(Path(sys.argv[1])) as scratch:
    (scratch / "a.csv").write_text("1")
    print(scratch, flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def writing(folder: Path) -> Generator[tuple[subprocess.Popen[str], Path]]:
    """Another process that writes results into a folder, and its scratch folder."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, Path(process.stdout.readline().strip())
        finally:
            process.kill()


@pytest.mark.parametrize("exists", [False, True])
def test_what_a_killed_process_left_is_removed_and_no_other(tmp_path: Path, exists: bool) -> None:
    """A process is known by the lock that it holds, not by a number that another may have."""
    results = tmp_path / "results"
    if exists:
        results.mkdir()
    by_hand = tmp_path / ".results-by-hand"
    by_hand.mkdir()
    with writing(results) as (process, scratch):
        with all_or_nothing(results) as own:
            (own / "b.csv").write_text("2")
        assert scratch.exists()  # still at work
        process.kill()
        process.wait()
        assert scratch.exists()
    remove_left_behind(scratch.parents[1], "results")
    assert not scratch.parent.exists()
    assert by_hand.exists()
    assert [path.name for path in results.iterdir()] == ["b.csv"]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_ended_command_leaves_nothing(tmp_path: Path, how: signal.Signals) -> None:
    with writing(tmp_path / "results") as (process, scratch):
        process.send_signal(how)
        process.wait()
        assert not scratch.parent.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_link_in_place_of_scratch_is_not_followed(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "file").write_text("")
    (tmp_path / ".results-x.unfinished").symlink_to(precious)
    with all_or_nothing(tmp_path / "results"):
        pass
    assert (precious / "file").exists()


def test_scratch_of_a_folder_that_is_there_lies_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder may be a mount point, and the one around it write-protected."""
    results = tmp_path / "results"
    results.mkdir()
    seen: list[Path] = []
    replace = os.replace

    def spy(source: Path, target: Path) -> None:
        seen.append(Path(source))
        replace(source, target)

    monkeypatch.setattr(os, "replace", spy)
    with all_or_nothing(results) as scratch:
        (scratch / "a.csv").write_text("1")
    assert all(path.is_relative_to(results) for path in seen)
    assert [path.name for path in results.iterdir()] == ["a.csv"]


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

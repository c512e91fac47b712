"""Folders of results: all files or none, whatever ends the process that writes them."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from jaxcslc import _scratch
from jaxcslc._scratch import (
    all_or_nothing,
    all_together,
    check_output_folder,
    check_replaceable,
    remove_left_behind,
)


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
    assert {path.name for path in results.iterdir()} == {"b.csv", ".jaxcslc"}


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


def test_a_folder_that_cannot_be_exchanged_holds_its_scratch_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be a mount point, the one around it write-protected, or a shell be in it."""
    results = tmp_path / "results"
    results.mkdir()
    status = results.stat()
    monkeypatch.chdir(results)
    with all_or_nothing(Path()) as scratch:
        assert scratch.is_relative_to(results)
        (scratch / "a.csv").write_text("1")
    assert {path.name for path in results.iterdir()} == {"a.csv", ".jaxcslc"}
    assert results.stat().st_ino == status.st_ino


@pytest.mark.parametrize("how", ["exchanged", "another disk", "a shell is in it"])
def test_other_files_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """However a folder is replaced, only files that were written into it before are."""
    results = tmp_path / "results"
    with all_or_nothing(results) as scratch:
        for name in ("a.csv", "b.csv", "c.csv", "d.csv"):
            (scratch / name).write_text("first")
    (results / "c.csv").write_text("changed by hand")
    (results / "mine").mkdir()
    (results / "mine" / "notes").write_text("mine")
    (results / "link").symlink_to("nowhere")
    if how == "another disk":
        monkeypatch.setattr(_scratch, "_swap", lambda *_: False)
    if how == "a shell is in it":
        monkeypatch.chdir(results)
    results.chmod(0o750)
    with all_or_nothing(results, earlier=["b.csv", "c.csv", "mine"]) as scratch:
        (scratch / "a.csv").write_text("second")
    there = {path.name: path for path in results.iterdir()}
    assert {*there} == {"a.csv", "c.csv", "d.csv", "mine", "link", ".jaxcslc"}
    assert there["a.csv"].read_text() == "second"
    assert there["c.csv"].read_text() == "changed by hand"
    assert (there["mine"] / "notes").read_text() == "mine"
    assert results.stat().st_mode & 0o777 == 0o750
    assert [*tmp_path.iterdir()] == [results]
    check_replaceable(results, ["a.csv", "d.csv"])
    with pytest.raises(FileExistsError, match=r"c\.csv: was changed since"):
        check_replaceable(results, ["a.csv", "c.csv"])


def test_what_may_be_replaced(tmp_path: Path) -> None:
    check_replaceable(tmp_path / "new", ["a.csv"])
    check_replaceable(tmp_path, ["a.csv"])
    (tmp_path / "a.csv").write_text("mine")
    with pytest.raises(FileExistsError, match=r"did not write, as a\.csv; expected a new folder"):
        check_replaceable(tmp_path, ["b.csv"])
    check_replaceable(tmp_path, ["b.csv"], whole=False)
    with pytest.raises(FileExistsError, match=r"a\.csv: exists already"):
        check_replaceable(tmp_path, ["a.csv"], whole=False)
    check_replaceable(tmp_path, ["a.csv"], overwrite=True)
    with all_together([tmp_path / "a.csv"]) as (file,):
        file.write_text("written")
    check_replaceable(tmp_path, ["a.csv"])
    (tmp_path / "b.csv").mkdir()  # what is in it would be lost
    with pytest.raises(FileExistsError, match=r"b\.csv: expected no folder"):
        check_replaceable(tmp_path, ["b.csv"], overwrite=True)
    for text in ("[", "[]", '{"files": {"a.csv": 1}}', '{"files": 1}', "[" * 100_000):
        (tmp_path / ".jaxcslc").write_text(text)  # a list that is none allows nothing
        with pytest.raises(FileExistsError):
            check_replaceable(tmp_path, ["a.csv"])


def test_ctrl_c_between_two_files_waits_for_the_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / name for name in ("a", "b", "c")]
    replace = os.replace

    def interrupting(source: Path, target: Path) -> None:
        replace(source, target)
        if Path(target) == files[0]:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "replace", interrupting)
    with pytest.raises(KeyboardInterrupt), all_together(files) as scratch:
        for file in scratch:
            file.write_text("new")
    assert [file.read_text() for file in files] == ["new"] * 3
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b", "c", ".jaxcslc"}


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

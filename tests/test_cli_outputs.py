"""Commands do not replace what they read, nor what is no result of theirs."""

import contextlib
import errno
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from tests.conftest import run


ROBOT = """
name = "pendulum"
gravity = [0, -9.81, 0]
[[joint]]
"""


def refused(*arguments: str | Path) -> str:
    """The one line that the command ends in."""
    result = run(*arguments)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.strip().splitlines()
    return line


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pendulum, a recording of it, and what was identified from that."""
    folder = tmp_path_factory.mktemp("outputs")
    (folder / "pendulum.toml").write_text(ROBOT)
    (folder / "limits.toml").write_text("[joints]\nvelocity = 2.0\ntorque = 5.0\n")
    network = jc.derive(jc.load_robot(folder / "pendulum.toml"), lengths="numeric")
    t = np.arange(1000)[:, None] * 0.01
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    unmodelled = 0.01 * np.sin(37.0 * t)
    jc.save_recording(jc.Recording(t[:, 0], q, torque + unmodelled), folder / "train.csv")
    result = run(
        *("identify", folder / "pendulum.toml", folder / "train.csv", "-o", folder / "results"),
        *("--no-check", "--no-systematic", "--possible", "never"),
    )
    assert result.exit_code == 0, result.output
    return folder


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("torque_training.csv", ["identify", "ROBOT", "FILE", "-o", "FOLDER"]),
        ("torque_validation.csv", ["identify", "ROBOT", "FILE", "-o", "FOLDER"]),
        ("payload.csv", ["payload", "ROBOT", "FILE", "--previous", "RESULTS", "-o", "FOLDER"]),
        ("mine.csv", ["excite", "ROBOT", "--after", "FILE", "-o", "FILE"]),
    ],
)
def test_recordings_are_kept(name: str, command: list[str], folder: Path, tmp_path: Path) -> None:
    file = tmp_path / name
    shutil.copy(folder / "train.csv", file)
    known = {
        "ROBOT": folder / "pendulum.toml",
        "FILE": file,
        "FOLDER": tmp_path,
        "RESULTS": folder / "results",
    }
    line = refused(*(known.get(word, word) for word in command))
    assert f"{file}: is read, and the results would replace it" in line
    assert file.read_bytes() == (folder / "train.csv").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("named", ["results", "results/identification.json"])
def test_the_previous_identification_is_kept(named: str, folder: Path) -> None:
    before = (folder / "results" / "identification.json").read_bytes()
    previous = ("--reidentify", "viscous", "--previous", folder / named)
    files = (folder / "pendulum.toml", folder / "train.csv")
    line = refused("identify", *files, *previous, "-o", folder / "results")
    assert "identification.json: is read" in line and "another --output" in line
    assert (folder / "results" / "identification.json").read_bytes() == before


def test_commands_replace_what_they_wrote_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    """Each runs twice. What a user made, or changed, is refused before the work, and kept."""
    robot, results = folder / "pendulum.toml", folder / "results"
    excite = ("excite", robot, "--limits", folder / "limits.toml", "--previous", results)
    lines: dict[str, tuple[str | Path, ...]] = {
        "derived/coefficients.csv": ("derive", robot, "-o", "derived"),
        "page.html": ("compare", results, results, "-o", "page.html"),
        "arm.h": ("export", robot, results, "--c", "-o", "arm.c"),
        "arm.toml": ("export", robot, results, "-o", "arm.toml"),
        "motion.h": (*excite, "--duration", "2", "--starts", "1", "-o", "motion.csv"),
    }
    with contextlib.chdir(tmp_path):
        for name, line in lines.items():
            for _ in range(2):
                result = run(*line)
                assert result.exit_code == 0, result.output
            file = Path(name)
            file.write_text("mine")
            assert f"{name}: was changed since jaxcslc wrote it" in refused(*line)
            (file.parent / ".jaxcslc").unlink()
            assert "--overwrite" in refused(*line)
            assert file.read_text() == "mine"
            assert run(*line, "--overwrite").exit_code == 0
            assert file.read_text() != "mine"


def test_a_fleet_does_not_replace_its_recording(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "fleet.csv"
    shutil.copy(folder / "train.csv", file)
    line = ("identify", folder / "pendulum.toml", tmp_path / "*.csv", "--dask", "local", "--fleet")
    for overwrite in ((), ("--overwrite",)):
        assert "fleet.csv: is read" in refused(*line, "-o", tmp_path, *overwrite)
    assert file.read_bytes() == (folder / "train.csv").read_bytes()


def test_a_comparison_is_a_page(folder: Path) -> None:
    """Another file of that name would be replaced by one."""
    results = folder / "results"
    for name in ("pendulum.toml", "results/identification.json"):
        before = (folder / name).read_bytes()
        line = refused("compare", results, results, "-o", folder / name)
        assert "expected a name that ends in .html" in line
        assert (folder / name).read_bytes() == before


def test_a_name_is_refused_before_a_motion_is_searched_for(folder: Path) -> None:
    """Without masses the search would take seconds, and end in the same line."""
    robot = folder / "pendulum.toml"
    assert "expected a name that ends in .csv" in refused("excite", robot, "-o", "motion.txt")


def test_a_folder_that_cannot_be_written_to(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line names the file that was asked for, not that of a scratch folder."""

    def denied(*_: Any, **__: Any) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", "/somewhere/.scratch")

    monkeypatch.setattr(tempfile, "mkdtemp", denied)
    page = tmp_path / "page.html"
    line = refused("compare", folder / "results", folder / "results", "-o", page)
    denial = f"[Errno {errno.EACCES}] Permission denied: '{page}'"
    assert line == f"jaxcslc: {denial} (docs/report.md)"


def test_a_motion_is_not_searched_for_where_it_cannot_be_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere(*_: Any, **__: Any) -> bool:
        return False

    monkeypatch.setattr(os, "access", nowhere)
    line = refused("excite", folder / "pendulum.toml", "-o", tmp_path / "motion.csv")
    expected = f"{tmp_path}: expected a folder that can be written to"
    assert line == f"jaxcslc: {expected} (docs/excitation.md)"

"""What the tool that ends programs takes for damage."""

import json
from pathlib import Path

import pytest

from scripts.tools import kills


PROGRAM = kills.PROGRAMS["identify"]


def test_damage_is_seen(tmp_path: Path) -> None:
    files = {
        name: tmp_path / "out" / name for name in ("kept.csv", "new.csv", "half.csv", "gone.csv")
    }
    (tmp_path / "out").mkdir()
    for file in files.values():
        file.write_text("before\n")
    before = {file: file.read_bytes() for file in files.values()}
    files["new.csv"].write_text("after\n")
    files["half.csv"].write_text("aft")
    files["gone.csv"].unlink()
    whole = {f"out/{name}": True for name in files}
    assert kills._damage(PROGRAM, tmp_path, before, whole) == [
        "half.csv is damaged",
        "gone.csv is gone",
    ]


def test_results_are_compared_by_their_coefficients(tmp_path: Path) -> None:
    path = tmp_path / "identification.json"
    path.write_text(json.dumps({"k": [1.0], "seconds": 2.0}))
    assert kills._content_of(path) == [1.0]


@pytest.mark.parametrize(
    ("code", "errors", "fault", "expected"),
    [
        (130, "jaxcslc: interrupted\n", "SIGINT", None),
        (130, "jaxcslc: interrupted\n", "SIGTERM", None),
        (1, "Traceback\n", "SIGTERM", "exit code 1 after SIGTERM"),
        (-9, "", "SIGKILL", None),
        (2, "jaxcslc: [Errno 27] File too large: 'out'\n", "full disk", None),
        (1, "one\ntwo\n", "full disk", "exit code 1 of full disk: two"),
        (2, "jaxcslc: exists already\n", "two at once", "exit code 2 of two at once"),
        (0, "hangs", "read-only", "hangs after read-only"),
    ],
)
def test_ends_of_processes(code: int, errors: str, fault: str, expected: str | None) -> None:
    if errors.startswith("Traceback"):
        errors += 'File "<string>", line 1\n'
    wrong = kills._wrong_end(PROGRAM, code, errors, fault)
    assert wrong is None if expected is None else expected in str(wrong)


def test_hidden_files_are_found_but_the_marker(tmp_path: Path) -> None:
    for name in (".jaxcslc", ".results-x.unfinished", "a.csv"):
        (tmp_path / name).write_text("")
    assert kills._hidden(tmp_path) == [".results-x.unfinished"]

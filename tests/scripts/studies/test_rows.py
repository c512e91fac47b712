"""The file of finished rows: interrupted studies go on, rows of other options do not count."""

from pathlib import Path

import pytest

from scripts.studies.rows import Rows, made_of


def test_rows_are_there_when_the_file_is_opened_again(tmp_path: Path) -> None:
    path = tmp_path / "new" / "rows.jsonl"
    rows = Rows(path, ("case", "seed"), "a")
    assert ("one", 0) not in rows and rows.all() == []
    rows.add({"case": "one", "seed": 0, "error": 0.5}, {"case": "one", "seed": 1, "error": 0.25})
    again = Rows(path, ("case", "seed"), "a")
    assert ("one", 1) in again and again["one", 1]["error"] == 0.25
    assert again.all() == rows.all()
    again.add({"case": "one", "seed": 1, "error": 1.0})
    assert Rows(path, ("case", "seed"), "a")["one", 1]["error"] == 1.0


def test_a_half_written_line_is_made_again(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    Rows(path, ("seed",), "a").add({"seed": 0})
    whole = path.read_text("utf-8")
    path.write_text(whole + '{"seed": 1, "err', "utf-8")
    rows = Rows(path, ("seed",), "a")
    assert (0,) in rows and (1,) not in rows
    assert path.read_text("utf-8") == whole


def test_rows_of_other_options_are_ignored_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    Rows(path, ("seed",), "a").add({"seed": 0})
    Rows(path, ("seed",), "b").add({"seed": 1})
    assert Rows(path, ("seed",), "a").all() == [{"seed": 0}]
    assert Rows(path, ("seed",), "b").all() == [{"seed": 1}]


@pytest.mark.parametrize("line", ["no row", "[1, 2]", '{"seed": 0}', '{"made_of": "a"}'])
def test_a_line_that_is_no_row_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"made_of": "a", "seed": 0}\n' + line + "\n", "utf-8")
    with pytest.raises(ValueError, match=r"rows\.jsonl, line 2: .*; expected a row of this study"):
        Rows(path, ("seed",), "a")


def test_rows_are_made_of_options_and_code(tmp_path: Path) -> None:
    code = tmp_path / "study.py"
    code.write_text("first")
    first = made_of({"samples": 1}, [code])
    assert first == made_of({"samples": 1}, [code])
    assert first != made_of({"samples": 2}, [code])
    code.write_text("second")
    assert first != made_of({"samples": 1}, [code])

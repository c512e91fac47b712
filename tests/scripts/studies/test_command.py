"""What all studies share: the trial run's defaults, durations, and what is printed first."""

import re
import sys
from pathlib import Path

import pytest

from scripts.studies import command


def parsed(arguments: list[str]) -> tuple[int, float, bool]:
    parser = command.new_parser("A study.", "some_study")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--noise", type=float, default=0.1)
    options = command.parse(parser, arguments, seeds=2)
    return options.seeds, options.noise, options.quick


def test_a_trial_run_replaces_defaults_and_not_options() -> None:
    assert parsed([]) == (10, 0.1, False)
    assert parsed(["--quick"]) == (2, 0.1, True)
    assert parsed(["--seeds", "5", "--quick", "--noise", "0"]) == (5, 0.0, True)


def test_a_trial_run_stores_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    parser = command.new_parser("A study.", "some_study")
    command.add_store(parser)
    assert command.parse(parser, ["--store"]).store
    parser = command.new_parser("A study.", "some_study")
    command.add_store(parser)
    with pytest.raises(SystemExit):
        command.parse(parser, ["--store", "--quick"])
    assert "--store is for full runs; expected no --quick" in capsys.readouterr().err


@pytest.mark.parametrize("value", [-1.0, 0.0, 1.0, float("nan")])
def test_values_between_limits(capsys: pytest.CaptureFixture[str], value: float) -> None:
    parser = command.new_parser("A study.", "some_study")
    parser.add_argument("--the-level", type=float)
    inside = parser.parse_args(["--the-level", "0.5"])
    command.require_between(parser, inside, the_level=(0.0, 1.0))
    with pytest.raises(SystemExit):
        outside = parser.parse_args([f"--the-level={value}"])
        command.require_between(parser, outside, the_level=(0.0, 1.0))
    expected = f"--the-level is {value}; expected more than 0 and less than 1"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.2, "1 seconds"),
        (44.0, "40 seconds"),
        (89.0, "90 seconds"),
        (90.0, "1.5 minutes"),
        (754.0, "13 minutes"),
        (5399.0, "90 minutes"),
        (5400.0, "1.5 hours"),
        (1e5, "28 hours"),
    ],
)
def test_durations_in_words(seconds: float, text: str) -> None:
    assert command.duration_text(seconds) == text


def test_a_study_says_first_how_long_it_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "keep_compiled", lambda: None)
    parser = command.new_parser("A study.", "some_study")
    rows = tmp_path / "rows.jsonl"

    def study() -> int:
        print("result")
        return 3

    assert command.run(parser, study, rows, seconds=120.0) == 3
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"about 2 minutes on two cores; finished parts are kept in {rows}"
    assert second == "result"


def test_interrupted_and_failed_studies_end_with_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "keep_compiled", lambda: None)
    parser = command.new_parser("A study.", "some_study")

    def interrupted() -> int:
        raise KeyboardInterrupt

    def failed() -> int:
        raise ValueError("two\nlines")

    assert command.run(parser, interrupted, Path("rows.jsonl")) == 130
    assert "the same command goes on from rows.jsonl" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        command.run(parser, failed)
    assert "error: two lines" in capsys.readouterr().err


def test_progress_is_written_into_files_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    assert list(command.progress(range(3), desc="seeds", unit="seed")) == [0, 1, 2]
    assert "seeds: 100%" in capsys.readouterr().err


PROGRAMS = [
    path
    for path in sorted((Path(__file__).parents[3] / "scripts" / "studies").rglob("*.py"))
    if "command.run(" in path.read_text("utf-8")  # the others end within seconds
]


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_study_has_a_trial_run_and_says_how_long_it_takes(path: Path) -> None:
    source = path.read_text("utf-8")
    assert re.search(r"\b(command|by_arm)\.parse\(", source)
    assert "seconds=" in source.partition("command.run(")[2]

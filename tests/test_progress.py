"""Progress: who is shown the steps of a computation."""

import sys

import pytest

from jaxcslc._display import Progress, steps


def shown(progress: Progress, capsys: pytest.CaptureFixture[str]) -> str:
    with steps(progress, "identify arm") as step:
        step("fitting coefficients")
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


def test_programs_without_a_terminal_print_nothing_unless_asked(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert shown(None, capsys) == shown(False, capsys) == ""
    assert "identify arm: fitting coefficients" in shown(True, capsys)


def test_prompts_and_notebooks_show_steps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    assert "identify arm: fitting coefficients" in shown(None, capsys)
    assert shown(False, capsys) == ""


def test_scripts_on_a_terminal_show_steps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert "identify arm: fitting coefficients" in shown(None, capsys)
    assert shown(False, capsys) == ""
    monkeypatch.setattr("multiprocessing.parent_process", lambda: object())  # in a worker
    assert shown(None, capsys) == ""


def test_a_function_gets_the_words(capsys: pytest.CaptureFixture[str]) -> None:
    words: list[str] = []
    assert shown(words.append, capsys) == "" and words == ["fitting coefficients"]

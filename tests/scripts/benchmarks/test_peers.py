"""Benchmarks beside other programs, on machines that lack these."""

import shutil

import pytest

from scripts.benchmarks.peers import figaroh_identification, pinocchio_regressor


def test_no_compiler_of_cpp(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert list(pinocchio_regressor.metrics()) == []
    assert pinocchio_regressor.main([]) == 1
    assert "needs g++" in capsys.readouterr().out


def test_no_figaroh(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(figaroh_identification, "find_spec", lambda name: None)
    assert list(figaroh_identification.metrics()) == []
    assert figaroh_identification.main([]) == 1
    assert "needs the package figaroh" in capsys.readouterr().out

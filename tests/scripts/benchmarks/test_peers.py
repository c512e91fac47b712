"""Benchmarks beside other programs, on machines that lack these."""

import shutil

import numpy as np
import pytest

import jaxcslc as jc
from scripts.benchmarks.peers import figaroh_identification, mujoco_sysid, pinocchio_regressor
from scripts.studies.real_robots import simulation_fit


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


def test_no_tabulate(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(mujoco_sysid, "find_spec", lambda name: None)
    assert list(mujoco_sysid.metrics()) == []
    assert mujoco_sysid.main([]) == 1
    assert "needs the package tabulate" in capsys.readouterr().out


def test_errors_beside_sysid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a search that ends nowhere, torque errors are as large as torque."""

    def nothing(network: jc.CSLC, *_: object) -> tuple[np.ndarray, int]:
        return np.zeros(network.size), 0

    monkeypatch.setattr(simulation_fit, "simulation_fit", nothing)
    figures = {metric.name: metric.value for metric in mujoco_sysid.metrics(samples=660, steps=7)}
    assert figures["mujoco_sysid.7_steps.torque_error"] == pytest.approx(1.0)
    assert figures["mujoco_sysid.least_squares.torque_error"] < 0.2
    assert figures["mujoco_sysid.identify.torque_error"] < 0.2

"""The study of agreement, with recordings of a pendulum in place of the arms'."""

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.agreement import study
from scripts.studies.checks.recordings import Conditions
from tests import arms


@cache
def pendulum(_: str) -> jc.CSLC:
    return arms.pendulum("viscous", "dry")


def swings(arm: str, conditions: Conditions, seed: int) -> jc.Recording:
    rng = np.random.default_rng(seed)
    time = np.arange(1500)[:, None] * 0.004
    phase = rng.uniform(0, 6, 2)
    q = np.sin(3 * time + phase[0]) + 0.5 * np.sin(5 * time + phase[1])
    qd = 3 * np.cos(3 * time + phase[0]) + 2.5 * np.cos(5 * time + phase[1])
    qdd = -9 * np.sin(3 * time + phase[0]) - 12.5 * np.sin(5 * time + phase[1])
    k = np.array([1.0, 3.0 + conditions.payload, 0.2, 0.5, 1.0])
    assert pendulum(arm).names == ("kB1", "kB2", "kB3", "kv1", "kd1")
    k[3:] *= conditions.friction
    torque = np.asarray(pendulum(arm).torque(k, q, qd, qdd))
    return jc.Recording(time[:, 0], q, torque + 0.01 * rng.standard_normal(torque.shape))


def test_table_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(study, "network", pendulum)
    monkeypatch.setattr(study, "record", swings)
    options = ["--arms", "six", "--same", "2", "--seeds", "1", "-o", str(tmp_path)]
    options += ["--cases", "same arm", "friction +20 %", "payload 0.5 kg"]
    assert study.main(options) == 0
    with (tmp_path / "agreement.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["with systematic errors"] for row in rows] == ["0 of 2", "1 of 1", "1 of 1"]
    assert [row["right kind first"] for row in rows] == ["", "1 of 1", "1 of 1"]
    capsys.readouterr()
    monkeypatch.setattr(study, "record", None)  # every row is there
    assert study.main(options) == 0
    assert "2 of 2" not in capsys.readouterr().out


def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--cases", "dust", "-o", str(tmp_path)])
    assert "no case is called 'dust'; expected some of same arm, friction +5 %" in (
        capsys.readouterr().err
    )

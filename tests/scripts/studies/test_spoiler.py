"""The spoiler study: its arms are those of their files but for errors, and its faults do harm."""

import csv
import functools
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.checks import spoiler
from scripts.studies.checks.robots import Conditions, Fault, arm, record
from scripts.studies.checks.spoilers import SPOILERS, spoilt


# Torques of two programs that read one file: URDF files round lengths and angles.
ROUNDING = 1e-4


@pytest.mark.parametrize("name", ["UR5", "Panda"])
def test_torques_are_those_of_the_true_coefficients(name: str) -> None:
    """Pinocchio's torque of the true bodies is the network's with their coefficients."""
    one = arm(name, 3)
    run = record(name, Conditions(duration=8.0, rate=125.0, noise=0.0), 3)
    viscous, coulomb, _ = one.friction
    expected = run.gravity + run.motion + viscous * run.qd + coulomb * np.sign(run.qd)
    torque = np.asarray(one.network.torque(one.coefficients(), run.q, run.qd, run.qdd))
    assert np.max(np.abs(torque - expected) / one.size) < ROUNDING


@pytest.mark.parametrize("kind", SPOILERS)
def test_each_kind_spoils_more_or_less(kind: str) -> None:
    clean = record("Z1", Conditions(), 0).recording
    mild, gross = (spoilt("Z1", kind, size, 0) for size in (0, 2))
    for found in (mild, gross):
        assert found.kinds and found.recordings[0].joints == 6
        assert all(np.all(np.isfinite(x)) for x in (found.recordings[0].time, clean.torque))
    changed = mild.recordings[0]
    same = changed.samples == clean.samples and all(
        np.array_equal(getattr(changed, x), getattr(clean, x))
        for x in ("time", "position", "torque")
    )
    assert same == bool(mild.file)


def test_faults_of_the_arm_show_where_they_are() -> None:
    conditions = Conditions(duration=16.0, rate=125.0, noise=0.0)
    clean, tool = (record("Z1", conditions, 0, fault) for fault in (None, Fault(tool=0.5)))
    half = clean.recording.samples // 2
    change = np.abs(tool.recording.torque - clean.recording.torque).max(axis=1)
    assert change[:half].max() == 0.0 < np.median(change[half + 1 :])
    stopped = record("Z1", conditions, 0, Fault(stop=(1, 0.8)))
    highest = stopped.q[:, 1] == stopped.q[:, 1].max()
    assert 0.15 < highest.mean() < 0.25
    assert np.all(stopped.qd[highest, 1] == 0.0)


def test_table_and_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With settings that are not selected."""
    monkeypatch.setattr(jc, "identify", functools.partial(jc.identify, settings=jc.Settings()))
    options = ["--arms", "Z1", "--kinds", "sign of one torque", "--sizes", "gross"]
    assert spoiler.main([*options, "--clean", "1", "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["kind"], row["result"], row["first"]) for row in rows[:1]] == [
        ("sign of one torque", "named", "sign"),
    ]
    assert "false alarms on 1 clean recordings: 0" in capsys.readouterr().out

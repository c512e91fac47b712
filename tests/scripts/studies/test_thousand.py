"""Machines drawn at random, recorded by MJX, trained and solved: rigid and short."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import sim
from scripts.studies.training import thousand


SHORT = ["--rigid", "--seconds", "1.2", "0.8", "--epochs", "220", "--least", "1e-3"]


def test_two_machines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each row is that of the machine's own recording, and the second run computes none again."""
    arguments = [*SHORT, "--machines", "2", "-o", str(tmp_path)]
    assert thousand.main(arguments) == 0
    first = capsys.readouterr().out
    assert "record training: " in first and "2 machines; joints of 0 of 3" in first
    with (tmp_path / "machines.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["design"] for row in rows] == ["PUMA A", "PUMA B"]
    for row in rows:
        true, published = (float(row[f"{name}, ε"]) for name in (thousand.TRUE, thousand.PUBLISHED))
        assert 0.0 < true < 0.5 < published
        # The direct solve minimises squares on the training recording: nothing does much better.
        learnt = {name: float(row[f"{name}, training ε"]) for name in thousand.METHODS}
        assert learnt[thousand.SOLVED] < 1.05 * min(learnt.values())
    stored = json.loads((tmp_path / "thousand.json").read_text())
    assert stored["machines"] == {"drawn": 3, "left their ranges": 0, "kept": 2}
    assert {row["stage"] for row in stored["stages"]} >= {"record training", "train", "solve"}
    assert thousand.main(arguments) == 0
    assert "record training: " not in capsys.readouterr().out


def test_machines_differ_in_all_that_is_drawn() -> None:
    one, same, other = (thousand.machine_of(seed) for seed in (0, 0, 2))
    assert one == same or one.backlash == same.backlash
    design = sim.puma_a()
    for machine in (one, other):
        resolution = np.array(machine.encoder_resolution) / np.array(design.encoder_resolution)
        assert np.all((resolution >= 0.5) & (resolution <= 4.0))
        most = np.array(sim.DISTURBANCES["backlash"]["backlash"])
        assert np.all(
            (np.array(machine.backlash) >= 0.0) & (np.array(machine.backlash) <= 2 * most)
        )
    for name in ("viscous", "dry", "backlash", "encoder_resolution"):
        assert not set(getattr(one, name)) & set(getattr(other, name))
    assert not any(thousand.machine_of(1, rigid=True).backlash)


def test_too_short_recordings_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        thousand.main(["--seconds", "0.1", "1"])
    assert "expected 0.2 or more" in capsys.readouterr().err.splitlines()[-1]

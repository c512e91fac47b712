"""The study of smoothings: its targets, its regions, and a tiny run."""

import csv
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

import jaxcslc as jc
import sim
from scripts.studies.smoothing import study
from scripts.studies.smoothing.results import relative


def test_the_target_is_the_mean_of_the_intervals_that_meet(
    puma: jc.CSLC, puma_k: jax.Array
) -> None:
    """Against differences of true velocities, which need no mass matrix, away from reversals."""
    _, truth = sim.simulate(sim.puma560(), sim.comparison(), seed=1)
    target = study.true_acceleration(puma, puma_k, truth)
    differences = np.gradient(truth.velocity, truth.time, axis=0)
    away = study.regions(truth)[study.AWAY]
    error = np.sqrt(study.mean_where((target - differences) ** 2, away))
    jumps = np.sqrt(study.mean_where((truth.acceleration - differences) ** 2, away))
    assert np.all(error < 0.05 * jumps)


def test_regions_are_around_changes_of_sign() -> None:
    time = np.arange(1000) * 0.002
    # It turns at 0.401 s and 1.201 s, between two samples.
    turning = np.cos(2 * np.pi * (time - 0.001) / 1.6)
    velocity = np.stack([turning, np.ones(1000)], axis=1)
    truth: Any = SimpleNamespace(time=time, velocity=velocity)
    masks = study.regions(truth)
    at, away = masks[study.AT], masks[study.AWAY]
    assert not np.any(at & away)
    assert not np.any(at[:, 1])
    expected = (np.abs(time - 0.401) < 0.0495) | (np.abs(time - 1.201) < 0.0495)
    assert np.array_equal(at[:, 0], expected)
    assert np.array_equal(np.flatnonzero(away[:, 1]), np.arange(50, 950))


def test_best_is_the_least_over_all_seeds() -> None:
    def one(low: float, high: float) -> study.Errors:
        trials = {"filter": {1.0: np.array([low]), 2.0: np.array([high])}}
        empty = {"filter": {1.0: np.array([np.nan]), 2.0: np.array([np.nan])}}
        return study.Errors(
            (9,),
            {study.AWAY: np.array([4.0]), study.AT: np.array([np.nan])},
            {study.AWAY: trials, study.AT: empty},
        )

    selected, best = study.summarise("training", [one(1.0, 2.0), one(9.0, 2.0)])
    assert (selected.rmse, selected.spread, selected.setting) == (2.0, 0.0, "9")
    assert (best.setting, best.rmse, best.spread) == ("2", np.sqrt(2.0), 0.0)
    assert relative({1: best}, {1: selected}) == pytest.approx(np.sqrt(0.5))


def test_a_tiny_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    few = {
        study.BEST: {9: jc.AveragedSplines(9), 17: jc.AveragedSplines(17)},
        "Butterworth, best": {20.0: jc.Butterworth(20.0)},
    }
    monkeypatch.setattr(study, "candidates", lambda: few)
    monkeypatch.setattr(study, "choose_spacing", lambda time, position: (17,) * 6)
    assert study.main(["--seeds", "1", "-o", str(tmp_path / "study")]) == 0
    printed = capsys.readouterr().out
    assert "training trajectory, at reversals" in printed
    assert f"wrote smoothing.csv and smoothing.png into {tmp_path / 'study'}" in printed
    with (tmp_path / "study" / "smoothing.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    # Joints do not turn round in the comparison trajectory.
    assert len(rows) == 3 * 6 * 3
    assert all(float(row["acceleration RMSE [rad/s²]"]) > 0.0 for row in rows)
    at = [row for row in rows if row["region"] == study.AT]
    of = {
        method: [float(row["acceleration RMSE [rad/s²]"]) for row in at if row["method"] == method]
        for method in (study.BEST, "Butterworth, best")
    }
    assert all(a < b for a, b in zip(*of.values(), strict=True))
    assert (tmp_path / "study" / "smoothing.png").stat().st_size > 10_000


def test_no_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--seeds", "0"])
    assert "--seeds is 0; expected 1 or more" in capsys.readouterr().err

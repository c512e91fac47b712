"""Errors at the hand on short recordings: tables are written, and hold what they say."""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.assessment import hand_effects
from scripts.studies.puma560 import hand


MODELS = ("Ar+LS", "Ar+Rg", "CSLC", "true")


def test_rows_by_hand(puma: jc.CSLC, puma_k: np.ndarray, rng: np.random.Generator) -> None:
    """Of random motion whose torques are those of the coefficients and 1 N m at joint 5."""
    q, qd, qdd = rng.normal(size=(3, 8, 6))
    unit = np.eye(6)[4]
    torque = np.asarray(puma.torque(puma_k, q, qd, qdd)) + unit
    pairs = np.ones(q.shape, bool)
    patterns = jc.Patterns(np.arange(8.0), q, qd, qdd, torque, pairs, pairs)
    rows = hand.hand_rows(puma, patterns, {"true": puma_k})
    effects = np.asarray(hand_effects(puma, puma_k, q, point=hand.FLANGE))
    expected = np.linalg.norm(effects[:, :, 4], axis=1).mean()
    assert [row[""] for row in rows] == [*(f"joint {j}" for j in range(1, 7)), "all joints"]
    assert_allclose([rows[4]["true"], rows[6]["true"]], expected, rtol=1e-9)
    assert_allclose([rows[j]["true"] for j in (0, 1, 2, 3, 5)], 0.0, atol=1e-9)


def test_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert hand.main(["--quick", "--samples", "600", "-o", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hand_a.csv", "hand_b.csv"]
    assert "PUMA B: mean acceleration error of the flange" in capsys.readouterr().out
    for letter in "ab":
        with (tmp_path / f"hand_{letter}.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        values = np.array([[float(row[name]) for name in MODELS] for row in rows])
        assert values.shape == (7, 4) and np.all(np.isfinite(values)) and np.all(values > 0)
        # Of all joints no more than the sum over them, and the truth is better than Armstrong's.
        assert np.all(values[6] <= values[:6].sum(axis=0))
        assert values[6, MODELS.index("true")] < values[6, MODELS.index("Ar+LS")]

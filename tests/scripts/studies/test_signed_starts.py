"""The study of initial weights restricted by sign: its starts, and a tiny run."""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from jaxcslc import CSLC
from scripts.studies.training import signed_starts as study


def test_starts_differ_in_forbidden_signs_alone(puma: CSLC) -> None:
    positive = np.array([coefficient.positive for coefficient in puma.coefficients])
    signed, random = (
        np.asarray(study.starts(start, 0.1, 50)) for start in (study.SIGNED, study.RANDOM)
    )
    assert_array_equal(np.abs(signed), np.abs(random))
    assert np.all(signed[:, positive] > 0)
    assert_array_equal(signed[:, ~positive], random[:, ~positive])
    wrong = (random[:, positive] < 0).mean()
    assert abs(wrong - 0.5) < 5 * 0.5 / np.sqrt(50 * positive.sum())  # five standard deviations
    assert_array_equal(study.starts(study.ZERO, 0.0, 50), jnp.zeros((1, 43)))


def test_a_tiny_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "RULES", {"backpropagation": study.RULES["backpropagation"]})
    monkeypatch.setattr(study, "GOALS", (0.01, 0.99))
    tiny = ["--seeds", "2", "--patterns", "30", "--epochs", "20", "--scales", "0.1"]
    assert study.main([*tiny, "-o", str(tmp_path)]) == 0
    with (tmp_path / "signed_starts.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["start"] for row in rows] == [study.ZERO, study.RANDOM, study.SIGNED]
    assert rows[0]["first cost"] == "1"
    assert rows[0]["1%"].endswith("(1/1)") and rows[0]["99%"] == "never (0/1)"
    assert study.SIGNED in capsys.readouterr().out


def test_scales_are_positive(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--scales", "0"])
    assert "--scales is [0.0]; expected more than 0" in capsys.readouterr().err

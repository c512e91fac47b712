"""The study of initial weights restricted by sign: its starts, and a tiny run."""

import csv
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
    # One seed: every start has the one shape, and one program trains them all.
    tiny = ["--seeds", "1", "--patterns", "30", "--epochs", "20", "--scales", "0.1"]
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


def test_signed_starts(puma: CSLC) -> None:
    """5.2.3: signs that the derivation knows; the others either way; moduli up to the scale."""
    keys = jax.random.split(jax.random.key(1), 400)
    scale = np.linspace(0.1, 2.0, 43)
    starts = np.asarray(jax.jit(jax.vmap(lambda key: study.signed_start(puma, key, scale)))(keys))
    positive = np.array([coefficient.positive for coefficient in puma.coefficients])
    assert positive.sum() == 22 and np.all(starts[:, positive] > 0)
    shares = (starts[:, ~positive] > 0).mean(axis=0)
    assert np.all(np.abs(shares - 0.5) < 5 * 0.5 / np.sqrt(400))  # five standard deviations
    moduli = np.abs(starts) / scale
    assert np.all(moduli <= 1.0)
    assert_allclose(moduli.mean(axis=0), 0.5, atol=5 * np.sqrt(1 / 12 / 400))
    assert_allclose(study.signed_start(puma, keys[3], scale), starts[3], rtol=1e-12)


@pytest.mark.parametrize("scale", [np.ones(2), 0.0, np.linspace(-1.0, 1.0, 43), np.nan])
def test_signed_starts_refused(scale: Any, puma: CSLC) -> None:
    with pytest.raises(
        ValueError, match="scale: expected a positive number, or one for each of 43"
    ):
        study.signed_start(puma, jax.random.key(0), scale)

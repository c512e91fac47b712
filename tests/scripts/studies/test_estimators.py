"""The tables of the comparison of estimators, from estimates that are known."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scripts.studies.estimators import recordings, study
from scripts.studies.estimators.methods import NAMES


def fake_rows(
    kind: str, samples: int, time_step: float, seed: int, methods: list[str]
) -> Iterator[dict[str, Any]]:
    """Errors of 2 ± 1 in one coefficient and of ± 1 in the other."""
    del samples, time_step
    sign = 1.0 if seed % 2 else -1.0
    for method in methods:
        yield {
            "kind": kind,
            "seed": seed,
            "method": method,
            "epsilon": 0.01 * (1 + seed),
            "error": [2.0 + sign, sign],
            "inside": 0.5,
            "seconds": 1.0 + seed,
            "p_value": 0.04 + 0.02 * seed if method == NAMES[2] else None,
        }


def test_tables_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[int, int]] = []

    def counted(*arguments: Any) -> Iterator[dict[str, Any]]:
        calls.append((arguments[3], len(arguments[4])))
        return fake_rows(*arguments)

    monkeypatch.setattr(study, "rows_of", counted)
    options = ["--seeds", "2", "--kinds", "encoders", "-o", str(tmp_path)]
    assert study.main([*options, "--methods", *NAMES[:2]]) == 0
    assert study.main(options) == 0
    assert calls == [(seed, count) for count in (2, len(NAMES) - 2) for seed in (0, 1)]
    lines = capsys.readouterr().out.split("encoders")[-2].split("\n")
    # Means of 2 and 0 over standard deviations of root two.
    bias = f"{np.sqrt((2 / np.sqrt(2)) ** 2 / 2):.2f}"
    row = next(line for line in lines if line.startswith(NAMES[2]))
    assert row.removeprefix(NAMES[2]).split() == ["0.0150", bias, "50", "%", "1.5", "50", "%"]
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert len(rows) == 2 * len(NAMES)


def test_the_excitation_has_the_derivatives_it_says() -> None:
    q, qd, qdd = recordings.excitation(3300)
    for values, derivative in ((q, qd), (qd, qdd)):
        differences = np.gradient(values, recordings.INTERVAL, axis=0)
        assert np.max(np.abs(differences - derivative)[1:-1]) < 1e-2 * np.max(np.abs(derivative))
    assert np.all(qd[0] == 0.0) and np.all(qdd[0] == 0.0)


def test_bad_options(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--seeds", "0"], ["--kinds", "none"], ["--methods", "x"], ["--time-step", "0"]):
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err

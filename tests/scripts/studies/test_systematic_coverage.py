"""The study of intervals with systematic errors: what it counts, and a tiny run."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from scripts.studies.coverage import systematic as study
from scripts.studies.truth import ALL_CAUSES, STANDARD_ERROR


def row(machine: str, case: str, covered: list[bool], wider: float) -> dict[str, Any]:
    return {
        "machine": machine,
        "case": case,
        "covered": {STANDARD_ERROR: [False, False], ALL_CAUSES: covered},
        "wider": [1.0, wider],
        "half width": [0.2, 0.2],
        "half width, standard error": [0.1, 0.1],
    }


def test_counts_what_was_covered() -> None:
    rows = [
        row("PUMA A", "encoders", [True, True], 3.0),
        row("PUMA A", "encoders", [True, False], 3.0),
        row("PUMA B", "encoders", [False, False], 1.0),
    ]
    line = study.summary(rows, "PUMA A", "encoders")
    assert line[STANDARD_ERROR] == 0.0 and line[ALL_CAUSES] == 1.5
    assert line["times as wide"] == 2.0
    assert line["half width [%]"] == pytest.approx(20.0)


def test_counts_confident_errors() -> None:
    rows = [
        {"relative error": [0.1, 0.04, 0.2], "verdict": ["well determined"] * 2 + ["wrong sign"]},
        {"relative error": [0.06, 3.0, 0.0], "verdict": ["well determined"] * 3},
    ]
    assert study.confident_errors(rows, "verdict") == 3


def test_machines_have_the_disturbances_of_their_case() -> None:
    assert not any(study.machine_of("PUMA A", "encoders").backlash)
    assert any(study.machine_of("PUMA B", "all disturbances").backlash)


def test_a_tiny_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One machine on a short recording; a second call takes its rows from the file."""
    monkeypatch.setattr(study, "MACHINES", {"PUMA A": sim.puma_a})
    monkeypatch.setattr(study, "CASES", {"all disturbances": ("quantisation", "static friction")})
    monkeypatch.setattr(study.sim, "training", lambda robot: TRAINING(samples=800, robot=robot))
    arguments = ["--quick", "-o", str(tmp_path)]
    assert study.main(arguments) == 0
    assert "all causes" in capsys.readouterr().out
    with (tmp_path / "systematic.csv").open(encoding="utf-8") as file:
        (line,) = csv.DictReader(file)
    counts = {name: float(line[name]) for name in (STANDARD_ERROR, "static friction", ALL_CAUSES)}
    assert counts[STANDARD_ERROR] <= counts["static friction"] <= counts[ALL_CAUSES] <= 43
    assert float(line["times as wide"]) >= 1.0
    with (tmp_path / "worst.csv").open(encoding="utf-8") as file:
        off = [abs(float(entry["error [standard errors]"])) for entry in csv.DictReader(file)]
    assert len(off) == 6 and np.all(np.diff(off) <= 0.0)
    monkeypatch.setattr(study, "identified", lambda *_: pytest.fail("a finished row was repeated"))
    assert study.main(arguments) == 0


TRAINING = sim.training


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--recordings", "0"], "--recordings is 0; expected 1 or more"),
        (["--level", "1"], "--level is 1.0; expected more than 0 and less than 1"),
    ],
)
def test_wrong_options(
    capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    with pytest.raises(SystemExit):
        study.main(arguments)
    assert message in capsys.readouterr().err

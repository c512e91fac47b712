"""The disturbance budget: which measures a case has, a tiny run, and one that goes on."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import sim
from scripts.studies.disturbances import budget
from scripts.studies.disturbances.fits import rigid_patterns
from scripts.studies.disturbances.measures import (
    AGAINST,
    ALL,
    OFF,
    ON,
    Line,
    Measures,
    network_of,
    true_coefficients,
    variants,
)
from scripts.studies.disturbances.summary import FIGURES, Summary


def test_every_disturbance_has_a_measure_that_is_switched_off_alone() -> None:
    assert set(AGAINST) == set(sim.DISTURBANCES)
    for case, measure in AGAINST.items():
        on, off = (vars(variants(case)[name]) for name in (ON, OFF))
        assert {field for field in on if on[field] != off[field]} == {measure}
        assert on[measure]


def test_all_together_have_the_same_coefficients() -> None:
    of_all = variants(ALL)
    assert len({measures.network_terms() for measures in of_all.values()}) == 1
    assert not any(vars(of_all[OFF]).values())


def test_the_true_coefficients_leave_nothing_undisturbed() -> None:
    machine = sim.undisturbed(sim.puma560())
    performed = sim.simulate(machine, sim.comparison(), seed=1)
    patterns = rigid_patterns(performed, machine)
    network = network_of(Measures())
    k = true_coefficients(network, machine)
    torque = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    error = np.abs(torque - patterns.torque)[np.asarray(patterns.mask)]
    # Within a step of a stop, friction is whatever stops the joint: few pairs of many.
    assert np.median(error) < 1e-9


def test_the_gain_and_its_confidence() -> None:
    """Differences 1, 2 and 3: mean 2, and 4.303 (t of two degrees of freedom) times 1/√3."""
    line = Line("case", "case", "measure", OFF)
    off, on = np.array([2.0, 4.0, 6.0]), np.array([1.0, 2.0, 3.0])
    gain, half = Summary(line, "epsilon", off, on, 0.0).gain()
    assert gain == pytest.approx(2.0)
    assert half == pytest.approx(4.302653 / np.sqrt(3.0), rel=1e-6)


def test_a_tiny_run_and_one_that_goes_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(budget, "choose_spacing", lambda *_, **__: (17,) * 6)
    folder = tmp_path / "budget"
    tiny = ["-o", str(folder), "--cases", "quantisation", "--samples", "600"]
    assert budget.main([*tiny, "--seeds", "1"]) == 0
    rows = folder / "rows.jsonl"
    first = rows.read_text(encoding="utf-8")
    with rows.open("a", encoding="utf-8") as file:
        file.write('{"case": "quantisation", "se')  # interrupted while writing
    assert budget.main([*tiny, "--seeds", "2"]) == 0
    printed = capsys.readouterr().out
    assert "counter-measure" in printed and "gain, 95 % confidence" in printed

    after = rows.read_text(encoding="utf-8")
    assert after.startswith(first)
    rows_made = [json.loads(line) for line in after.splitlines()]
    assert [row["seed"] for row in rows_made] == [0, 1]
    for row in rows_made:
        fits = row["fits"]
        for figure in FIGURES:
            assert 0.0 < fits[ON][figure] < fits[OFF][figure]
    with (folder / "summary.csv").open(encoding="utf-8") as file:
        summary = list(csv.DictReader(file))
    assert [(row["figure"], row["seeds"]) for row in summary] == [
        (quantity, "2") for quantity in FIGURES.values()
    ]
    mean = np.mean([row["fits"][ON]["epsilon"] for row in rows_made])
    assert float(summary[0]["on mean"]) == pytest.approx(mean)
    for figure in FIGURES:
        assert (folder / f"{figure}.png").stat().st_size > 10_000

    # All there: nothing is simulated again, and the rows stay as they are.
    monkeypatch.setattr(budget.sim, "record_each", lambda jobs: iter(()) if not jobs else 1 / 0)
    monkeypatch.setattr("scripts.studies.disturbances.summary.save_picture", lambda *_: None)
    assert budget.main([*tiny, "--seeds", "2"]) == 0
    assert rows.read_text(encoding="utf-8") == after


def test_an_unknown_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        budget.main(["-o", str(tmp_path / "out"), "--cases", "rust"])
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert "no case is called 'rust'; expected some of undisturbed, quantisation" in last
    assert not (tmp_path / "out").exists()

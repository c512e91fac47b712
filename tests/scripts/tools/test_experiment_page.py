"""docs/experiment.md says what the stored tables of the experiment say."""

import re
from pathlib import Path

import pytest

from scripts.tools.thesis import experiment_page, results


ROOT = Path(__file__).parents[3]


def test_the_page_is_what_the_tables_say() -> None:
    written = (ROOT / "docs" / "experiment.md").read_text(encoding="utf-8")
    advice = "docs/experiment.md is out of date: run scripts/tools/thesis/experiment_page.py"
    assert written == experiment_page.page(), advice


def test_every_cell_is_a_stored_number() -> None:
    page = experiment_page.page()
    cells = {cell.strip() for cell in re.findall(r"(?<=\|)[^|\n]+(?=\|)", page)}
    for row in results.rows("demo", "errors_a.csv"):
        assert all(f"{float(row[name]):.4g}" in cells for name in ("Ar+LS", "Ar+Rg"))


@pytest.mark.parametrize("letter", ["a", "b"])
def test_what_the_page_says_in_words(letter: str) -> None:
    """Sentences that hold of the stored run, and that another run could make wrong."""
    errors = {row[""]: row for row in results.rows("demo", f"errors_{letter}.csv")}
    epsilon = {model: float(value) for model, value in errors["mean ε"].items() if model}
    measured = min(epsilon["Ar+LS"], epsilon["Ar+Rg"])
    assert max(epsilon[name] for name in ("true", "CSLC", "CSLC solved", "CSLC trained")) < measured
    trained = {row["coefficients"]: row for row in results.rows("demo", f"training_{letter}.csv")}
    for route in ("backpropagation", "backpropagation and PERAL"):
        assert float(trained[route]["over the direct solve"]) < 1.1
        assert float(trained[route]["worst seed"]) < 1.3
        assert int(trained[route]["seeds below Ar+LS and Ar+Rg"]) == 32
    # To the letter, training ends far from the minimum.
    for row in results.rows("demo", f"letter_{letter}.csv"):
        assert row["ended"] == "no further reduction"
        assert float(row["comparison ε [N m]"]) > 5.0 * epsilon["CSLC solved"]
    hand = {row[""]: row for row in results.rows("demo", f"hand_{letter}.csv")}
    first = [float(hand[f"joint {joint}"]["CSLC trained"]) for joint in range(1, 7)]
    assert sum(first[3:]) < 0.25 * sum(first)
    *_, epsilon_row = results.rows("demo", "weak_motors.csv")
    within, beyond, left_out = (
        float(epsilon_row[name])
        for name in ("within the limits", "beyond them", "beyond them, such pairs left out")
    )
    assert 1.1 * within < beyond < 1.3 * within < left_out
    fits = {
        row["thresholds"]: float(row["comparison ε [N m]"])
        for row in results.rows("demo", f"threshold_fits_{letter}.csv")
    }
    assert all(abs(error / fits["as chosen"] - 1.0) < 0.02 for error in fits.values())
    (intervals,) = (
        row for row in results.rows("demo", "intervals.csv") if row[""] == f"PUMA {letter.upper()}"
    )
    assert int(intervals["standard error"]) < 0.9 * int(intervals["intervals"])
    assert int(intervals["all causes"]) > 0.9 * int(intervals["intervals"])
    coefficients = results.rows("demo", f"coefficients_{letter}.csv")
    truth = {row["name"]: float(row["true"]) for row in coefficients}
    for row in coefficients:
        if row["name"] in ("kv4", "kv5", "kv6"):
            assert abs(float(row["value"]) / truth[row["name"]] - 1.0) < 0.02
    outside = [
        row["name"]
        for row in coefficients
        if not float(row["low"]) <= truth[row["name"]] <= float(row["high"])
    ]
    assert outside == {"a": ["kM8"], "b": []}[letter]
    thresholds = results.rows("demo", f"thresholds_{letter}.csv")
    seen = [
        sum(row[column] == "yes" for row in thresholds)
        for column in (
            "seen in residuals",
            "seen in true friction",
            "seen without asymmetry and compliance",
        )
    ]
    assert seen[0] <= seen[1] < seen[2]
    assert all(
        float(row[f"PUMA {machine}, {name} [N m]"]) < float(row["seen to be linear up to [N m]"])
        for row in results.rows("demo", "demands.csv")
        for machine in "AB"
        for name in ("training", "comparison")
    )

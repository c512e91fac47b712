"""The control study with two machines and one short motion, its pictures, and its two checks."""

import csv
import json
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.control import checks, coefficients, study
from scripts.studies.control.pictures import (
    control_error_picture,
    joint_error_picture,
    traced_path_picture,
)
from scripts.studies.control.results import TRACKING
from scripts.studies.stored import load
from scripts.studies.truth import published_coefficients, true_coefficients


FEW = ["--seeds", "2", "--durations", "0.4", "--controllers", "PID", "computed torque"]


@pytest.fixture
def stored(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Coefficient sets without an identification; holds the numbers of seeds of all calls.

    CSLC is 1 % off the truth, and Ar+LS is the published set.
    """
    asked: list[int] = []

    def sets(network: jc.CSLC, seeds: int, samples: int) -> dict[str, np.ndarray]:
        asked.append(seeds)
        true = np.stack(
            [true_coefficients(network, coefficients.machine_of(seed)) for seed in range(seeds)]
        )
        published = published_coefficients(network)
        other = np.tile(published, (seeds, 1))
        vectors = (true, 1.01 * true, other, other, 0.9 * true)
        return dict(zip(coefficients.SETS, vectors, strict=True))

    monkeypatch.setattr(coefficients, "coefficient_sets", sets)
    return asked


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_study_writes_tables_and_pictures_and_goes_on(
    stored: list[int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("scripts.studies.stored.RESULTS", tmp_path)
    assert study.main([*FEW, "-o", str(tmp_path), "--store"]) == 0
    head, *lines = load("control").tables["tracking"]
    assert head == ["", "go-to, 0.4 s", "circle, 0.4 s"]
    assert [line[0] for line in lines] == list(TRACKING) and lines[1][1] == ""
    assert 0 < float(lines[-2][1]) < float(lines[0][1])  # CSLC, and PID
    printed = capsys.readouterr().out
    assert "2 machines, natural frequency 20 rad/s" in printed
    assert "with CSLC coefficients, over that with others" in printed
    summary = table(tmp_path / "summary.csv")
    cases = {(row["motion"], row["controller"], row["coefficients"]) for row in summary}
    assert len(cases) == len(summary) == 2 * (1 + 5)
    assert {row["seeds"] for row in summary} == {"2"} and {row["failed"] for row in summary} == {
        "0"
    }
    seeds = table(tmp_path / "seeds.csv")
    assert len(seeds) == 2 * len(summary)
    for row in seeds:  # a largest error is not below its root mean square; torques add up
        assert 0 < float(row["hand rms [mm]"]) <= float(row["hand largest [mm]"])
        by_joint = [float(row[f"joint {i} torque rms [N m]"]) for i in range(1, 7)]
        assert np.isclose(np.linalg.norm(by_joint), float(row["torque rms [N m]"]))
    over = {
        (row["CSLC over"], row["motion"]): float(row["median"])
        for row in table(tmp_path / "ratios.csv")
    }
    assert over["PID", "go-to"] < 0.5 and over["30 % wrong", "go-to"] < 1.0
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pictures == ["circle.png", "hand_errors.png", "joint_errors.png"]

    # Cut off in the middle of a line, it does again what is missing, and no more. Pictures are made
    # of all rows, as above.
    monkeypatch.setattr(study, "draw", lambda *_: None)
    kept = (tmp_path / "rows.jsonl").read_text("utf-8")
    lines = kept.splitlines(keepends=True)
    (tmp_path / "rows.jsonl").write_text("".join(lines[:-11]) + lines[-11][:40], "utf-8")
    assert study.main([*FEW, "-o", str(tmp_path)]) == 0
    assert stored == [2], "coefficients were identified again"

    def rounded(text: str) -> set[tuple[Any, ...]]:
        rows = map(json.loads, text.splitlines())
        return {
            (*map(str, list(row.values())[1:6]), round(row["hand rms [mm]"], 6)) for row in rows
        }

    assert rounded((tmp_path / "rows.jsonl").read_text("utf-8")) == rounded(kept)
    done = (tmp_path / "rows.jsonl").read_text("utf-8")
    assert study.main([*FEW, "-o", str(tmp_path)]) == 0
    assert (tmp_path / "rows.jsonl").read_text("utf-8") == done
    capsys.readouterr()


def test_the_ideal_case_is_the_response_of_the_gains(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(checks, "FINE", 2e-4)
    monkeypatch.setattr(checks, "WATCHED", 0.3)
    assert study.main(["--ideal", "-o", str(tmp_path)]) == 0
    assert "largest deviation" in capsys.readouterr().out
    for row in table(tmp_path / "ideal.csv"):
        assert float(row["largest deviation [% of first]"]) < 1.0


def test_random_motions_stay_within_bounds(
    stored: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "IN_TURN", 1)
    monkeypatch.setattr(study, "STABILITY_CASES", [("computed torque", "30 % wrong")])
    assert study.main(["--stability", "2", "--seeds", "2", "-o", str(tmp_path)]) == 0
    (row,) = table(tmp_path / "stability.csv")
    assert row["motions"] == row["without error"] == "2" and row["errors"] == "none"
    assert float(row["largest demand over limit"]) <= 1.0
    assert float(row["nearest to a range end [rad]"]) > 0.0


def test_identified_coefficients_are_of_each_machine_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = jc.Settings(solver=jc.LeastSquares(cutoff=8.0))
    selection = types.SimpleNamespace(settings=settings)  # choosing them takes a while
    monkeypatch.setattr(jc, "choose_settings", lambda network, recording: selection)
    network = jc.derive(jc.puma560())
    vectors = coefficients.stored_coefficient_sets(network, 1, 1500, tmp_path / "kept.npz")
    assert tuple(vectors) == coefficients.SETS
    true, cslc, regressed, published, wrong = (vectors[name][0] for name in coefficients.SETS)
    off = np.abs(wrong / true - 1.0)
    assert np.allclose(off, 0.3)
    rigid = slice(0, network.size - 12)
    assert np.array_equal(regressed[rigid], published[rigid])
    heavy = np.abs(true) > 5.0  # N m of gravity, dry friction
    assert np.all(np.abs(cslc[heavy] / true[heavy] - 1.0) < 0.2)
    monkeypatch.delattr(coefficients, "coefficient_sets")
    again = coefficients.stored_coefficient_sets(network, 1, 1500, tmp_path / "kept.npz")
    assert all(np.array_equal(again[name], vectors[name]) for name in coefficients.SETS)


def test_bad_options(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (
        ["--seeds", "0"], ["--durations", "0.01"], ["--controllers", "guess"],
        ["--stability", "0"], ["--damping", "-1"], ["--corner", "0"],
    ):  # fmt: skip
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err


def test_pictures_show_their_data() -> None:
    errors = {
        "PID": {"none": np.array([4.0, 5.0, 9.0])},
        "computed torque": {"truth": np.ones(3), "CSLC": np.array([1.0, 2.0, 3.0])},
    }
    figure = control_error_picture({"circle": errors}, columns=1, quantity="error [mm]")
    (axes,) = figure.axes
    assert axes.get_xscale() == "log" and axes.get_xlabel() == "error [mm]"
    drawn: dict[str, list[float]] = {".": [], "|": []}
    for line in axes.lines:
        drawn[str(line.get_marker())] += np.asarray(line.get_xdata()).tolist()
    assert sorted(drawn["|"]) == [1.0, 2.0, 5.0]  # medians
    assert sorted(drawn["."]) == [1, 1, 1, 1, 2, 3, 4, 5, 9]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["truth", "CSLC"]

    angle = np.linspace(0, 2 * np.pi, 9)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    figure = traced_path_picture(circle, {"PID": 0.1 * circle, "CSLC": 0 * circle}, magnified=10.0)
    assert np.allclose(figure.axes[0].lines[1].get_xydata(), 2 * circle)
    assert np.allclose(figure.axes[1].lines[1].get_xydata(), circle)
    assert figure.axes[0].get_title() == "PID: 0.10 mm rms in the plane"

    figure = joint_error_picture(np.arange(4.0), {"PID": np.arange(12.0).reshape(4, 3)})
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title() for axes in shown] == ["joint 1", "joint 2", "joint 3"]
    assert np.array_equal(shown[1].lines[-1].get_ydata(), [1.0, 4.0, 7.0, 10.0])

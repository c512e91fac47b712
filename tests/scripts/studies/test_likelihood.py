"""The tables of the study of maximum likelihood, from rows that are known."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from scripts.studies.likelihood import gaussian, possible_bodies, slow_reversals, study


def row(machine: object, samples: int, seed: int) -> dict[str, Any]:
    """Errors of seed standard errors in each coefficient; static friction 10 % too large."""
    del machine, samples
    kinds = {"rigid_body": 31, "viscous": 6, "dry": 6, "static": 6, "slopes": 6}
    return {
        "regression": 0.02 + 0.01 * seed,
        "likelihood": 0.003,
        "floor": 0.015,
        "seconds": 1.0,
        "steps": 20,
        "converged": True,
        "bound": {kind: [2.0 * seed] * count for kind, count in kinds.items() if kind != "slopes"},
        "reported": {kind: [float(seed)] * count for kind, count in kinds.items()},
        "inside": {kind: [seed < 2] * count for kind, count in kinds.items()},
        "static": [1.1] * 6,
        "static error": [0.05] * 6,
        "slope": [0.9] * 6,
        "slope error": [0.2] * 6,
    }


def test_tables_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[int] = []

    def counted(*arguments: Any) -> dict[str, Any]:
        calls.append(arguments[2])
        return row(*arguments)

    monkeypatch.setattr(study, "row_of", counted)
    assert study.main(["--seeds", "2", "-o", str(tmp_path)]) == 0
    assert study.main(["--seeds", "3", "-o", str(tmp_path)]) == 0
    assert calls == [0, 1, 2]
    printed = capsys.readouterr().out.split("ε [N m]")[-1]
    lines = {
        " ".join(line.split()[:-1]).split(" ")[0]: line.split()
        for line in printed.split("\n")
        if line
    }
    assert lines["regression,"][-3:] == ["0.0300", "0.0200", "0.0400"]
    # Seeds 0, 1 and 2: the root of the mean of 0, 1 and 4; two of three inside.
    spread = np.sqrt(5 / 3)
    assert lines["viscous"][1:4] == [f"{2 * spread:.2f}", f"{spread:.2f}", "66.7"]
    assert lines["slopes"][1:4] == ["nan", f"{spread:.2f}", "66.7"]
    assert lines["6"][1:] == ["1.100", "10.0", "%", "5.0", "%", "0.900", "10.0", "%", "20.0", "%"]
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert sum("seed" in row for row in rows) == 3


def test_bad_options(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--seeds", "0"], ["--samples", "20"], ["--time-step", "0"]):
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err


def test_table_of_normally_distributed_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def deviating(*arguments: Any) -> dict[str, Any]:
        noise, seed = arguments[2:4]
        values = {"torque": 100 * noise, "deviation": float(seed), "inside": 0.95}
        return {**values, "converged": True}

    monkeypatch.setattr(gaussian, "row_of", deviating)
    monkeypatch.setattr(gaussian, "exact_error", lambda *_: (5e-7, True))
    assert gaussian.main(["--seeds", "2", "--first", "3", "-o", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.split("\n")
    worst = [line.split() for line in lines if line.startswith(("1e-05", "0.0001"))]
    # Root mean square of 3 and 4.
    assert worst[0][2:] == ["0.00100"] * 3 + ["3.54", "95.0", "%", "2", "of", "2"]
    assert worst[1][2:5] == ["0.01000"] * 3
    assert any(line.startswith("exact model") and "5.0e-07" in line for line in lines)


def test_motion_and_its_derivatives() -> None:
    motion = gaussian.random_motion(1, 400, 2)
    for values, derivative in ((motion.q, motion.qd), (motion.qd, motion.qdd)):
        slope = np.gradient(values, motion.time, axis=0)[1:-1]
        np.testing.assert_allclose(slope, derivative[1:-1], atol=2e-3 * np.abs(derivative).max())


def test_table_of_slow_reversals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def deviating(*arguments: Any) -> dict[str, Any]:
        machine, samples, _, seed = arguments
        values = {
            name: value for name, value in row(machine, samples, seed).items() if "st" in name
        }
        inside = {"magnitudes inside": [seed < 1] * 6, "slopes inside": [True] * 6}
        slopes = {"slope": [0.9] * 6, "slope error": [0.2] * 6}
        return {**values, **slopes, **inside, "all inside": 0.95, "converged": True}

    monkeypatch.setattr(slow_reversals, "row_of", deviating)
    assert slow_reversals.main(["--seeds", "2", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "magnitudes: 50.0 % of 95 % intervals cover the truth" in printed
    assert "slopes: 100.0 %" in printed and "converged: 2 of 2" in printed


def test_swings_are_slow_and_smooth() -> None:
    """Each joint reverses at rest, and its greatest speed is a few of static friction's."""
    machine = sim.puma560()
    trajectory = slow_reversals.swings(machine, 2000)
    path = trajectory.path
    assert isinstance(path, sim.SampledPath)
    slope = np.gradient(path.q, path.interval, axis=0)[1:-1]
    np.testing.assert_allclose(slope, path.qd[1:-1], atol=1e-4)
    fastest = np.abs(path.qd).max(axis=0) / np.array(machine.static_velocity)
    np.testing.assert_allclose(fastest, slow_reversals.FASTEST, rtol=1e-3)
    np.testing.assert_allclose(path.q[0], trajectory.start)


def test_links_of_the_wrong_file_and_the_table_of_bodies() -> None:
    network = possible_bodies.network_of((1.25, 0.8))
    assert possible_bodies.network_of(None).robot.links is None
    assert network.robot.links is not None
    assert np.allclose([float(link.mass) for link in network.robot.links], [2.5, 1.2])
    k, true = (
        np.asarray(network.coefficients_from(links, viscous=possible_bodies.VISCOUS))
        for links in (network.robot.links, possible_bodies.links_of())
    )
    assert 0.1 < possible_bodies.torque_error(network, k, true) < 0.3
    q, qd, qdd = possible_bodies.motion(1.2, 300, (1.3, 2.1))
    for values, rate in ((q, qd), (qd, qdd)):
        np.testing.assert_allclose(np.gradient(values, 0.01, axis=0)[1:-1], rate[1:-1], atol=0.02)
    row = {
        "regression": 3.0,
        "without": 2.0,
        "nearest": 0.3,
        "search": 0.2,
        "moves": 3.0,
        "converged": True,
    }
    rows = [{"case": "short", "file": "none", "seed": seed, **row} for seed in range(2)]
    line = possible_bodies.table(rows)[-1]
    assert line[:2] == ["short", "none"] and line[-2:] == ["2 of 2", "2 of 2"]

"""Ways to learn static friction, on a recording that is too short for any of them."""

import csv
import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import jaxcslc as jc


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return importlib.import_module("scripts.studies.static_friction.study")


def test_rows_of_two_ways(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--seeds", "1", "--samples", "1200", "--time-step", "5e-4", "-o", str(tmp_path)]
    assert script.main([*given, "--ways", "masked", "moving pairs"]) == 0
    assert "1 seeds, exact positions" in capsys.readouterr().out
    with (tmp_path / "seeds.csv").open() as file:
        masked, moving = csv.DictReader(file)
    assert masked["way"] == "masked" and masked["slopes held"] == "nan"
    # The floor is what the true coefficients leave without static friction.
    assert 0.02 < float(moving["floor"]) < 0.035
    assert float(moving["epsilon"]) < float(masked["epsilon"])


def test_bad_options(script: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--seeds", "0"], ["--ways", "guess"], ["--time-step", "0"]):
        with pytest.raises(SystemExit):
            script.main(option)
        assert "error: " in capsys.readouterr().err


def test_windows_end_where_a_joint_rests() -> None:
    output_error = importlib.import_module("scripts.studies.static_friction.output_error")
    velocity = np.ones((200, 2))
    velocity[50:53, 0] = [0.001, -0.001, 0.001]  # turns round, and back
    velocity[120:140, 1] = 0.0  # rests
    windows = output_error.windows_of(velocity, length=60, slowest=0.005, trim=5)
    used = [rows[within] for rows, within in zip(windows.rows, windows.within, strict=True)]
    assert np.array_equal(np.concatenate(used), [*range(5, 120), *range(140, 195)])
    assert max(len(rows) for rows in used) <= 60


def test_windows_recover_a_pendulum_across_its_turns(rng: np.random.Generator) -> None:
    """Simulated with a step of its own, a hundred times finer; positions alone are given."""
    output_error = importlib.import_module("scripts.studies.static_friction.output_error")
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(robot.with_friction("viscous", "dry", "static"), lengths="numeric")
    k, slope = np.array([0.5, 0.3, 0.0, 0.2, 0.3, 0.2]), 8.0
    time = np.arange(600) * 0.002
    demand = 2.5 * np.sin(9.0 * time) + 0.5 * np.sin(23.0 * time)
    state, steps = np.array([0.3, 0.0]), 100
    q, qd = np.zeros((2, 600, 1))
    for row in range(600):
        q[row], qd[row] = state
        for _ in range(steps):
            friction = k[3] * state[1] + np.sign(state[1]) * (
                k[4] + k[5] * np.exp(-slope * abs(state[1]))
            )
            weight = 9.81 * (k[1] * np.cos(state[0]) - k[2] * np.sin(state[0]))
            state[1] += 0.002 / steps * (demand[row] - friction - weight) / k[0]
            state[0] += 0.002 / steps * state[1]
    noise = 1e-6 * rng.normal(size=q.shape)
    recording = jc.Recording(time, q + noise, demand[:, None])
    windows = output_error.windows_of(qd, length=60, slowest=0.005, trim=1)
    start = network.with_static_slopes([4.0])
    wrong = k * np.array([1.1, 0.9, 1.0, 1.1, 1.1, 0.5])
    found = output_error.fit_windows(start, wrong, recording, windows, (q, qd))
    assert np.allclose(found.slopes, slope, rtol=0.05)
    assert np.allclose(found.k, k, rtol=0.03, atol=5e-3)

"""A payload picked up, carried and put down: the task, the loops that do it, and a small run."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
import sim
from jaxcslc.control import PID, ComputedTorque, OutputFeedback, Reference
from scripts.studies.payload import study, task as tasks
from scripts.studies.payload.arms import METHODS, NOT_LEARNT, Arms
from scripts.studies.payload.bound import Equations, mass_bound
from scripts.studies.payload.errors import estimate_errors
from scripts.studies.payload.loops import KnownPayloadLoop, LoopBatch
from scripts.studies.payload.results import Tables


def test_a_batch_does_what_its_loops_do(rng: np.random.Generator) -> None:
    members = [
        OutputFeedback(PID(2, position_gain=gain, velocity_gain=1.0)) for gain in (10.0, 20.0)
    ]
    batch, q, near = LoopBatch.of(members), *rng.normal(size=(2, 2, 2))
    state = batch.begin(jnp.asarray(q))
    torque, _ = batch.step(state, Reference.at_rest(near), jnp.asarray(q), 0.002)
    for i, loop in enumerate(members):
        alone, _ = loop.step(loop.begin(q[i]), Reference.at_rest(near[i]), q[i], 0.002)
        assert_allclose(torque[i], alone)


def test_the_payload_is_known_while_it_is_there(puma: jc.CSLC, puma_k: jax.Array) -> None:
    """Against the controller of an arm that has it for ever, and of one that never has."""
    network, controller = puma.with_payload(), ComputedTorque(puma, puma_k, 20.0)
    body = jc.LinkParameters(2.0, np.array([0.02, -0.03, 0.1]), 0.005 * np.eye(3))
    loop_of_task = KnownPayloadLoop.of(controller, network, body, 0.002, 0.004)
    q, near = jnp.asarray(np.linspace(-1.0, 1.0, 6)), Reference.at_rest(np.linspace(-0.9, 1.0, 6))
    nothing = jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
    loaded = network.coefficients_from([nothing] * 6, payload=body)
    ten = loaded[network.layout.payload]
    whole = controller.with_coefficients(jnp.concatenate([puma_k, ten]), network)
    state, others = loop_of_task.begin(q), [OutputFeedback(one) for one in (controller, whole)]
    states = [loop.begin(q) for loop in others]
    for carries in (0, 1, 0):
        torque, state = loop_of_task.step(state, near, q, 0.002)
        steps = [loop.step(old, near, q, 0.002) for loop, old in zip(others, states, strict=True)]
        states = [new for _, new in steps]
        assert_allclose(torque, steps[carries][0], rtol=1e-9)
        assert not np.allclose(torque, steps[1 - carries][0], rtol=1e-3)


def test_it_stands_while_it_picks_up_and_puts_down() -> None:
    task = tasks.Task(1.0, 1.1)
    times = np.array([[task.picked], [task.placed], [task.departed], [task.arrived]])
    wanted = task.path.reference(times, np.broadcast_to(tasks.START, (4, 6)))
    assert_allclose(wanted.qd, 0.0, atol=1e-9)
    assert_allclose(wanted.q, np.stack([tasks.PICK, tasks.PLACE, tasks.PICK, tasks.PLACE]))
    assert len(task.loads) == 1
    load = task.loads[0]
    assert (load.start, load.stop) == (task.picked, task.placed)
    assert not tasks.Task(0.0, 1.1).loads
    low, high = np.array(sim.puma560().position_range).T
    for pose in (tasks.START, tasks.PICK, *tasks.VIA, tasks.PLACE):
        assert np.all((low < pose) & (pose < high))


def test_moments_count_motion_alone() -> None:
    task = tasks.Task(1.0, 1.1)
    moments = {
        name: round(float(task.time[sample] - task.departed), 3)
        for name, sample in task.moments.items()
    }
    # It stays 0.1 s at the first via point, which it reaches after 1.1 s.
    assert_allclose(
        [moments[name] for name in ("0.5 s", "1 s", "2 s")], [0.5, 1.0, 2.1], atol=0.003
    )
    assert task.time[task.moments["end"]] < task.placed


def test_estimates_against_the_truth() -> None:
    wide = np.array([1e-3, 2e-3, 3e-3])
    off = np.array([0.0, 3e-3, -1e-3])
    errors = estimate_errors("end", 2.0, 1.98, 0.03, off, wide)
    assert errors["mass error [%], end"] == pytest.approx(-1.0)
    assert (errors["mass covered, end"], errors["centre covered, end"]) == (
        1.0,
        pytest.approx(2 / 3),
    )
    assert errors["centre error [mm], end"] == pytest.approx(np.sqrt(10.0))
    unknown = estimate_errors("end", 2.0, np.nan, 0.03, np.full(3, np.nan), wide)
    assert all(np.isnan(value) for value in unknown.values())


def _performed(arms: Arms, task: tasks.Task, members: list[Any], method: str) -> Any:
    """The path itself, from a few counts beside it, and an estimate that is 1 % too heavy.

    In place of a simulation: what an arm does with such loops is a matter of `tests/payload`.
    """
    del arms
    time = task.time
    reference = task.path.reference(time[:, None], np.broadcast_to(tasks.START, (task.samples, 6)))
    off = 1e-3 if method == NOT_LEARNT else 1e-4  # rad of joint 1
    q = np.asarray(reference.q) + off * np.eye(6)[0] * (time > task.departed)[:, None]
    truth = SimpleNamespace(time=time, position=q)
    carrying = (time > task.departed + 0.3) & (time < task.left + 0.2)
    mass = np.where(carrying, 1.01 * task.body.mass, 1e-3)
    body = np.zeros((len(time), 10))
    body[:, 9], body[:, :3] = mass, 0.01 * mass[:, None]
    observed = {
        "body": body,
        "mass": mass,
        "mass_error": np.full(len(time), 0.02),
        "centre": np.broadcast_to(tasks.CENTRE + np.array([3e-3, 0.0, 4e-3]), (len(time), 3)),
        "centre_error": np.full((len(time), 3), 3e-3),
        "carrying": carrying,
        "picked_up": np.where(time > task.departed + 0.3, task.departed + 0.3, -1.0),
        "put_down": np.where(time > task.left + 0.2, task.left + 0.2, -1.0),
        "evidence": np.zeros(len(time)),
    }
    run = SimpleNamespace(truth=truth, recording=SimpleNamespace(position=q), observed=observed)
    return [run] * len(members)


def test_a_small_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arm = SimpleNamespace(machine=sim.puma560())
    monkeypatch.setattr(Arms, "_identified", lambda *_: [arm])
    monkeypatch.setattr(Arms, "run", _performed)
    options = ["--seeds", "1", "--masses", "2", "--cases", "encoders", "-o", str(tmp_path)]
    options.append("--quick")
    assert study.main([*options, "--no-film"]) == 0
    assert "1 arms: median" in capsys.readouterr().out
    with (tmp_path / "seeds.csv").open() as file:
        (row,) = list(csv.DictReader(file))
    assert float(row["least eigenvalue"]) > 0.0 and row["false alarms"] == "0"
    assert float(row["picked up"]) == pytest.approx(0.3)
    assert float(row["put down"]) == pytest.approx(0.2)
    for moment in ("0.5 s", "1 s", "2 s", "end"):
        assert float(row[f"mass error [%], {moment}"]) == pytest.approx(1.0)
        assert float(row[f"centre error [mm], {moment}"]) == pytest.approx(5.0)
        assert row[f"mass covered, {moment}"] == "1.0"
    placing_error = {method: float(row[f"place [mm], {method}"]) for method in METHODS}
    assert placing_error[NOT_LEARNT] == pytest.approx(10.0 * placing_error["learnt"], rel=1e-2)
    assert placing_error["learnt"] == pytest.approx(placing_error["known"])
    for name in ("payload", "hand"):
        assert (tmp_path / f"encoders_{name}.png").read_bytes()[:4] == b"\x89PNG"

    # What is finished is not done again, and a film that cannot be made is a line, no failure.
    def impossible(*_: object) -> None:
        raise sim.MachineError("film: no OpenGL")

    kept = (tmp_path / "rows.jsonl").read_text()
    table = Tables(json.loads(kept)["rows"]).page_table()
    assert table[:2] == [["", "quantised encoders"], ["mass after 1 s of motion [%]", "1 (1)"]]
    assert table[-3:] == [
        ["picked up, detected after [s]", "0.30"],
        ["put down, detected after [s]", "0.20"],
        ["placing error, uncompensated over compensated", "10"],
    ]
    (tmp_path / "rows.jsonl").write_text(kept + '{"case": "encoders", "half')
    monkeypatch.setattr(study, "film", impossible)
    monkeypatch.setattr(study, "draw", lambda *_: [])  # as before
    assert study.main([*options, "--film"]) == 0
    assert "no film: film: no OpenGL\n" in capsys.readouterr().err
    assert (tmp_path / "rows.jsonl").read_text().startswith(kept)


def test_bad_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = [["--seeds", "0"], ["--frequency", "0"], ["--masses", "-1"], ["--cases", "none"]]
    (tmp_path / "rows.jsonl").write_text("no row\n")
    for option in (*wrong, ["-o", str(tmp_path)]):
        with pytest.raises(SystemExit):
            study.main(option)
        assert "error: " in capsys.readouterr().err


def test_loops_differ_in_nothing_but_arrays(puma: jc.CSLC) -> None:
    """So that a program that was compiled for one payload does for the others."""
    controller, network = ComputedTorque(puma, jnp.zeros(puma.size), 20.0), puma.with_payload()
    loops = [KnownPayloadLoop.of(controller, network, None, stop) for stop in (1.0, 2.0)]
    static = [
        jax.tree_util.tree_leaves(eqx.filter(loop, eqx.is_array, inverse=True)) for loop in loops
    ]
    assert static[0] == static[1]


def test_the_bound_of_white_errors(rng: np.random.Generator) -> None:
    """Of white errors, in closed form."""
    count, joints, density = 3000, 2, np.array([0.02, 0.05])
    moving = np.ones((count, joints), bool)
    errors = np.sqrt(density / 0.02) * rng.normal(size=(count, joints))
    rows = rng.normal(size=(100, joints, 10))
    carrying = Equations(rows, np.zeros((100, joints)), moving[:100])
    deviation = np.array([0.2] * 6 + [1.0] * 3 + [5.0])
    white = np.einsum("tjx,j,tjy->xy", rows, 0.02 / density, rows) + np.diag(1 / deviation**2)
    unloaded = Equations(np.zeros((count, joints, 10)), errors, moving)
    bound = mass_bound(unloaded, carrying, 0.02)
    assert bound == pytest.approx(np.sqrt(np.linalg.inv(white)[9, 9]), rel=0.2)
    # Where a joint is slow, it says nothing.
    slow = carrying._replace(moving=np.zeros_like(carrying.moving))
    assert mass_bound(unloaded, slow, 0.02) == pytest.approx(5.0)

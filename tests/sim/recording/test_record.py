"""Many machines at once: each as if alone, saved when complete, loaded again, errors named."""

import dataclasses
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import sim
from jaxcslc.manipulator import LinkParameters
from sim.recording._record import fingerprint


@pytest.fixture(scope="module")
def jobs() -> list[sim.Job]:
    """Two trajectories, three machines, of which one has gears."""
    machine = sim.puma560()
    soft = sim.disturbed(machine)
    machines = [machine, sim.specimen(machine, 3), soft]
    trajectories = [sim.training(samples=40), dataclasses.replace(sim.comparison(), samples=30)]
    return [
        sim.Job(machine, trajectory, seed)
        for seed, machine in enumerate(machines)
        for trajectory in trajectories
    ]


@pytest.mark.parametrize("side_by_side", [1, 2, 64])
def test_a_machine_among_others_does_what_it_does_alone(jobs: list[sim.Job], side_by_side: int):
    together = sim.record(jobs, side_by_side=side_by_side)
    for job, result in zip(jobs, together, strict=True):
        alone = sim.simulate(job.machine, job.trajectory, seed=job.seed)
        assert eqx.tree_equal(alone, result)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_make_no_difference(jobs: list[sim.Job], threads: int):
    assert eqx.tree_equal(sim.record(jobs, threads=threads), sim.record(jobs))


def test_recordings_are_saved_and_loaded(jobs: list[sim.Job], tmp_path: Path):
    first = sim.record(jobs[:3], store=tmp_path / "kept")
    files = sorted((tmp_path / "kept").iterdir())
    assert len(files) == 3 and all(file.suffix == ".npz" for file in files)
    stamps = [file.stat().st_mtime_ns for file in files]
    again = sim.record(jobs, store=tmp_path / "kept")
    assert eqx.tree_equal(again[:3], first)
    assert [file.stat().st_mtime_ns for file in files] == stamps
    assert eqx.tree_equal(again, sim.record(jobs))


def test_an_interrupted_batch_keeps_what_it_finished(
    jobs: list[sim.Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Ctrl-C in the third part; the second call simulates the others only."""
    from sim.recording import _record

    parts: list[int] = []
    perform = _record.perform

    def interrupted(machines: Any, *others: Any, **named: Any) -> Any:
        if len(parts) == 2:
            raise KeyboardInterrupt
        parts.append(len(machines))
        return perform(machines, *others, **named)

    monkeypatch.setattr(_record, "perform", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sim.record(jobs, store=tmp_path, side_by_side=1)
    assert len(list(tmp_path.iterdir())) == 2

    parts.clear()
    monkeypatch.setattr(_record, "perform", lambda *a, **k: parts.append(1) or perform(*a, **k))
    assert eqx.tree_equal(sim.record(jobs, store=tmp_path, side_by_side=1), sim.record(jobs[:6]))
    assert len(list(tmp_path.iterdir())) == len(jobs)


def test_an_interruption_within_an_array_is_one(
    jobs: list[sim.Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Not the archive's complaint that it is closed too early."""

    def interrupted(*_: Any, **__: Any) -> None:
        try:
            raise KeyboardInterrupt
        finally:
            raise ValueError("Can't close the ZIP file while there is an open writing handle")

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sim.record(jobs[:1], store=tmp_path)
    assert list(tmp_path.glob("*.npz")) == []


def test_a_file_that_is_no_recording_is_named(jobs: list[sim.Job], tmp_path: Path):
    sim.record(jobs[:1], store=tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(b"not a recording")
    with pytest.raises(ValueError, match=f"{path.name}: expected a simulated recording"):
        sim.record(jobs[:1], store=tmp_path)


def test_one_machine_that_leaves_its_range_does_not_spoil_the_others(jobs: list[sim.Job]):
    narrow = dataclasses.replace(sim.puma560(), position_range=((0.39, 0.41),) + ((-9.0, 9.0),) * 5)
    trajectory = sim.training(samples=200)
    mixed = [sim.Job(sim.puma560(), trajectory, 1), sim.Job(narrow, trajectory, 2)]
    results = dict(sim.record_each(mixed))
    assert isinstance(results[1], sim.SimulationError)
    assert eqx.tree_equal(results[0], sim.simulate(*mixed[0][:2], seed=1))
    with pytest.raises(
        sim.SimulationError, match=r"job 1, seed 2: training trajectory, .* joint 1"
    ):
        sim.record(mixed)


def test_progress_counts_every_sample(jobs: list[sim.Job], capsys: pytest.CaptureFixture[str]):
    sim.record(jobs[:2])
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"side_by_side": 0}, "side_by_side is 0; expected 1 or more"),
        ({"threads": 0}, "threads is 0; expected 1 or more"),
    ],
)
def test_wrong_options_are_refused(jobs: list[sim.Job], options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        sim.record(jobs, **options)


def test_names_tell_machines_trajectories_and_seeds_apart(jobs: list[sim.Job]):
    names = [fingerprint(*job, backend) for job in jobs for backend in ("mujoco", "mjx")]
    names += [fingerprint(*job._replace(seed=job.seed + 100)) for job in jobs]
    assert len(set(names)) == len(names)
    rebuilt = sim.Job(sim.disturbed(sim.puma560()), sim.training(samples=40), 2)
    assert fingerprint(*rebuilt) == fingerprint(*jobs[4])
    with pytest.raises(TypeError, match="no name for a function"):
        fingerprint(lambda: None)
    assert len({fingerprint(x) for x in (1, 1.0, "1", True, (1,), np.array(1), None)}) == 7


def test_loads_and_faults_are_part_of_a_name_and_of_what_is_kept(tmp_path: Path):
    plain = dataclasses.replace(sim.comparison(), samples=20)
    ball = LinkParameters(1.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    fault = sim.Fault("stuck encoder", 1, 0.01)
    trajectories = [
        plain,
        dataclasses.replace(plain, loads=(sim.Load(0.01, ball),)),
        dataclasses.replace(plain, loads=(sim.Load(0.012, ball),)),
        dataclasses.replace(plain, faults=(fault,)),
    ]
    jobs = [sim.Job(sim.puma560(), trajectory) for trajectory in trajectories]
    assert len({fingerprint(*job) for job in jobs}) == 4
    made = sim.record(jobs, store=tmp_path)
    assert eqx.tree_equal(sim.record(jobs, store=tmp_path), made)
    assert made[1].truth.carried[[4, 5]].tolist() == [0.0, 1.0]


def test_machines_side_by_side_must_be_alike():
    machines = [sim.puma560(), sim.disturbed(sim.puma560())]
    with pytest.raises(sim.MachineError, match="machines of a plant differ"):
        sim.Plant(machines, np.zeros((2, 6)), interval=0.002)

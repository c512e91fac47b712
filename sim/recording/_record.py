from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from tqdm import tqdm

from jaxcslc._environment import require
from jaxcslc._scratch import remove_left_behind
from sim.engine._plan import structure
from sim.engine._simulate import SimulationError, perform, thread_count
from sim.engine._truth import SimulatedRecording
from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.recording._fingerprint import fingerprint
from sim.recording._store import load, save
from sim.trajectory._trajectories import Trajectory


Backend = Literal["mujoco", "mjx"]

# How many machines are simulated side by side. A few dozen keep two cores busy and lose little when
# interrupted; a GPU is fastest with many, and compiles again for another number.
_SIDE_BY_SIDE = {"mujoco": 64, "mjx": 1024}


class Job(NamedTuple):
    """A recording to be made."""

    machine: Machine
    trajectory: Trajectory
    seed: int = 0


def record(
    jobs: Sequence[Job],
    *,
    backend: Backend = "mujoco",
    store: Path | str | None = None,
    threads: int | None = None,
    side_by_side: int | None = None,
    progress: bool = False,
) -> list[SimulatedRecording]:
    """Makes many recordings: hundreds of seeds, machines and levels of disturbance in one call.

    Each equals the result of `simulate` for the same machine, trajectory and seed, bit for bit with
    C MuJoCo (`"mujoco"`), which steps machines side by side on all cores; to rounding under MJX
    (`"mjx"`), which steps them on JAX's default device, a GPU where there is one. Recordings of
    one `Trajectory` object are simulated together, so make that object once.

    **Arguments**

    - `jobs`: what to record.
    - `backend`: `"mujoco"` or `"mjx"`.
    - `store`: a folder, made if missing, to which each recording is saved once it is complete.
        Saved recordings are not simulated again: an interrupted call resumes.
    - `threads`: of C MuJoCo; as many as the process has cores, if omitted.
    - `side_by_side`: how many machines at a time; 64 or, under MJX, 1024 if omitted.
    - `progress`: show a progress bar on standard error.

    **Returns**

    Recording and truth of each job, in their order. A thousand training recordings take 2.3 GB:
    see `record_each` to look at them one after the other.

    **Raises**

    - `MachineError`: a machine or trajectory that cannot exist; before anything runs.
    - `SimulationError`: a joint leaves its range; after the other jobs have been recorded.

    >>> import sim
    >>> trajectory = sim.training(samples=20)
    >>> jobs = [sim.Job(sim.specimen(sim.puma560(), seed), trajectory, seed) for seed in range(3)]
    >>> len(sim.record(jobs))
    3
    """
    results: list[SimulatedRecording | None] = [None] * len(jobs)
    wrong: list[tuple[int, SimulationError]] = []
    for i, result in record_each(
        jobs,
        backend=backend,
        store=store,
        threads=threads,
        side_by_side=side_by_side,
        progress=progress,
    ):
        if isinstance(result, SimulationError):
            wrong.append((i, result))
        else:
            results[i] = result
    if wrong:
        i, error = min(wrong, key=lambda entry: entry[0])
        more = f" (and {len(wrong) - 1} jobs more)" if len(wrong) > 1 else ""
        raise SimulationError(f"job {i}, seed {jobs[i].seed}: {error}{more}")
    return [result for result in results if result is not None]


def record_each(
    jobs: Sequence[Job],
    *,
    backend: Backend = "mujoco",
    store: Path | str | None = None,
    threads: int | None = None,
    side_by_side: int | None = None,
    progress: bool = False,
) -> Iterator[tuple[int, SimulatedRecording | SimulationError]]:
    """As `record`, but yields each recording as soon as it is complete.

    **Arguments**

    - as for `record`.

    **Returns**

    An iterator of pairs: the job's number, counted from 0, and its recording and truth or the
    error that ended it. In the order in which they are made.

    **Raises**

    - `MachineError`: as `record`, with the number of the job.
    """
    if backend not in _SIDE_BY_SIDE:
        raise ValueError(f"backend is {backend!r}; expected 'mujoco' or 'mjx'")
    size = _SIDE_BY_SIDE[backend] if side_by_side is None else side_by_side
    if size < 1:
        raise ValueError(f"side_by_side is {size}; expected 1 or more")
    run = _runner(backend, threads)
    folder = None if store is None else Path(store)
    if folder is not None:
        remove_left_behind(folder)
    names = [""] * len(jobs) if folder is None else [_name(job, backend) for job in jobs]
    with tqdm(
        total=sum(job.trajectory.samples for job in jobs),
        desc="recording",
        unit=" samples",
        unit_scale=True,
        disable=None if progress else True,
    ) as bar:
        groups: dict[tuple[object, ...], list[int]] = {}
        for i, job in enumerate(jobs):
            kept = None if folder is None else load(folder, names[i])
            if kept is None:
                key = (id(job.trajectory), *structure(job.machine))
                groups.setdefault(key, []).append(i)
            else:
                bar.update(job.trajectory.samples)
                yield i, kept
        for group in groups.values():
            for start in range(0, len(group), size):
                part = group[start : start + size]
                # MJX compiles for a number of machines: fill the last part up.
                padding = size - len(part) if backend == "mjx" and len(group) > size else 0
                padded = [jobs[i] for i in (*part, *[part[-1]] * padding)]
                results = run(padded, bar.update)[: len(part)]
                for i, result in zip(part, results, strict=True):
                    if folder is not None and not isinstance(result, SimulationError):
                        save(folder, names[i], result)
                    yield i, result


def _runner(
    backend: Backend, threads: int | None
) -> Callable[[list[Job], Callable[[int], object]], Sequence[SimulatedRecording | SimulationError]]:
    if backend == "mjx":
        require("mujoco.mjx", "mjx")
        from sim.engine._mjx import perform_mjx

        return lambda jobs, advanced: perform_mjx(
            [job.machine for job in jobs],
            jobs[0].trajectory,
            [job.seed for job in jobs],
            advanced=advanced,
        )
    thread_count(threads, 1)  # raises before anything runs
    return lambda jobs, advanced: perform(
        [job.machine for job in jobs],
        jobs[0].trajectory,
        [job.seed for job in jobs],
        threads=thread_count(threads, len(jobs)),
        advanced=advanced,
    )


def _name(job: Job, backend: Backend) -> str:
    try:
        return fingerprint(*job, backend)
    except TypeError as error:
        raise MachineError(
            f"a store cannot name trajectory {job.trajectory.name!r}: {error}"
        ) from error

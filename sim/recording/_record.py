"""Many recordings in one call, and their files.

A file is named by the content of machine, trajectory and seed.
"""

import dataclasses
import hashlib
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from tqdm import tqdm

from jaxcslc._environment import require
from jaxcslc._scratch import remove_left_behind, unfinished
from jaxcslc.recordings import Recording
from sim.engine._plan import structure
from sim.engine._simulate import SimulatedRecording, SimulationError, Truth, perform, thread_count
from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.trajectory._trajectories import Trajectory


def fingerprint(*values: Any) -> str:
    """A hash of the content of values: equal values have the same hash in every process.

    It names the file of a recording by its machine, trajectory and seed.

    **Arguments**

    - `values`: numbers, text, arrays, and sequences, mappings and dataclasses of them.

    **Returns**

    Forty hexadecimal digits.

    **Raises** `TypeError`: a value of another type.

    >>> import sim
    >>> from sim.recording._record import fingerprint
    >>> fingerprint(sim.puma560(), 1) == fingerprint(sim.puma560(), 1)
    True
    >>> fingerprint(sim.puma560(), 1) == fingerprint(sim.puma560(), 2)
    False
    """
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()[:40]


def _parts(value: Any) -> list[bytes]:
    kind = type(value).__qualname__.encode()
    if value is None or isinstance(value, (bool, int, str, Fraction)):
        return [kind, str(value).encode()]
    if isinstance(value, float):
        return [b"float", (b"nan" if math.isnan(value) else value.hex().encode())]
    if isinstance(value, Enum):
        return [kind, value.name.encode()]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
        return [kind, *_parts(fields)]
    if isinstance(value, Mapping):
        return [b"mapping", *_parts(sorted(value.items()))]
    if isinstance(value, Sequence):
        return [b"sequence", str(len(value)).encode(), *(p for item in value for p in _parts(item))]
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        if array.dtype == object:
            raise TypeError(f"no name for an array of {type(array.flat[0]).__name__}")
        return [str((array.dtype.str, array.shape)).encode(), array.tobytes()]
    raise TypeError(f"no name for a {type(value).__name__}; expected numbers, text or dataclasses")


def save(folder: Path, name: str, result: SimulatedRecording) -> None:
    """Saves a recording and its truth as `folder/name.npz`; atomic if interrupted.

    **Arguments**

    - `folder`: made if missing.
    - `name`: of the file, without its ending.
    - `result`: recording and truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = {
        field.name: getattr(result.truth, field.name)
        for field in dataclasses.fields(result.truth)
        if field.name != "time"
    }
    with unfinished(folder / f"{name}.npz", clean=False) as path:
        try:
            np.savez(
                path,
                time=result.recording.time,
                reading=result.recording.position,
                demand=result.recording.torque,
                **truth,
            )
        except ValueError as error:
            # Interrupted within an array, the archive complains of it as it is closed.
            if isinstance(error.__context__, KeyboardInterrupt):
                raise error.__context__ from None
            raise


def load(folder: Path, name: str) -> SimulatedRecording | None:
    """The recording that `save` saved under a name, or None.

    **Raises** `ValueError`: a file that `save` did not write.
    """
    path = folder / f"{name}.npz"
    if not path.exists():
        return None
    try:
        with np.load(path) as file:
            values = {key: file[key] for key in file.files}
        time = values.pop("time")
        recording = Recording(time, values.pop("reading"), values.pop("demand"))
        return SimulatedRecording(recording, Truth(time=time, **values))
    except (KeyError, TypeError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{path}: expected a simulated recording; delete it to continue"
        ) from error


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
    """Yield each recording of `record` as soon as it is complete.

    **Arguments**

    - as for `record`.

    **Returns** an iterator of pairs: the job's number, counted from 0, and its recording and truth
    or the error that ended it. In the order in which they are made.

    **Raises** `MachineError`: as `record`, with the number of the job.
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
        parts = [
            (group[start : start + size], len(group) > size)
            for group in groups.values()
            for start in range(0, len(group), size)
        ]
        for part, is_one_of_several in parts:
            # MJX compiles for a number of machines: fill the last part up.
            padding = size - len(part) if backend == "mjx" and is_one_of_several else 0
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

"""Fits of many files on the workers of a Dask cluster: of all together, or of each.

Workers derive the network again and return triangular factors (`_factors`, `_streaming`).
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from .._environment import require, require_float64
from .._scratch import unfinished
from .._text_table import csv_line
from ..manipulator import Manipulator, Mimic
from ..network import CSLC, RigidBodyTables, derive
from ..recordings import Patterns, Recording, iterate_recording, load_recording
from ._blocks import are_many, blocks_of_chunks, factors_of_blocks
from ._factors import JointFactors, joined_factors
from ._identification import Identification, result_of
from ._least_squares import LeastSquares
from ._settings import Settings


@dataclasses.dataclass(frozen=True)
class Derivation:
    """Recipe to derive a network again, sent to another process instead of the network.

    A network's tables are megabytes, and deriving them takes a second once in a process.

    **Attributes**

    - `robot`, `lengths`, `evaluator`: arguments of `derive`.
    - `mimics`: the laws of joints that follow others, in which equal robots may differ.
    - `link`: that carries a payload with coefficients of its own, or None.
    - `slopes`: of static friction, as nested tuples, or None.
    """

    robot: Manipulator
    mimics: tuple[Mimic, ...]
    lengths: str | tuple[str, ...]
    evaluator: str
    link: int | None
    slopes: tuple[tuple[float, ...], ...] | tuple[float, ...] | None

    @classmethod
    def of(cls, network: CSLC) -> "Derivation":
        """Return the derivation of a network."""
        slopes = network.static_slopes
        return cls(
            robot=network.robot,
            mimics=() if network.robot.source is None else network.robot.source.mimics,
            lengths=network.algebra.lengths,
            evaluator="tables" if isinstance(network.rigid_body, RigidBodyTables) else "recursive",
            link=None if network.payload is None else network.carrying_link,
            slopes=None if slopes is None else _nested(np.asarray(slopes)),
        )


@lru_cache(maxsize=16)
def derived(derivation: Derivation) -> CSLC:
    """The network of a derivation, derived once in a process."""
    lengths, evaluator = cast(Any, derivation.lengths), cast(Any, derivation.evaluator)
    network = derive(derivation.robot, lengths=lengths, evaluator=evaluator)
    if derivation.link is not None:
        network = network.with_payload(derivation.link)
    if derivation.slopes is not None:
        network = network.with_static_slopes(np.array(derivation.slopes))
    return network


def _nested(values: np.ndarray) -> tuple[float, ...] | tuple[tuple[float, ...], ...]:
    if values.ndim == 1:
        return tuple(values.tolist())
    return tuple(tuple(row) for row in values.tolist())


@dataclasses.dataclass(frozen=True)
class Work:
    """Work that is done with every file.

    **Attributes**

    - `derivation`: of the network.
    - `settings`: of preparation and fit; None uses velocities and accelerations of the files as
      they are, a part of a file at a time.
    - `read`: a function from a path to a recording, or None for `load_recording`.
    """

    derivation: Derivation
    settings: Settings | None
    read: Callable[[Path], Recording] | None = None


def block_factors(path: str, work: Work) -> JointFactors:
    """Compute the factors of the equations of one file, in float64, as a worker of a cluster."""
    with jax.enable_x64(True):  # a worker's process is the cluster's: nobody has set it up
        return _block_factors(path, work)


def _block_factors(path: str, work: Work) -> JointFactors:
    network = derived(work.derivation)
    if work.settings is None:
        chunks: Iterable[Patterns] = _patterns_as_recorded(path, network)
    else:
        recording = load_recording(path) if work.read is None else work.read(Path(path))
        patterns, solver = work.settings.patterns(recording), work.settings.solver
        if solver.cutoff is not None or not are_many(patterns):
            return solver.equations(network, patterns).factors()
        chunks = [patterns]
    return factors_of_blocks(network, blocks_of_chunks(network, chunks, workers=1))


def _patterns_as_recorded(path: str, network: CSLC) -> Iterator[Patterns]:
    # Rows of a file that are read at once.
    for chunk in iterate_recording(path, 1 << 16, joints=network.output_names):
        if chunk.velocity is None or chunk.acceleration is None:
            raise ValueError(
                f"{path}: has no velocities and accelerations; expected both, or settings that"
                " say how to compute them"
            )
        everything = np.ones(chunk.position.shape, bool)
        motion = chunk.position, chunk.velocity, chunk.acceleration
        yield Patterns(chunk.time, *motion, chunk.torque, everything, everything)


def fit_on_cluster(
    network: CSLC,
    paths: Sequence[Path | str],
    settings: Settings | None = None,
    *,
    client: Any = None,
    read: Callable[[Path], Recording] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Fit the recordings of many files together, on the workers of a Dask cluster.

    A worker reads, prepares and factorises a file; its triangles, some kilobytes, are all that
    travels. They are joined in the order of the files, so that the fit is the same whichever
    worker took which file and when. A file whose worker is lost is computed again by another one.

    **Arguments**

    - `network`: n joints, p coefficients. Workers derive it for themselves.
    - `paths`: of recordings that workers can read, of any sampling; together of any size.
    - `settings`: of preparation and fit, for all files. If None, velocities and accelerations are
      taken from the files as they are, a part of a file at a time: files larger than a worker's
      memory.
    - `client`: a `distributed.Client`; a cluster of this machine's cores, for this call, if None.
    - `read`: a function from a path to a recording, `load_recording` if None.
    - `progress`: is called with a few words whenever a file is done.

    **Returns** an `Identification`. Its standard errors are for independent noise: no worker sees
    two files. For noise that is correlated in time, as after smoothing, compare fits of parts
    (`fit_fleet_on_cluster`).

    **Raises**

    - `ValueError`: no files; settings with a robust loss, which would need to see all residuals.
    - `RecordingError`: a file that cannot be used.
    - `RuntimeError`: as `LeastSquares.fit`.
    - `ImportError`: without the extra `cluster`.

    >>> import jaxcslc as jc, pathlib, tempfile
    >>> from distributed import Client
    >>> network = jc.derive(jc.examples.turntable())
    >>> motion = jc.examples.swing(network, [0.5, 0.2, 0.05])
    >>> recording = jc.Recording(motion.time, motion.q, motion.torque, motion.qd, motion.qdd)
    >>> options = {"processes": False, "n_workers": 1, "dashboard_address": ":0"}
    >>> with tempfile.TemporaryDirectory() as folder, Client(**options) as client:
    ...     paths = [pathlib.Path(folder) / f"{part}.parquet" for part in range(2)]
    ...     for start, path in zip((0.0, 5.0), paths):
    ...         jc.save_recording(recording.between(start, start + 5.0), path)
    ...     fit = jc.least_squares.fit_on_cluster(network, paths, client=client)
    >>> fit.k.round(6).tolist()
    [0.5, 0.2, 0.05]
    """
    factors = _factors_of_files(network, paths, settings, client, read, progress)
    solver = _solver(settings)
    return solver.fit_factors(network, joined_factors(list(factors.values())))


def fit_fleet_on_cluster(
    network: CSLC,
    paths: Sequence[Path | str],
    settings: Settings | None = None,
    *,
    client: Any = None,
    read: Callable[[Path], Recording] | None = None,
    progress: Callable[[str], None] | None = None,
) -> "Fleet":
    """Fit each file by itself, on the workers of a Dask cluster: one robot or one day per file.

    **Arguments** and **Raises** as `fit_on_cluster`; a file that does not determine its
    coefficients, or is not finite, has a `result` that says so.

    **Returns** a `Fleet`.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable())
    >>> jc.least_squares.fit_fleet_on_cluster(network, [])
    Traceback (most recent call last):
    ...
    ValueError: there are no files to fit; expected one or more
    """
    factors = _factors_of_files(network, paths, settings, client, read, progress)
    solver = _solver(settings)
    return Fleet(
        {
            path: solver.fit_factors(network, of_file, throw=False)
            for path, of_file in factors.items()
        }
    )


@dataclasses.dataclass(frozen=True)
class Fleet:
    """Identifications of many files.

    **Attributes**

    - `fits`: by the file's path, in the order of the files.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable())
    >>> fit = jc.LeastSquares().fit(network, jc.examples.swing(network, [0.5, 0.2, 0.05]))
    >>> fleet = jc.least_squares.Fleet({"monday": fit, "tuesday": fit})
    >>> fleet.to_pandas().shape, fleet.to_pandas().loc["monday"].index[:2].tolist()
    ((2, 9), ['result', 'rank'])
    """

    fits: Mapping[str, Identification]

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per file: result, rank, condition, and each coefficient with its standard
        error.
        """
        return [
            {
                "file": path,
                "result": result_of(fit),
                "rank": int(fit.rank),
                "condition": float(fit.condition),
                **dict(zip(fit.names, np.asarray(fit.k).tolist(), strict=True)),
                **{
                    f"{name} standard error": error
                    for name, error in zip(
                        fit.names, np.asarray(fit.standard_error).tolist(), strict=True
                    )
                },
            }
            for path, fit in self.fits.items()
        ]

    def to_pandas(self) -> Any:
        """Return the rows as a `pandas.DataFrame`, indexed by file."""
        pandas = require("pandas", "tables")
        return pandas.DataFrame(self.rows()).set_index("file")

    def save(self, path: Path | str) -> None:
        """Writes the rows as CSV, numbers in full precision."""
        rows = self.rows()
        lines = [list(rows[0]), *([*row.values()] for row in rows)] if rows else []
        with (
            unfinished(Path(path)) as file,
            file.open("w", newline="", encoding="utf-8", errors="backslashreplace") as text,
        ):
            text.writelines(f"{csv_line(line)}\r\n" for line in lines)


def _solver(settings: Settings | None) -> LeastSquares:
    if settings is None:
        return LeastSquares(errors="independent")
    # A cut-off has filtered the equations already, on the workers.
    return dataclasses.replace(settings.solver, errors="independent", cutoff=None)


def _factors_of_files(
    network: CSLC,
    paths: Sequence[Path | str],
    settings: Settings | None,
    client: Any,
    read: Callable[[Path], Recording] | None,
    progress: Callable[[str], None] | None,
) -> dict[str, JointFactors]:
    """The factors of each file, in the order of the files."""
    if not paths:
        raise ValueError("there are no files to fit; expected one or more")
    if settings is not None and settings.solver.loss != "squared":
        raise ValueError(
            "a cluster reads every file once (--dask): expected loss 'squared', got"
            f" {settings.solver.loss!r}"
        )
    require_float64()
    work = Work(Derivation.of(network), settings, read)
    # Workers may have another working directory.
    names = [str(Path(path).absolute()) for path in paths]
    distributed = require("distributed", "cluster")
    with _client_or_local(distributed, client) as cluster:
        # Times that a file is tried again when a worker has failed on it, as by being killed.
        futures = cluster.map(
            block_factors, names, work=work, retries=2, pure=False, key="factorise"
        )
        order = {future.key: index for index, future in enumerate(futures)}
        factors: dict[int, JointFactors] = {}
        for future, result in distributed.as_completed(futures, with_results=True):
            factors[order[future.key]] = result
            if progress is not None:
                progress(f"{len(factors)} of {len(futures)} files")
    return {str(path): factors[index] for index, path in enumerate(paths)}


@contextlib.contextmanager
def _client_or_local(distributed: Any, client: Any) -> Generator[Any]:
    """Give a client, or that of a cluster of this machine's cores: processes of one thread.

    A scheduler runs the code that it is sent. That of this machine's cores listens to the machine
    itself alone, and only to whoever has the key of its certificate (`cryptography` makes it).
    """
    if client is not None:
        yield client
        return
    # One thread a worker: several that all use all cores would wait for each other.
    environment = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PJRT_NPROC"), "1")
    with (
        distributed.LocalCluster(
            host="127.0.0.1",
            security=True,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            env={**environment, "JAX_PLATFORMS": "cpu"},
        ) as cluster,
        distributed.Client(cluster) as local,
    ):
        yield local

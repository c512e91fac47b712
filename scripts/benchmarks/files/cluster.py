"""One fit of many Parquet files on a Dask cluster: two workers of one thread over one.

    python -m scripts.benchmarks.files.cluster [--patterns 20000000] [--files 20]

Workers are processes of this machine that have computed once before they are timed. One of two is
killed in the middle of a third fit, which must give the same coefficients.
"""

import argparse
import os
import signal
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import distributed
import numpy as np

import jaxcslc as jc
from jaxcslc.least_squares import fit_on_cluster
from scripts.benchmarks.files.parquet import write_long_recording
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()

_ENVIRONMENT = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PJRT_NPROC"), "1"),
    "JAX_PLATFORMS": "cpu",
}


def metrics(patterns: int = 4_000_000, files: int = 20) -> Iterator[Metric]:
    """Rates of one worker and of two, and what a killed worker changes."""
    network = jc.derive(jc.puma560())
    with tempfile.TemporaryDirectory() as name:
        paths = [Path(name) / f"{number}.parquet" for number in range(files)]
        for number, path in enumerate(paths):
            write_long_recording(path, patterns // files, seed=number)
        rates: list[float] = []
        k: list[np.ndarray] = []
        for workers in (1, 2):
            with _cluster(workers) as client:
                fit_on_cluster(network, paths[: 2 * workers], client=client)  # compiles
                start = time.perf_counter()
                k.append(np.asarray(fit_on_cluster(network, paths, client=client).k))
                rates.append(patterns / (time.perf_counter() - start) / 1e6)
                if workers == 2:
                    killing = _killing_one(client)
                    fit = fit_on_cluster(network, paths, client=client, progress=killing)
                    k.append(np.asarray(fit.k))
    unit = "million patterns/s"
    yield Metric("cluster.one_worker", rates[0], unit, "higher")
    yield Metric("cluster.two_workers", rates[1], unit, "higher")
    yield Metric("cluster.two_over_one", rates[1] / rates[0], "", "higher", target=1.8)
    yield Metric("cluster.two_workers.difference", _difference(k[1], k[0]), "SI", "lower", 10.0)
    yield Metric("cluster.killed_worker.difference", _difference(k[2], k[0]), "SI", "lower", 10.0)


@contextmanager
def _cluster(workers: int) -> Generator[Any]:
    """A client of so many workers of one thread on this machine."""
    with (
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", env=_ENVIRONMENT
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def _killing_one(client: Any) -> Callable[[str], None]:
    """Progress that kills a worker of the client when the first file is done."""
    processes: list[int] = list(client.run(os.getpid).values())[:1]

    def progress(text: str) -> None:
        del text
        if processes:
            os.kill(processes.pop(), signal.SIGKILL)

    return progress


def _difference(k: np.ndarray, other: np.ndarray) -> float:
    """The largest of all coefficients."""
    return float(np.max(np.abs(k - other)))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--patterns", type=int, default=20_000_000)
    parser.add_argument("--files", type=int, default=20)
    options = parser.parse_args(argv)
    if options.files < 4 or options.patterns < options.files:
        parser.error("--files: expected 4 or more, and --patterns: one or more in each")
    report(list(metrics(options.patterns, options.files)), {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Peak memory and rate of a fit to a Parquet file that is longer than memory.

python -m scripts.benchmarks.files.parquet [--rows 20000000]
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
from jaxcslc.recordings import RecordingChunk, iterate_recording, save_recording
from scripts.benchmarks.direct_solve import true_coefficients
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()


def metrics(rows: int = 20_000_000) -> Iterator[Metric]:
    """Peak memory of a process that solves from a Parquet file of `rows` patterns."""
    build = Path.cwd() / "build"  # on a disk: a folder of temporary files may be in memory
    build.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=build) as name:
        path = Path(name) / "long.parquet"
        write_long_recording(path, rows)
        start = time.perf_counter()
        result = subprocess.run(
            [sys.executable, "-m", "scripts.benchmarks.files.parquet", "--stream-file", str(path)],
            check=True,
            capture_output=True,
            text=True,
        )
        seconds = time.perf_counter() - start
        peak, error = (float(x) for x in result.stdout.split())
        millions = rows / 1e6
        yield Metric(f"parquet.{millions:.0f}M.peak_memory", peak, "GB", "lower", 0.1)
        yield Metric(f"parquet.{millions:.0f}M.largest_error", error, "SI", "lower", 10.0)
        yield Metric(f"parquet.{millions:.0f}M.rate", millions / seconds, "million/s", "higher")


def write_long_recording(path: Path, rows: int, seed: int = 0) -> None:
    """A recording with velocities and accelerations, written in parts."""
    robot = jc.puma560()
    network = jc.derive(robot)
    k = true_coefficients(network)
    torque = jax.jit(network.torque)
    rng = np.random.default_rng(seed)

    def parts() -> Iterator[jc.Recording]:
        for start in range(0, rows, 262_144):
            count = min(262_144, rows - start)
            q, qd, qdd = rng.uniform(-np.pi, np.pi, (3, count, 6))
            stamps = 0.002 * np.arange(start, start + count)
            yield jc.Recording(stamps, q, np.asarray(torque(k, q, qd, qdd)), qd, qdd)

    save_recording(parts(), path)


def stream_file(path: Path) -> None:
    """Solve from a file; print the peak memory of this process [GB] and the largest error."""
    network = jc.derive(jc.puma560())

    def patterns(chunk: RecordingChunk) -> jc.Patterns:
        assert chunk.velocity is not None and chunk.acceleration is not None
        everything = np.ones(chunk.position.shape, bool)
        return jc.Patterns(
            chunk.time,
            chunk.position,
            chunk.velocity,
            chunk.acceleration,
            chunk.torque,
            everything,
            everything,
        )

    chunks = (patterns(chunk) for chunk in iterate_recording(path, chunk_rows=65_536))
    fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit_stream(network, chunks)
    error = float(jnp.max(jnp.abs(fit.k - true_coefficients(network))))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(peak, error)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rows", type=int, default=20_000_000)
    parser.add_argument("--stream-file", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.stream_file:
        stream_file(options.stream_file)
        return 0
    report(list(metrics(options.rows)), {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

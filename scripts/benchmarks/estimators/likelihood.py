"""Time and memory of `jaxcslc identify --estimator maximum-likelihood`, the whole process.

    python -m scripts.benchmarks.estimators.likelihood [--samples 3300] [--runs 2]

A PUMA 560 with static friction and encoders is simulated at 500 Hz. The first run has no compiled
program of an earlier one.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jaxcslc as jc
import sim
from scripts.benchmarks.metrics import Metric


jc.enable_x64()

_COMMAND = "from jaxcslc.cli import main; main()"


class Used(NamedTuple):
    """What a process used: wall-clock and processor time [s], and the most memory [GB]."""

    seconds: float
    processor: float
    memory: float


def identified(samples: int, runs: int) -> Iterator[Used]:
    """Return what the command uses, run by run.

    **Raises** `RuntimeError` if it fails.
    """
    machine = sim.disturbed(sim.puma560(), "static friction", "quantisation")
    recording = sim.simulate(machine, sim.training(samples=samples), seed=1).recording
    with TemporaryDirectory() as name:
        folder = Path(name)
        jc.save_recording(recording, folder / "train.csv")
        call = ["identify", "puma560", "train.csv", "-o", "out", "--friction", "viscous,dry,static"]
        call += ["--estimator", "maximum-likelihood"]
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for _ in range(runs):
            start = time.perf_counter()
            process = subprocess.Popen(
                [sys.executable, "-c", _COMMAND, *call],
                cwd=folder,
                env=environment,
                stdout=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                raise RuntimeError(f"the command ended with status {process.returncode}")
            seconds = time.perf_counter() - start
            # Kilobytes on Linux.
            yield Used(seconds, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6)


def metrics() -> Iterator[Metric]:
    """3,300 samples, a first and a later run."""
    for used, (run, target) in zip(
        identified(3300, 2), (("first", None), ("later", 5.0)), strict=True
    ):
        key = f"likelihood.3300_samples.{run}_run"
        yield Metric(key, used.seconds, "s", "lower", 0.5, target)
        yield Metric(f"{key}.processor", used.processor, "s", "lower", 0.5)


def long_metrics() -> Iterator[Metric]:
    """60,000 samples, with what an earlier run compiled."""
    *_, used = identified(60_000, 2)
    yield Metric("likelihood.60000_samples", used.seconds, "s", "lower", 0.5, 60.0)
    yield Metric("likelihood.60000_samples.processor", used.processor, "s", "lower", 0.5)
    yield Metric("likelihood.60000_samples.peak_memory", used.memory, "GB", "lower", 0.1, 2.5)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark. **Returns** the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=3300)
    parser.add_argument("--runs", type=int, default=2)
    options = parser.parse_args(arguments)
    for seconds, processor, memory in identified(options.samples, options.runs):
        print(
            f"{options.samples} samples: {seconds:.1f} s, {processor:.1f} s of processor time, at"
            f" most {memory:.2f} GB",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Time and memory of `jaxcslc identify` on a long recording of a geared 7-joint arm.

    python -m scripts.benchmarks.long_recording [--samples 600000] [--memory 2]

Pinocchio computes the torques of a motion of seven harmonics a joint at 500 Hz; motors, friction,
encoder counts and 1 % of noise are added. The command then runs in a process of its own. A run of
600,000 samples takes two to three minutes on two cores.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio
from jaxtyping import Float

from scripts.benchmarks.metrics import Metric
from scripts.studies.checks.arms import GEARED, urdf


_RATE = 500.0
_COMMAND = "from jaxcslc.cli import main; main()"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark. **Returns** the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=600_000)
    parser.add_argument("--memory", type=float, default=2.0, help="of the command [GB]")
    options = parser.parse_args(arguments)
    if options.samples < 1000:
        parser.error(f"--samples: expected 1000 or more, got {options.samples}")
    status, figures = identified(options.samples, options.memory)
    seconds, processor, peak = figures
    print(
        f"{options.samples} samples of 7 joints: {seconds:.0f} s, {processor:.0f} s of processor"
        f" time, at most {peak:.2f} GB"
    )
    return status


def metrics() -> Iterator[Metric]:
    """Time and memory of 600,000 samples."""
    _, (seconds, processor, peak) = identified(600_000, 2.0, quiet=True)
    yield Metric("identify.600000_samples", seconds, "s", "lower", 0.5, 60.0)
    yield Metric("identify.600000_samples.processor", processor, "s", "lower", 0.5)
    yield Metric("identify.600000_samples.peak_memory", peak, "GB", "lower", 0.1, 3.0)


def identified(
    samples: int, memory: float, *, quiet: bool = False
) -> tuple[int, tuple[float, float, float]]:
    """Exit status, seconds, processor seconds and peak memory [GB] of a process of its own."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(folder, samples)
        call = ["identify", "arm.urdf", "log.npz", "-o", "out", "--memory", str(memory)]
        start = time.perf_counter()
        output = subprocess.DEVNULL if quiet else None
        process = subprocess.Popen(
            [sys.executable, "-c", _COMMAND, *call], cwd=folder, stdout=output, stderr=output
        )
        # Of this process alone: a sum over all children has what compilers took before.
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - start
    processor = used.ru_utime + used.ru_stime
    return process.returncode, (seconds, processor, used.ru_maxrss / 1e6)  # kilobytes on Linux


def write_recording(folder: Path, samples: int) -> None:
    """Writes `arm.urdf` and `log.npz`."""
    (folder / "arm.urdf").write_text(urdf("geared", GEARED), encoding="utf-8")
    rng, t = np.random.default_rng(0), np.arange(samples) / _RATE
    q, qd, qdd = motion(rng, t)
    model = pinocchio.buildModelFromXML((folder / "arm.urdf").read_text(encoding="utf-8"))
    model.armature[:] = [joint.motor for joint in GEARED]
    data = model.createData()
    torque = np.stack([pinocchio.rnea(model, data, *s) for s in zip(q, qd, qdd, strict=True)])
    viscous, dry = np.array([joint.friction for joint in GEARED]).T
    torque += viscous * qd + dry * np.tanh(qd / 0.005)
    size = np.sqrt(np.mean(torque**2, axis=0))
    torque += 0.01 * size * rng.standard_normal(torque.shape)
    count = 2 * np.pi / 2**18
    np.savez(folder / "log.npz", time=t, position=count * np.floor(q / count), torque=torque)


def motion(
    rng: np.random.Generator, t: Float[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, "samples joints"], ...]:
    """Positions within the joints' limits, velocities and accelerations."""
    columns: list[np.ndarray] = []
    for joint in GEARED:
        low, high, speed, _ = joint.limits
        rate = 2 * np.pi * rng.uniform(0.03, 0.5, 7)
        size = rng.normal(size=7) / rate
        size *= 0.4 * speed / np.sum(np.abs(size * rate))
        size *= min(1.0, 0.45 * (high - low) / np.sum(np.abs(size)))
        angle = t[:, None] * rate + rng.uniform(0, 2 * np.pi, 7)
        q = (low + high) / 2 + np.sin(angle) @ size
        qd, qdd = np.cos(angle) @ (size * rate), -np.sin(angle) @ (size * rate**2)
        columns.append(np.stack([q, qd, qdd]))
    q, qd, qdd = np.stack(columns, axis=-1)
    return q, qd, qdd


if __name__ == "__main__":
    raise SystemExit(main())

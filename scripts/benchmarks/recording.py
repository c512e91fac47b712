"""Time many training recordings of the rigid plant at once: C MuJoCo's threads, or MJX on a GPU.

Prints one JSON object a line: metric, unit, direction, value. Compile and run time are apart; the
recordings are compared with C MuJoCo's before they are timed.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence

import jax
import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from scripts.benchmarks.metrics import Metric


jc.enable_x64()


def report(metric: str, unit: str, direction: str, value: float) -> None:
    """Prints one metric."""
    print(
        json.dumps({"metric": metric, "unit": unit, "direction": direction, "value": value}),
        flush=True,
    )


def disagreement(backend: str) -> float:
    """Largest difference to one recording alone in C MuJoCo, over a short stretch [rad]."""
    trajectory = sim.training(samples=50)
    jobs = [sim.Job(sim.specimen(sim.puma560(), seed), trajectory, seed) for seed in range(2)]
    together = sim.record(jobs, backend=backend)  # pyright: ignore[reportArgumentType]
    alone = [sim.simulate(*job[:2], seed=job.seed) for job in jobs]
    return max(
        float(np.abs(one.truth.position - other.truth.position).max())
        for one, other in zip(together, alone, strict=True)
    )


def metrics(machines: int = 64) -> Iterator[Metric]:
    """Recordings of one machine with every disturbance under C MuJoCo, all cores."""
    trajectory, puma = sim.training(), sim.disturbed(sim.puma560())
    jobs = [sim.Job(puma, trajectory, seed) for seed in range(machines)]
    steps = machines * (trajectory.samples - 1) * round(trajectory.sample_interval / puma.time_step)
    start = time.perf_counter()
    for _ in sim.record_each(jobs):
        pass
    rate = steps / (time.perf_counter() - start)
    yield Metric("recording.mujoco.disturbed", rate / 1e3, "thousand steps/s", "higher")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--backend", choices=["mujoco", "mjx"], default="mujoco")
    parser.add_argument("--machines", type=int, default=1000)
    parser.add_argument("--side-by-side", type=int, default=None)
    parser.add_argument("--samples", type=int, default=3300)
    parser.add_argument("--rounds", type=int, default=None, help="2 under MJX, else 1, if omitted")
    parser.add_argument("--alike", action="store_true", help="one machine, many seeds")
    parser.add_argument("--disturbed", action="store_true", help="with every disturbance")
    options = parser.parse_args(argv)

    prefix = f"recording.{options.backend}"
    report(f"{prefix}.disagreement", "rad", "lower", disagreement(options.backend))
    trajectory, puma = sim.training(samples=options.samples), sim.puma560()
    puma = sim.disturbed(puma) if options.disturbed else puma
    start = time.perf_counter()
    jobs = [
        sim.Job(puma if options.alike else sim.specimen(puma, seed), trajectory, seed)
        for seed in range(options.machines)
    ]
    report(f"{prefix}.machines", "s", "lower", time.perf_counter() - start)
    of_sample = round(trajectory.sample_interval / puma.time_step)
    steps = options.machines * (options.samples - 1) * of_sample
    rounds = options.rounds or (2 if options.backend == "mjx" else 1)
    for number in ("first", "second", "third")[:rounds] if rounds > 1 else ("only",):
        start, processor = time.perf_counter(), time.process_time()
        done = 0
        for _ in tqdm(
            sim.record_each(jobs, backend=options.backend, side_by_side=options.side_by_side),
            total=len(jobs),
            desc=f"{number} round",
            disable=None,
        ):
            done += 1
        seconds = time.perf_counter() - start
        report(f"{prefix}.{number}_round", "s", "lower", seconds)
        report(f"{prefix}.{number}_round.rate", "steps/s", "higher", steps / seconds)
        processor = 1e6 * (time.process_time() - processor) / steps
        report(f"{prefix}.{number}_round.processor", "us/step", "lower", processor)
        assert done == len(jobs)
    if options.backend == "mjx":
        device = jax.devices()[0]
        peak = (device.memory_stats() or {}).get("peak_bytes_in_use", 0)
        report(f"{prefix}.peak_memory", "GB", "lower", peak / 1e9)
        print(f"# on {device.device_kind}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

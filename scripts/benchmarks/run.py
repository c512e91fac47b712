"""Benchmarks with a committed baseline: derivation, throughput, training, commands, memory.

Every figure is a named metric with a unit and a direction. Compile and run times are apart, run
times wait for the result, and rates are beside those of Pinocchio in the same run.

    make bench                           all but the long ones, compared with the baseline
    make bench ARGS="--groups forward"   some of them
    make bench ARGS=--full               with 20 million patterns streamed from a Parquet file
    make bench ARGS=--update-baseline    make these figures the baseline
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio

import jaxcslc as jc
import sim
from jaxcslc.motion import RecordingChunk, iterate_recording, save_recording
from scripts.benchmarks.c_code import pinocchio_model
from scripts.benchmarks.control import metrics as control_metrics
from scripts.benchmarks.evaluation import metrics as evaluation_metrics
from scripts.benchmarks.metrics import Metric, best_of, report
from scripts.benchmarks.robot import metrics as robot_metrics
from scripts.benchmarks.training import training


jax.config.update("jax_enable_x64", True)

_BASELINE = Path(__file__).with_name("baseline.json")
_PATTERNS = 1_000_000


def derivation() -> Iterator[Metric]:
    """Complete tables and the network object, each in a fresh process."""
    program = (
        "import time, jax; jax.config.update('jax_enable_x64', True); import jaxcslc as jc\n"
        "robot, lengths, derive = jc.{robot}(), '{lengths}', jc.derive\n"  # loads what it needs
        "start = time.perf_counter()\n"
        "network = derive(robot, lengths=lengths); network.counts\n"
        "print(time.perf_counter() - start)"
    )
    for robot, lengths in (("puma560", "symbolic"), ("panda", "numeric")):
        code = program.format(robot=robot, lengths=lengths)
        result = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        )
        yield Metric(f"derive.{robot}", float(result.stdout), "s", "lower", 0.5)


def motion(patterns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random positions, velocities and accelerations of six joints, (patterns, 6) each."""
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-np.pi, np.pi, (3, patterns, 6))
    return q, qd, qdd


def forward(network: jc.CSLC, k: jax.Array) -> Iterator[Metric]:
    """The network's output for a batch held in memory."""
    q, qd, qdd = (jnp.asarray(x) for x in motion(_PATTERNS))
    start = time.perf_counter()
    torque = jax.jit(network.torque).lower(k, q, qd, qdd).compile()
    yield Metric("forward.compile", time.perf_counter() - start, "s", "lower", 0.5)
    seconds = best_of(lambda: torque(k, q, qd, qdd))
    yield Metric("forward.rate", _PATTERNS / seconds / 1e6, "million patterns/s", "higher")


def direct_solve(network: jc.CSLC, k: jax.Array) -> Iterator[Metric]:
    """The streaming solve from (q, qd, qdd, torque), and Pinocchio's regressor in a loop."""
    q, qd, qdd = motion(_PATTERNS)
    torque = np.asarray(jax.jit(network.torque)(k, q, qd, qdd))
    everything = np.ones(q.shape, bool)

    def chunks(patterns: int) -> Iterator[jc.Patterns]:
        for i in range(0, patterns, 65_536):
            at = slice(i, min(i + 65_536, patterns))
            stamps = np.arange(at.start, at.stop, dtype=float)
            yield jc.Patterns(
                stamps, q[at], qd[at], qdd[at], torque[at], everything[at], everything[at]
            )

    start = time.perf_counter()
    fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit_stream(
        network, chunks(65_536)
    )
    first = time.perf_counter() - start
    start = time.perf_counter()
    jc.LeastSquares(joint_weights="equal", errors="independent").fit_stream(network, chunks(65_536))
    yield Metric("stream.compile", first - (time.perf_counter() - start), "s", "lower", 0.5)

    def run() -> jax.Array:
        nonlocal fit
        fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit_stream(
            network, chunks(_PATTERNS)
        )
        return fit.k

    rate = _PATTERNS / best_of(run, 3)
    yield Metric("stream.rate", rate / 1e6, "million patterns/s", "higher")
    error = float(jnp.max(jnp.abs(fit.k - k)))
    yield Metric("stream.largest_error", error, "SI", "lower", 10.0)

    model = pinocchio_model(network.robot, network.robot.links or ())
    data = model.createData()
    sample = 20_000
    start = time.perf_counter()
    for i in range(sample):
        pinocchio.computeJointTorqueRegressor(model, data, q[i], qd[i], qdd[i])
    loop = sample / (time.perf_counter() - start)
    yield Metric("pinocchio.regressor_loop", loop / 1e6, "million patterns/s", "higher")
    # Pinocchio's loop computes regressors only; the stream factorises them as well.
    yield Metric("stream.over_pinocchio", rate / loop, "1", "higher")


def command_times() -> Iterator[Metric]:
    """`jaxcslc identify` on 3,300 samples, the whole process, first and second run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        machine = sim.puma560()
        for trajectory in (sim.training(), sim.comparison()):
            recording = sim.simulate(machine, trajectory, seed=1).recording
            save_recording(recording, folder / f"{trajectory.name}.csv")
        command = [sys.executable, "-c", "from jaxcslc.cli import main; main()"]
        command += ["identify", "puma560", str(folder / "training.csv")]
        command += ["--validate", str(folder / "comparison.csv"), "-o", str(folder / "out")]
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        for run in ("first", "second"):
            start = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True, env=environment)
            yield Metric(f"identify.{run}_run", time.perf_counter() - start, "s", "lower", 0.5)


def memory(rows: int) -> Iterator[Metric]:
    """Peak memory of a process that solves from a Parquet file of `rows` patterns."""
    with tempfile.TemporaryDirectory(dir=Path.cwd() / "build") as name:
        path = Path(name) / "long.parquet"
        write_long_recording(path, rows)
        start = time.perf_counter()
        result = subprocess.run(
            [sys.executable, __file__, "--stream-file", str(path)],
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


def write_long_recording(path: Path, rows: int) -> None:
    """A recording with velocities and accelerations, written in parts."""
    robot = jc.puma560()
    network = jc.derive(robot)
    k = true_coefficients(network)
    torque = jax.jit(network.torque)
    rng = np.random.default_rng(0)

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


def true_coefficients(network: jc.CSLC) -> jax.Array:
    """Those of the robot's link parameters and friction."""
    robot = network.robot
    assert robot.links is not None
    return network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)


GROUPS: dict[str, Callable[[jc.CSLC, jax.Array], Iterator[Metric]]] = {
    "derivation": lambda network, k: derivation(),
    "forward": forward,
    "direct solve": direct_solve,
    "training": lambda network, k: training(),
    "commands": lambda network, k: command_times(),
    "robots": lambda network, k: robot_metrics(),
    "control": lambda network, k: control_metrics(),
    "evaluation": lambda network, k: evaluation_metrics(20_000),
}
"""What is measured, by name: of the PUMA 560's network and coefficients."""


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--groups", nargs="+", choices=GROUPS, default=list(GROUPS), help="what to measure; all"
    )
    parser.add_argument("--full", action="store_true", help="with the long runs")
    parser.add_argument("--gate", action="store_true", help="exit 1 if a metric became worse")
    parser.add_argument("--update-baseline", action="store_true")
    parser.add_argument("--rows", type=int, default=20_000_000, help="of the long Parquet file")
    parser.add_argument("--stream-file", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.stream_file:
        stream_file(options.stream_file)
        return 0

    network = jc.derive(jc.puma560())
    k = true_coefficients(network)
    parts = [GROUPS[name](network, k) for name in options.groups]
    if options.full:
        Path("build").mkdir(exist_ok=True)
        parts.append(memory(options.rows))
    metrics: list[Metric] = []
    for part in parts:
        for metric in part:
            print(f"  {metric.name} {metric.value:.4g} {metric.unit}", file=sys.stderr, flush=True)
            metrics.append(metric)
    baseline = json.loads(_BASELINE.read_text()) if _BASELINE.exists() else {}
    worse = report(metrics, baseline)
    if options.update_baseline:
        baseline |= {metric.name: asdict(metric) for metric in metrics}
        _BASELINE.write_text(json.dumps(baseline, indent=2) + "\n")
        print(f"wrote {_BASELINE.name}")
    return 1 if options.gate and worse else 0


if __name__ == "__main__":
    raise SystemExit(main())

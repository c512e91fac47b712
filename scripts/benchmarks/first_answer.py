"""Processor time of each step of `jaxcslc identify`, and of the command's start.

    python scripts/benchmarks/first_answer.py [--samples 3300] [--robot puma560|panda]

A PUMA 560's recording is simulated; a Panda's is that of `scripts/benchmarks/robot.py`, of 20,000
samples. Every figure is of a process of its own, first with no compiled program in the user's
cache, then with those that the first run stored; modules are byte code, as an installation leaves
them. Processor time, since it depends little on what else the machine does; wall-clock time too,
which does.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pinocchio

import jaxcslc as jc
import sim
from scripts.benchmarks.c_code import pinocchio_model
from scripts.benchmarks.metrics import Metric
from scripts.benchmarks.robot import published, recording_of


jc.enable_x64()

_COMMAND = "from jaxcslc.cli import main; main()"
# A process that does what the command does, and says when each step begins.
_STEPS = """
import time
marks = [("interpreter", time.process_time())]
import sys, json
from jaxcslc.cli._process import collect_garbage, prepare_process
prepare_process()
import jax
jc.enable_x64()
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
marks.append(("import of JAX", time.process_time()))
import jaxcslc.cli._identify
import jaxcslc as jc
collect_garbage()
marks.append(("other imports", time.process_time()))
robot = jc.puma560() if sys.argv[2] == "puma560" else jc.load_robot(sys.argv[2], tip="panda_hand")
network = jc.derive(robot, lengths="auto")
marks.append(("derivation", time.process_time()))
recording = jc.load_recording(sys.argv[3])
begun = "reading the recording"

def step(text):
    global begun
    marks.append((begun, time.process_time()))
    begun = text

report = jc.identify(network, recording, progress=step)
step("writing the report")
report.save(sys.argv[4])
str(report)
step("")
times = {}
for (_, before), (name, after) in zip(marks, marks[1:]):
    times[name] = times.get(name, 0.0) + after - before
print(json.dumps({"interpreter": marks[0][1]} | times))
"""


def _environment(**variables: str) -> dict[str, str]:
    """Return the environment of a user's process, who has not switched off the storing of byte
    code.
    """
    kept = {name: x for name, x in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | variables


def steps(folder: Path, robot: str, recording: Path) -> dict[str, float]:
    """Processor time of each step, of a process with the programs that are in `folder` [s]."""
    arguments = [str(folder / "cache"), robot, str(recording), str(folder / "out")]
    done = subprocess.run(
        [sys.executable, "-c", _STEPS, *arguments],
        check=True,
        capture_output=True,
        text=True,
        env=_environment(XDG_CACHE_HOME=arguments[0]),
    )
    return json.loads(done.stdout.splitlines()[-1])


def command(folder: Path, *arguments: str) -> tuple[float, float]:
    """Processor and wall-clock time of the command `jaxcslc`, the whole process [s]."""
    environment = _environment(XDG_CACHE_HOME=str(folder / "cache of the command"))
    before, start = os.times(), time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", _COMMAND, *arguments],
        check=False,
        capture_output=True,
        env=environment,
    )
    after, wall = os.times(), time.perf_counter() - start
    used = after.children_user + after.children_system
    return used - before.children_user - before.children_system, wall


def metrics() -> Iterator[Metric]:
    """`jaxcslc identify` on 3,300 samples of a PUMA 560, the whole process, beside the regression
    that a script of Pinocchio and NumPy does."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = sim.simulate(sim.puma560(), sim.training(samples=3300), seed=1).recording
        jc.save_recording(recording, folder / "train.csv")
        call = ("identify", "puma560", str(folder / "train.csv"), "-o", str(folder / "out"))
        command(folder, "--help")  # stores byte code
        for run, target in (("first", 8.0), ("later", 2.5)):
            used, wall = command(folder, *call)
            key = f"identify.puma560.{run}_run"
            yield Metric(key, wall, "s", "lower", 0.5, target)
            yield Metric(f"{key}.processor", used, "s", "lower", 0.5)
    robot = jc.puma560()
    model = pinocchio_model(robot, robot.links or ())
    data = model.createData()
    start = time.perf_counter()
    interval = float(np.median(np.diff(recording.time)))
    qd = np.gradient(recording.position, interval, axis=0)
    motion = zip(recording.position, qd, np.gradient(qd, interval, axis=0), strict=True)
    rows = [pinocchio.computeJointTorqueRegressor(model, data, *state).copy() for state in motion]
    np.linalg.lstsq(np.concatenate(rows), recording.torque.ravel(), rcond=None)
    seconds = time.perf_counter() - start
    yield Metric("identify.pinocchio_and_numpy", seconds, "s", "lower", 0.5)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the benchmark. **Returns** the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--robot", choices=["puma560", "panda"], default="puma560")
    parser.add_argument("--samples", type=int, default=3300, help="of the PUMA 560's recording")
    options = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), Path(name) / "train.csv"
        robot, extra = options.robot, ()
        if robot == "panda":
            robot, extra = str(published("panda.urdf")), ("--tip", "panda_hand")
            jc.save_recording(recording_of(Path(robot), "panda_hand"), path)
        else:
            trajectory = sim.training(samples=options.samples)
            jc.save_recording(sim.simulate(sim.puma560(), trajectory, seed=1).recording, path)
        command(folder, "--help")  # stores byte code
        first, later = (steps(folder, robot, path) for _ in range(2))
        print(f"{'CPU s':34} {'first':>7} {'later':>7}")
        for label, seconds in later.items():
            print(f"{label:34} {first.get(label, 0.0):7.2f} {seconds:7.2f}")
        print(f"{'all steps':34} {sum(first.values()):7.2f} {sum(later.values()):7.2f}")
        output = str(folder / "command")
        runs = {
            "identify": ("identify", robot, str(path), *extra, "-o", output),
            "check": ("check", robot, str(path), *extra),
            "derive": ("derive", robot, *extra),
            "--help": ("--help",),
        }
        print(f"\n{'command: CPU s, wall s':34} {'first':>14} {'later':>14}")
        for label, arguments in runs.items():
            timed = [command(folder, *arguments) for _ in range(2)]
            cells = [f"{used:6.2f} {wall:7.2f}" for used, wall in timed]
            print(f"{label:34} {cells[0]:>14} {cells[1]:>14}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

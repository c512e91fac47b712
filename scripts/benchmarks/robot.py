"""Time from a URDF file to a regressor, and to coefficients.

    python -m scripts.benchmarks.robot panda.urdf --tip panda_hand

Whole processes, with nothing compiled beforehand and once more with the programs that the first one
stored. The
recording of 20,000 samples is of a motion in sines, by the file's own link parameters, with noise.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import files
from pathlib import Path

import jax
import numpy as np

import jaxcslc as jc
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()

_SAMPLES, _PERIOD = 20_000, 0.005
_REGRESSOR = """
import sys
import jax
import jaxcslc as jc
import numpy as np
jc.enable_x64()
path, tip = sys.argv[1:]
network = jc.derive(jc.load_robot(path, tip=tip or None), lengths="numeric")
q, qd, qdd = np.random.default_rng(0).normal(size=(3, 1000, network.joint_count))
jax.jit(network.regressor)(q, qd, qdd).block_until_ready()
"""
_IDENTIFY = "from jaxcslc.cli import main; main()"


def file_to_regressor(path: Path, tip: str | None) -> Iterator[Metric]:
    """Return the seconds from a file to a compiled regressor of 1,000 states, the whole process."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        _run([_REGRESSOR, str(path), tip or ""], Path(folder))
        yield Metric("urdf.to_regressor", time.perf_counter() - start, "s", "lower", 0.5)


def file_to_coefficients(path: Path, tip: str | None) -> Iterator[Metric]:
    """`jaxcslc identify` on 20,000 samples: settings selected by the command, then from a file."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jc.save_recording(recording_of(path, tip), folder / "train.csv")
        command = [_IDENTIFY, "identify", str(path), str(folder / "train.csv")]
        command += ["-o", str(folder / "out"), *(["--tip", tip] if tip else [])]
        for run, target in (("first", 12.0), ("later", 5.0)):
            start = time.perf_counter()
            _run(command, folder)
            seconds = time.perf_counter() - start
            yield Metric(f"urdf.identify_choosing.{run}_run", seconds, "s", "lower", 0.5, target)
        settings = folder / "settings.json"
        document = json.loads((folder / "out" / "identification.json").read_text(encoding="utf-8"))
        settings.write_text(json.dumps(document["settings"]), encoding="utf-8")
        start = time.perf_counter()
        _run([*command, "--settings", str(settings)], folder)
        yield Metric("urdf.identify", time.perf_counter() - start, "s", "lower", 0.5)


def recording_of(path: Path, tip: str | None) -> jc.Recording:
    """A motion in sines by the torques of the file's links, with friction and noise."""
    robot = jc.load_robot(path, tip=tip)
    assert robot.links is not None
    network = jc.derive(robot, lengths="numeric")
    n = robot.joint_count
    k = network.coefficients_from(robot.links, viscous=(0.5,) * n, dry=(0.8,) * n)
    rng = np.random.default_rng(0)
    rates = rng.uniform(0.5, 3.0, (3, n))
    sizes = rng.uniform(0.1, 0.4, (3, n))
    time_ = _PERIOD * np.arange(_SAMPLES)
    angle = rates * time_[:, None, None]
    q = (sizes * np.sin(angle)).sum(axis=1)
    qd = (sizes * rates * np.cos(angle)).sum(axis=1)
    qdd = -(sizes * rates**2 * np.sin(angle)).sum(axis=1)
    torque = np.asarray(jax.jit(network.torque)(k, q, qd, qdd))
    return jc.Recording(time_, q, torque + rng.normal(0.0, 0.05, torque.shape))


def _run(arguments: list[str], folder: Path) -> None:
    """Runs Python in a new process that stores compiled programs in `folder`."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-c", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        sys.exit(f"robot benchmark: {done.stderr.strip().splitlines()[-1]}")


def published(name: str) -> Path:
    """A robot of the package example-robot-data."""
    (path,) = [path for path in files("example-robot-data") or [] if path.name == name]
    return Path(str(path.locate()))


def metrics() -> Iterator[Metric]:
    """Return the metrics of a Panda with its hand, 7 joints."""
    path = published("panda.urdf")
    yield from file_to_regressor(path, "panda_hand")
    yield from file_to_coefficients(path, "panda_hand")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("robot", nargs="?", type=Path, help="a URDF file; a Panda if omitted")
    parser.add_argument("--tip", help="the body that the robot ends with")
    options = parser.parse_args(argv)
    if options.robot is None:
        measured = list(metrics())
    else:
        measured = [*file_to_regressor(options.robot, options.tip)]
        measured += file_to_coefficients(options.robot, options.tip)
    report(measured, {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

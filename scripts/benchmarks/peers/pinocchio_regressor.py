"""Pinocchio's regressor in C++ on all threads, beside the streamed solve in the same run.

    python -m scripts.benchmarks.peers.pinocchio_regressor [--samples 1e6]

A small program is compiled against the headers that Pinocchio's and Eigen's packages install, which
takes a minute. It computes regressors and does nothing with them; the streamed solve computes
columns, their products and the coefficients.
"""

import argparse
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pinocchio

import jaxcslc as jc
from jaxcslc._environment import core_count
from scripts.benchmarks.c_code import pinocchio_model
from scripts.benchmarks.metrics import Metric
from scripts.benchmarks.solve_gpu import network_named, stream_rate


_SOURCE = Path(__file__).with_suffix(".cpp")
_PREFIX = Path(pinocchio.__file__).parents[4]
# As Pinocchio's own build declares to what is compiled against it. The library is compiled for any
# processor, and so is this: with wider registers, Eigen's arrays would lie in memory otherwise.
_OPTIONS = (
    *("-std=c++17", "-O3", "-DNDEBUG", "-DBOOST_FUSION_INVOKE_MAX_ARITY=12"),
    *("-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30"),
    *("-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION"),
    *("-DPINOCCHIO_WITH_COLLISION", "-DPINOCCHIO_WITH_HPP_FCL"),
)
_LIBRARIES = ("-lpinocchio_default", "-lboost_serialization", "-lboost_filesystem", "-pthread")
_ROBOTS = ("puma560", "panda")
_SAMPLES = 1_000_000


def can_be_compiled() -> bool:
    """Return whether there are a compiler of C++ and the headers."""
    headers = ("pinocchio/algorithm/regressor.hpp", "eigen3/Eigen/Core")
    installed = all((_PREFIX / "include" / header).exists() for header in headers)
    return installed and shutil.which("g++") is not None


def compiled(folder: Path) -> Path:
    """The program.

    **Raises** `subprocess.CalledProcessError` if the compiler fails.
    """
    program, include, library = folder / "regressor", _PREFIX / "include", _PREFIX / "lib"
    where = (f"-I{include}", f"-I{include / 'eigen3'}", f"-L{library}", f"-Wl,-rpath,{library}")
    command = ["g++", *_OPTIONS, *where, _SOURCE, "-o", program, *_LIBRARIES]
    subprocess.run(command, check=True, capture_output=True)
    return program


def regressor_rate(program: Path, name: str, threads: int, samples: int) -> float:
    """Million regressors/s of a robot with the joints of one of ours."""
    robot = network_named(name).robot
    links = robot.links or (jc.puma560().links or ())[:1] * len(robot.joints)
    with TemporaryDirectory() as folder:
        model = Path(folder) / "model.bin"
        pinocchio_model(robot, links).saveToBinary(str(model))
        done = subprocess.run(
            [program, model, str(threads), str(samples)], check=True, capture_output=True, text=True
        )
    return samples / float(done.stdout.split()[0]) / 1e6


def metrics(samples: int = _SAMPLES) -> Iterator[Metric]:
    """Return the metrics of a PUMA 560 and a Panda, on all cores; nothing where the program cannot
    be compiled.
    """
    if not can_be_compiled():
        return
    threads = core_count()
    with TemporaryDirectory() as folder:
        program = compiled(Path(folder))
        for name in _ROBOTS:
            theirs = regressor_rate(program, name, threads, samples)
            ours = stream_rate(name, 4 * samples, threads)["million patterns/s"]
            unit = "million patterns/s"
            yield Metric(f"{name}.pinocchio_regressor_in_cpp", theirs, unit, "higher")
            yield Metric(f"{name}.streamed_solve", ours, unit, "higher")
            yield Metric(f"{name}.ratio", ours / theirs, "1", "higher")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=float, default=float(_SAMPLES))
    options = parser.parse_args(argv)
    if not can_be_compiled():
        print("needs g++ and the packages pin and cmeel-eigen")
        return 1
    for metric in metrics(int(options.samples)):
        print(f"{metric.name} {metric.value:.4g} {metric.unit}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

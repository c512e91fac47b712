"""What `make bench` measures: groups of figures, each run alone or with others.

A group's module is imported when it is run: on a machine with a GPU neither Pinocchio nor MuJoCo
need be installed.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from scripts.benchmarks.metrics import Metric


@dataclass(frozen=True)
class Group:
    """Some figures that one function of a module measures.

    **Attributes**

    - `module`, `function`: in `scripts.benchmarks`; it yields metrics.
    - `text`: what is measured, for the page.
    - `arguments`: of the function.
    - `long`: minutes rather than seconds; left out unless it is named.
    """

    module: str
    text: str
    function: str = "metrics"
    arguments: Mapping[str, Any] = field(default_factory=dict[str, Any])
    long: bool = False

    def metrics(self) -> Iterator[Metric]:
        """The figures, as soon as each is measured."""
        module = import_module(f"scripts.benchmarks.{self.module}")
        return getattr(module, self.function)(**self.arguments)


GROUPS: dict[str, Group] = {
    "first answer": Group(
        "first_answer",
        "`jaxcslc identify` on 3,300 samples of a PUMA 560, from the shell to the written "
        "page. The first run has no compiled program of an earlier run. "
        "`identify.pinocchio_and_numpy` is for comparison: differences, a loop over "
        "Pinocchio's regressor and `numpy.linalg.lstsq`, in a process that runs already. It "
        "chooses no settings and has no masks and no intervals.",
    ),
    "URDF file": Group(
        "robot",
        "A Panda with its hand, 7 joints. `to_regressor` is the time from the file to a "
        "compiled regressor. `identify` fits 20,000 samples: first it selects settings, "
        "then it takes them from a file.",
    ),
    "long recording": Group(
        "long_recording",
        "`jaxcslc identify` on 600,000 samples of 7 joints, settings selected, the whole process.",
        long=True,
    ),
    "maximum likelihood": Group(
        "estimators.likelihood",
        "`jaxcslc identify --estimator maximum-likelihood` on 3,300 samples of a simulated "
        "PUMA 560 with static friction and encoders, the whole process. Settings are "
        "selected, and least squares is fitted too.",
    ),
    "long maximum likelihood": Group(
        "estimators.likelihood",
        "The same on 60,000 samples, two minutes of motion.",
        "long_metrics",
        long=True,
    ),
    "derivation": Group(
        "direct_solve", "Exact tables and the network, each in a fresh process.", "derivation"
    ),
    "direct solve": Group(
        "direct_solve",
        "A million random states of a PUMA 560 in memory: torques (`forward`), and the "
        "streamed solve from motion and torque to coefficients (`stream`). Compiling is "
        "measured separately. Two figures compare with the limits of the machine. `of_copy` "
        "is the rate in bytes/s over that of a copy. It counts inputs and outputs for "
        "torque. For the solve, it counts rows of the regressor, which are written, read, "
        "multiplied, written and read again. `of_product` is the rate of operations that "
        "the products of the solve need, over that of a large matrix product. Pinocchio's "
        "recursion runs in C++ on all threads, and its regressor in a Python loop on one "
        "thread. It has no friction and no motor inertia, and solves nothing.",
    ),
    "Pinocchio in C++": Group(
        "peers.pinocchio_regressor",
        "Pinocchio's joint torque regressor in a C++ program on all cores, with the options "
        "of its package. The streamed solve is timed in the same run. It computes regressor "
        "columns, their products and the coefficients.",
        long=True,
    ),
    "FIGAROH": Group(
        "peers.figaroh_identification",
        "FIGAROH identifies a Panda from URDF and CSV, 20,000 samples, where that package "
        "is installed. `jaxcslc identify` has the same files. Times are processor times of "
        "whole processes, second runs. FIGAROH's cutoff is set by hand (20 Hz). Torque "
        "errors are over all samples, whose noise is 0.05 N m.",
        long=True,
    ),
    "mujoco.sysid": Group(
        "peers.mujoco_sysid",
        "MuJoCo's toolbox fits by simulation. It has the training recording of a PUMA 560 "
        "with the default disturbances, and takes twenty steps from bodies that are 20 % "
        "too large. The direct solve has the same patterns. `identify` selects its "
        "settings. Torque errors are on these patterns, over the torque. The toolbox "
        "minimises errors of simulated motion instead. 6.6 s of motion barely distinguish "
        "these bodies from others: after five steps its torque error is 0.32, and it grows. "
        "So compare the times, and not the accuracy.",
        long=True,
    ),
    "Parquet file": Group(
        "files.parquet",
        "20 million patterns streamed from a Parquet file, a process of its own.",
        long=True,
    ),
    "cluster": Group(
        "files.cluster",
        "One fit of 4 million patterns in 20 Parquet files on a Dask cluster of this "
        "machine, with workers of one thread that have compiled before. The size is a "
        "toy's: `python -m scripts.benchmarks.files.cluster` fits 20 million. Differences "
        "of coefficients are to those of one worker. In one run, one of two workers is "
        "killed after the first file.",
        long=True,
    ),
    "evaluation": Group(
        "evaluation",
        "Torque, regressor columns and forward dynamics by every evaluator, random states "
        "on JAX's default device. `of_copy` is the rate in bytes/s of inputs and outputs, "
        "over that of a copy.",
        arguments={"samples": 20_000},
    ),
    "solve": Group(
        "solve_gpu",
        "The direct solve of random states, from patterns to coefficients and standard "
        "errors. It runs on all GPUs if there are any, and is streamed on cores otherwise. "
        "`of_copy` and `of_product` are as above. Differences to Householder QR on the CPU "
        "are the largest of all coefficients.",
        long=True,
    ),
    "training": Group(
        "training",
        "Trainings of the CSLC: PERAL on the training recording, one and 256 in parallel, "
        "and backpropagation on normal equations.",
        "training",
    ),
    "recordings": Group(
        "recording",
        "Simulated recordings with every disturbance, all cores.",
        long=True,
    ),
    "control": Group(
        "control", "A step of computed torque, with payload and fault monitor, and in C."
    ),
}
"""By name."""

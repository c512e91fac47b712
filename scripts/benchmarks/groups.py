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
        "`jaxcslc identify` on 3,300 samples of a PUMA 560, from the shell to the written page; the"
        " first run has no compiled program of an earlier one. Beside it the time that differences,"
        " a loop over Pinocchio's regressor and `numpy.linalg.lstsq` take within a process that"
        " runs already: no choice of settings, no masks, no uncertainty.",
    ),
    "URDF file": Group(
        "robot",
        "A Panda with its hand, 7 joints: from the file to a compiled regressor; `jaxcslc identify`"
        " on 20,000 samples, settings selected, and with settings from a file.",
    ),
    "long recording": Group(
        "long_recording",
        "`jaxcslc identify` on 600,000 samples of 7 joints, settings selected, the whole process.",
        long=True,
    ),
    "maximum likelihood": Group(
        "estimators.likelihood",
        "`jaxcslc identify --estimator maximum-likelihood` on 3,300 samples of a simulated PUMA 560"
        " with static friction and encoders, the whole process; settings selected, least squares"
        " beside it.",
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
        "A million random states of a PUMA 560 in memory: torques, and the streamed solve from"
        " motion and torque to coefficients, compiling apart. Limits: `of_copy` is the part of a"
        " copy's bytes/s, of inputs and outputs (torque) or of rows of the regressor, written,"
        " read, multiplied, written and read again (solve); `of_product` the part of a large"
        " matrix product's operations/s that the solve's products alone need. Pinocchio's"
        " recursion runs in C++ on all threads, its regressor in a loop of Python, on one; it has"
        " no friction and no motor inertia, and factorises nothing.",
    ),
    "Pinocchio in C++": Group(
        "peers.pinocchio_regressor",
        "Pinocchio's joint torque regressor in a C++ program on all cores, with the options of its"
        " package, beside the streamed solve in the same run, which computes columns, their"
        " products and the coefficients.",
        long=True,
    ),
    "FIGAROH": Group(
        "peers.figaroh_identification",
        "FIGAROH's identification of a Panda from URDF and CSV, 20,000 samples, where that package"
        " is installed, and `jaxcslc identify` on the same files: processor time of whole"
        " processes, second runs. FIGAROH's cutoff is set by hand (20 Hz); torque errors are over"
        " all samples, whose noise is 0.05 N m.",
        long=True,
    ),
    "mujoco.sysid": Group(
        "peers.mujoco_sysid",
        "MuJoCo's toolbox, which fits by simulation, on the training recording of a PUMA 560 with"
        " the default disturbances, twenty steps from bodies a fifth too large; the direct solve of"
        " the same patterns, and all of `jaxcslc.identify` with settings of its choice. Torque"
        " errors are on these patterns, over the torque. The toolbox minimises errors of simulated"
        " motion instead, which 6.6 s barely tell from other bodies': after five steps its torque"
        " error is 0.32, and grows. It is a time beside a time, no ranking of accuracy.",
        long=True,
    ),
    "Parquet file": Group(
        "files.parquet",
        "20 million patterns streamed from a Parquet file, a process of its own.",
        long=True,
    ),
    "cluster": Group(
        "files.cluster",
        "One fit of 4 million patterns in 20 Parquet files on a Dask cluster of this machine:"
        " workers of one thread each, that have compiled before. A toy size: 20 million by"
        " `python -m scripts.benchmarks.files.cluster`. Differences of coefficients are to those"
        " of one worker; one of two is killed when the first file is done.",
        long=True,
    ),
    "evaluation": Group(
        "evaluation",
        "Torque, regressor columns and forward dynamics by every evaluator, random states on JAX's"
        " default device; `of_copy` is the part of a copy's bytes/s, of inputs and outputs.",
        arguments={"samples": 20_000},
    ),
    "solve": Group(
        "solve_gpu",
        "The direct solve of random states, from patterns to coefficients and standard errors: on"
        " all GPUs if there are any, streamed on cores otherwise. `of_copy` and `of_product` as"
        " above; differences to reflections on the CPU are the largest of all coefficients.",
        long=True,
    ),
    "training": Group(
        "training",
        "Trainings of the CSLC: PERAL on the training recording, one and 256 side by side, and"
        " backpropagation on normal equations.",
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

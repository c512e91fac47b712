"""Microseconds of a control step for one robot, from compiled Python and from exported C.

A full computed-torque step of the PUMA 560 (43 coefficients, closed form) and of the Panda (57,
recursion); behind encoders; with a payload estimator; with a guard. Python's are calls of one
compiled function with NumPy's arrays, waited for, as a control loop would make them, and their mean
over a second of samples. A payload's update comes every tenth sample; the time of such a sample is
another line. C's is the code of `jaxcslc.c_code` with the error's
feedback in front of it, in a loop in C. The sampling period of the PUMA 560's controller is 2 ms.
"""

import argparse
import ctypes
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np

import jaxcslc as jc
from jaxcslc.control import ComputedTorque, FaultMonitor, OutputFeedback, Reference
from jaxcslc.payload import PayloadCompensation, PayloadEstimator
from scripts.benchmarks.c_library import shared_library
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()

PERIOD = 0.002  # s
_SAMPLES = 500
_FREQUENCY, _DAMPING = 20.0, 1.0


def glue(code: jc.CCode, n: int, samples: int) -> str:
    """The exported code, a control step around it, and a loop around that."""
    position, velocity = _FREQUENCY**2, 2.0 * _DAMPING * _FREQUENCY
    return f"""#define _POSIX_C_SOURCE 199309L
#include <time.h>
{code.source}
static void step(const double *x, double tau[{n}])
{{
    const double *q = x, *qd = x + {n}, *at = x + {2 * n}, *rate = x + {3 * n};
    const double *second = x + {4 * n};
    double wanted[{n}];
    for (int i = 0; i < {n}; ++i)
        wanted[i] = second[i] + {velocity!r} * (rate[i] - qd[i]) + {position!r} * (at[i] - q[i]);
    {code.name}_torque(q, qd, wanted, tau);
}}
double timed(const double *x, long calls, double *last)
{{
    struct timespec start, end;
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (long i = 0; i < calls; ++i)
        step(x + (i % {samples}) * {5 * n}, last);
    clock_gettime(CLOCK_MONOTONIC, &end);
    return (double)(end.tv_sec - start.tv_sec) + 1e-9 * (double)(end.tv_nsec - start.tv_nsec);
}}
"""


def c_step(
    network: jc.CSLC, k: np.ndarray, states: np.ndarray, calls: int
) -> tuple[float, np.ndarray]:
    """Seconds a step in C, the best of five rounds, and the torque of the last state."""
    n = network.joint_count
    code = jc.c_code(network, k)
    timed: Any = shared_library(code, glue(code, n, len(states))).timed
    timed.restype = ctypes.c_double
    torque = np.empty(n)
    pointers = [x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for x in (states, torque)]
    rounds = [timed(pointers[0], ctypes.c_long(calls), pointers[1]) for _ in range(5)]
    return min(rounds) / calls, torque


def python_step(loop: Any, states: np.ndarray) -> tuple[float, float]:
    """Mean and slowest tenth's median of seconds a step in Python, the best of three rounds.

    The loop is compiled into the step: passing its arrays and its network at every call takes
    longer than the step.
    """
    begin = jax.jit(lambda q: loop.begin(q))
    step = jax.jit(lambda state, reference, q: loop.step(state, reference, q, PERIOD))
    rounds: list[tuple[float, float]] = []
    for _ in range(4):  # the first one compiles
        state = jax.block_until_ready(begin(states[0, 0]))
        times: list[float] = []
        for q, _, at, rate, second in states:
            start = time.perf_counter()
            torque, state = step(state, Reference(at, rate, second), q)
            np.asarray(torque)
            jax.block_until_ready(state)
            times.append(time.perf_counter() - start)
        slow = sorted(times)[-len(times) // 10 :]
        rounds.append((float(np.mean(times)), float(np.median(slow))))
    return min(rounds[1:])


def metrics(
    calls: int = 1_000_000, robots: Sequence[str] = ("puma560", "panda"), samples: int = _SAMPLES
) -> Iterator[Metric]:
    """Every figure, as soon as it is measured."""
    for name in robots:
        robot: jc.Manipulator = getattr(jc, name)()
        lengths = "symbolic" if name == "puma560" else "numeric"
        network = jc.derive(robot, lengths=lengths)
        n, rng = network.joint_count, np.random.default_rng(0)
        time_ = PERIOD * np.arange(samples)[:, None]
        pace = rng.uniform(2, 5, n)
        at, rate = 0.5 * np.sin(pace * time_), 0.5 * pace * np.cos(pace * time_)
        second = -0.5 * pace**2 * np.sin(pace * time_)
        q, qd = at + 1e-3 * rng.normal(size=at.shape), rate + 1e-2 * rng.normal(size=at.shape)
        states = np.ascontiguousarray(np.stack([q, qd, at, rate, second], axis=1))
        links = robot.links or tuple(
            jc.LinkParameters(2.0, rng.uniform(-0.1, 0.1, 3), 0.02 * np.eye(3)) for _ in range(n)
        )
        k = np.asarray(network.coefficients_from(links, viscous=np.ones(n), dry=np.ones(n)))
        controller = ComputedTorque(network, k, _FREQUENCY, _DAMPING, torque_limit=1e3)
        loop = OutputFeedback(controller)
        estimator = PayloadEstimator(network, k, np.full(n, 1e-3))
        guard = FaultMonitor(loop, network, k, torque_limit=1e3)

        def timed(figure: str, loop: Any, name: str = name, states: np.ndarray = states):
            mean, slow = python_step(loop, states)
            yield Metric(f"{name}.{figure}", 1e6 * mean, "us", "lower", 0.5)
            if figure == "step_with_payload":
                yield Metric(f"{name}.payload_update", 1e6 * slow, "us", "lower", 0.5)

        yield from timed("step", loop)
        yield from timed("step_with_payload", PayloadCompensation(controller, estimator))
        yield from timed("guarded_step", guard)
        if shutil.which("cc") is not None:
            seconds, torque = c_step(network, k, states, calls)
            last = states[(calls - 1) % samples]
            expected, _ = controller.step(
                controller.begin(last[0]), Reference(*last[2:]), last[0], PERIOD, last[1]
            )
            if not np.allclose(torque, expected, atol=1e-8):
                raise RuntimeError(
                    f"{name}: C and Python differ by {torque - np.asarray(expected)}"
                )
            yield Metric(f"{name}.step_in_c", 1e6 * seconds, "us", "lower", 0.5)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--calls", type=int, default=1_000_000, help="of the C step a round")
    options = parser.parse_args(argv)
    if options.calls < 1:
        parser.error(f"--calls is {options.calls}; expected 1 or more")
    if shutil.which("cc") is None:
        print("no C compiler (cc) on this machine: Python's figures only", file=sys.stderr)
    report(list(metrics(options.calls)), {})
    print(f"the sampling period is {1e6 * PERIOD:g} us")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

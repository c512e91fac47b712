"""Time per call of the C code that `jaxcslc.c_code` writes, beside Pinocchio's, in one run.

For the PUMA 560 and the Panda: torque beside `pin.rnea`, mass matrix beside `pin.crba`, gravity
beside `pin.computeGeneralizedGravity`, regressor beside `pin.computeJointTorqueRegressor`. The C
functions are called from a loop in C. Pinocchio is called from Python, as its users of Python do;
the time of its cheapest call there is in another column. Its functions have no friction and no
motor inertia, and neither have the C functions here; its regressor has ten columns for each link,
the C code's one for each base parameter.
"""

import argparse
import ctypes
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from scripts.benchmarks.c_library import shared_library


jc.enable_x64()

_STATES = 64  # different ones in turn, so that no result can be reused
_FUNCTIONS = {"torque": 3, "mass_matrix": 1, "gravity": 1, "regressor": 3}


def timed_source(code: jc.CCode, n: int, p: int) -> str:
    """The code with a loop in C around each function: (states, repetitions, sum) to seconds."""
    sizes = {"torque": n, "mass_matrix": n * n, "gravity": n, "regressor": n * p}
    text = "#define _POSIX_C_SOURCE 199309L\n#include <time.h>\n" + code.source
    for name, inputs in _FUNCTIONS.items():
        states = ", ".join(f"x + (3 * (i % {_STATES}) + {j}) * {n}" for j in range(inputs))
        text += f"""
double time_{name}(const double *x, long calls, double *sum)
{{
    struct timespec start, end;
    static double out[{sizes[name]}];
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (long i = 0; i < calls; ++i) {{
        {code.name}_{name}({states}, out);
        *sum += out[0];
    }}
    clock_gettime(CLOCK_MONOTONIC, &end);
    return (double)(end.tv_sec - start.tv_sec) + 1e-9 * (double)(end.tv_nsec - start.tv_nsec);
}}
"""
    return text


def c_times(
    code: jc.CCode, n: int, p: int, states: Float[np.ndarray, "states 3 joints"], calls: int
) -> dict[str, float]:
    """Seconds a call of each function, the best of five rounds."""
    loaded = shared_library(code, timed_source(code, n, p))
    pointer = states.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
    total = ctypes.c_double(0.0)
    times: dict[str, float] = {}
    for name in _FUNCTIONS:
        function: Any = loaded[f"time_{name}"]
        function.restype = ctypes.c_double
        rounds = [function(pointer, ctypes.c_long(calls), ctypes.byref(total)) for _ in range(5)]
        times[name] = min(rounds) / calls
    return times


def pinocchio_model(robot: jc.Manipulator, links: tuple[jc.LinkParameters, ...]) -> Any:
    """A model with the robot's kinematics and bodies."""
    model = pin.Model()
    parent = 0
    for i, (joint, link) in enumerate(zip(robot.joints, links, strict=True)):
        placement = pin.SE3(
            pin.rpy.rpyToMatrix(joint.alpha, 0.0, 0.0), np.array([joint.a.value, 0.0, 0.0])
        ) * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, joint.theta), np.array([0, 0, joint.d.value]))
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{i}")
        body = pin.Inertia(
            float(link.mass), np.asarray(link.centre_of_gravity), np.asarray(link.inertia)
        )
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.gravity = pin.Motion(np.array(robot.gravity), np.zeros(3))
    return model


def pinocchio_times(
    model: Any, states: Float[np.ndarray, "states 3 joints"], calls: int
) -> dict[str, float]:
    data = model.createData()
    functions: dict[str, Callable[[Any], Any]] = {
        "torque": lambda x: pin.rnea(model, data, x[0], x[1], x[2]),
        "mass_matrix": lambda x: pin.crba(model, data, x[0]),
        "gravity": lambda x: pin.computeGeneralizedGravity(model, data, x[0]),
        "regressor": lambda x: pin.computeJointTorqueRegressor(model, data, x[0], x[1], x[2]),
        "call": lambda x: pin.SE3.Identity(),
    }
    times: dict[str, float] = {}
    for name, function in functions.items():
        rounds: list[float] = []
        for _ in range(5):
            start = time.perf_counter()
            for i in range(calls):
                function(states[i % _STATES])
            rounds.append(time.perf_counter() - start)
        times[name] = min(rounds) / calls
    return times


def measure(robot: jc.Manipulator, calls: int) -> list[dict[str, str | float]]:
    """A row for each function: operations and microseconds."""
    rng = np.random.default_rng(0)
    robot = robot.with_inertia("full", motor_inertia=False).with_friction()
    network = jc.derive(robot, lengths="numeric")
    links = tuple(
        jc.LinkParameters(float(m), rng.uniform(-0.1, 0.1, 3), 0.01 * float(m) * np.eye(3))
        for m in rng.uniform(1.0, 5.0, robot.joint_count)
    )
    k = np.asarray(network.coefficients_from(links))
    code = jc.c_code(network, k)
    states = np.ascontiguousarray(rng.uniform(-2, 2, (_STATES, 3, robot.joint_count)))
    model = pinocchio_model(robot, links)
    reference = pin.rnea(model, model.createData(), *states[0])
    torque = np.asarray(network.torque(k, *states[0]))
    if not np.allclose(torque, reference, atol=1e-9):
        raise RuntimeError(f"{robot.name}: torques differ from Pinocchio's by {torque - reference}")
    c = c_times(code, robot.joint_count, network.size, states, calls)
    pinocchio = pinocchio_times(model, states, max(calls // 50, 10))
    return [
        {
            "robot": robot.name,
            "function": name,
            "operations": float(code.operations[name]),
            "c_us": 1e6 * c[name],
            "pinocchio_us": 1e6 * pinocchio[name],
            "python_call_us": 1e6 * pinocchio["call"],
        }
        for name in _FUNCTIONS
    ]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--calls", type=int, default=1_000_000, help="of each C function a round")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/c_code_benchmark"))
    options = parser.parse_args(argv)
    if options.calls < 1:
        parser.error(f"--calls is {options.calls}; expected 1 or more")
    if shutil.which("cc") is None:
        parser.error("no C compiler (cc) on this machine")
    rows: list[dict[str, str | float]] = []
    for robot in (jc.puma560(), jc.panda()):
        print(f"{robot.name} …", file=sys.stderr)
        rows += measure(robot, options.calls)
    cells = [[v if isinstance(v, str) else f"{v:.3g}" for v in row.values()] for row in rows]
    print(text_table(list(rows[0]), cells, left=("function",)))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "times.csv", rows)
    print(f"\nwrote {options.output / 'times.csv'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

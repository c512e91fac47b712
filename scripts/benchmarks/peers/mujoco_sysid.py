"""MuJoCo's toolbox for system identification beside the direct solve, on the same recording.

    python -m scripts.benchmarks.peers.mujoco_sysid [--steps 20]

Needs the package `tabulate`, which `mujoco.sysid` imports. A PUMA 560 with the default disturbances
is simulated for 6.6 s. The toolbox searches by simulations of 0.2 s for bodies, motor inertias and
friction, from bodies whose masses and tensors are a fifth too large
(`scripts/studies/real_robots/simulation_fit.py`; from equal balls it went astray);
`jaxcslc` fits the regressor's rows, and is also timed with the choice of settings and all that
`jaxcslc.identify` reports. Torque errors are those of the coefficients on the patterns of the fit,
root mean squares over the root mean square of torque.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()

# Of masses and tensors at the start over true ones, and of a simulation [s].
_START, _STRETCH = 1.2, 0.2


def installed() -> bool:
    """Return whether the toolbox can be imported."""
    return find_spec("mujoco.sysid") is not None and find_spec("tabulate") is not None


def metrics(samples: int = 3300, steps: int = 20) -> Iterator[Metric]:
    """Processor time of both and torque errors; nothing without the toolbox."""
    if not installed():
        return
    from scripts.studies.real_robots.methods import LOW_PASS
    from scripts.studies.real_robots.simulation_fit import simulation_fit

    machine = sim.puma560()
    recording = sim.simulate(machine, sim.training(samples=samples), seed=1).recording
    links = [
        jc.LinkParameters(
            _START * float(link.mass),
            link.centre_of_gravity,
            _START * np.asarray(link.inertia),
            _START * float(link.motor_inertia),
        )
        for link in machine.robot.links or ()
    ]
    network = jc.derive(jc.puma560())
    patterns = jc.prepare(
        recording,
        smoothing=jc.Butterworth(LOW_PASS),
        torque_alignment="sample",
        threshold_fraction=0.0,
    )

    def timed(fit: Callable[[], Float[np.ndarray, " coefficients"]]) -> tuple[float, np.ndarray]:
        start = time.process_time()
        k = fit()
        return time.process_time() - start, k

    def error_of(k: Float[np.ndarray, " coefficients"]) -> float:
        predicted = network.torque(k, patterns.q, patterns.qd, patterns.qdd)
        error = np.asarray(patterns.torque - predicted)
        return float(np.sqrt(np.mean(error**2) / np.mean(np.asarray(patterns.torque) ** 2)))

    seconds, k = timed(lambda: simulation_fit(network, patterns, links, _STRETCH, steps)[0])
    yield Metric(f"mujoco_sysid.{steps}_steps.processor", seconds, "s", "lower", 0.5)
    yield Metric(f"mujoco_sysid.{steps}_steps.torque_error", error_of(k), "1", "lower")
    solve = jc.LeastSquares()
    solve.fit(network, patterns)  # compiled before, as the toolbox's simulator is
    seconds, k = timed(lambda: np.asarray(solve.fit(network, patterns).k))
    yield Metric("mujoco_sysid.least_squares.processor", seconds, "s", "lower", 0.5)
    yield Metric("mujoco_sysid.least_squares.torque_error", error_of(k), "1", "lower")
    seconds, k = timed(lambda: np.asarray(jc.identify(network, recording).k))
    yield Metric("mujoco_sysid.identify.processor", seconds, "s", "lower", 0.5)
    yield Metric("mujoco_sysid.identify.torque_error", error_of(k), "1", "lower")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=3300)
    parser.add_argument("--steps", type=int, default=20, help="of the toolbox's search, at most")
    options = parser.parse_args(argv)
    if not installed():
        print("needs the package tabulate")
        return 1
    report(list(metrics(options.samples, options.steps)), {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

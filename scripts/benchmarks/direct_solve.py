"""Derivation, forward rate and streamed solve of a PUMA 560 in one process, beside Pinocchio."""

import subprocess
import sys
import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio

import jaxcslc as jc
from jaxcslc._environment import core_count
from scripts.benchmarks.c_code import pinocchio_model
from scripts.benchmarks.metrics import Metric, best_of
from scripts.benchmarks.solve_gpu import ceilings


jc.enable_x64()

_PATTERNS = 1_000_000
# Million patterns/s that the streamed solve is to reach, by cores.
_TARGETS = {2: 2.5, 16: 15.0}


def derivation() -> Iterator[Metric]:
    """Complete tables and the network object, each in a fresh process."""
    program = (
        "import time, jax, jaxcslc as jc; jc.enable_x64()\n"
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


def metrics() -> Iterator[Metric]:
    """Return all figures but those of derivation."""
    network = jc.derive(jc.puma560())
    k = true_coefficients(network)
    yield from forward(network, k)
    yield from direct_solve(network, k)


def forward(network: jc.CSLC, k: jax.Array) -> Iterator[Metric]:
    """The network's output for a batch held in memory."""
    q, qd, qdd = (jnp.asarray(x) for x in motion(_PATTERNS))
    start = time.perf_counter()
    torque = jax.jit(network.torque).lower(k, q, qd, qdd).compile()
    yield Metric("forward.compile", time.perf_counter() - start, "s", "lower", 0.5)
    seconds = best_of(lambda: torque(k, q, qd, qdd))
    yield Metric("forward.rate", _PATTERNS / seconds / 1e6, "million patterns/s", "higher")
    moved = 8.0 * 4 * network.joint_count * _PATTERNS
    limit = ceilings()["bytes/s"]
    yield Metric("forward.of_copy", moved / seconds / limit, "1", "higher")
    yield from pinocchio_torques(network)


def pinocchio_torques(network: jc.CSLC) -> Iterator[Metric]:
    """The recursion of Newton and Euler in Pinocchio's C++, on all threads."""
    if not hasattr(pinocchio, "rneaInParallel"):  # built without OpenMP
        return
    threads = core_count()
    pool = pinocchio.ModelPool(pinocchio_model(network.robot, network.robot.links or ()), threads)
    columns = [np.asfortranarray(x[: _PATTERNS // 4].T) for x in motion(_PATTERNS)]
    out = np.empty_like(columns[0])
    seconds = best_of(lambda: pinocchio.rneaInParallel(threads, pool, *columns, out), 3)
    rate = _PATTERNS // 4 / seconds / 1e6
    yield Metric("pinocchio.torque_all_threads", rate, "million patterns/s", "higher")


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
    yield Metric(
        "stream.compile", max(first - (time.perf_counter() - start), 0.0), "s", "lower", 0.5
    )

    def run() -> jax.Array:
        nonlocal fit
        fit = jc.LeastSquares(joint_weights="equal", errors="independent").fit_stream(
            network, chunks(_PATTERNS)
        )
        return fit.k

    seconds = best_of(run, 3)
    rate = _PATTERNS / seconds
    start = time.process_time()
    run()
    processor = time.process_time() - start
    target = _TARGETS.get(core_count())
    yield Metric("stream.rate", rate / 1e6, "million patterns/s", "higher", target=target)
    per_processor = _PATTERNS / processor / 1e6
    yield Metric("stream.rate_of_a_core", per_processor, "million patterns/processor s", "higher")
    sizes = np.array([len(support) + 1 for support in network.support])
    limits = ceilings()
    # Products alone: rows times a triangle, and the result times itself.
    moved, operations = 8.0 * 4 * sizes.sum() * rate, 4.0 * (sizes**2).sum() * rate
    yield Metric("stream.of_copy", moved / limits["bytes/s"], "1", "higher")
    yield Metric("stream.of_product", operations / limits["operations/s"], "1", "higher")
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


def true_coefficients(network: jc.CSLC) -> jax.Array:
    """Return those of the robot's link parameters and friction."""
    robot = network.robot
    assert robot.links is not None
    return network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)

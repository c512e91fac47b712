"""Rates and accuracy of the direct solve: on a GPU, on several, streamed to them, and on cores.

    python -m scripts.benchmarks.solve_gpu                    # some seconds at toy size
    python -m scripts.benchmarks.solve_gpu --patterns 1e8     # on a machine with GPUs
    python -m scripts.benchmarks.solve_gpu --cores 1e7        # on this machine's cores alone

Patterns are random states. Compiling and running are apart; bytes and operations are those of the
matrix products alone (columns written, read, multiplied, written and read again), in parts of what
a copy and a large product reach in the same run.
"""

import argparse
import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import jaxcslc as jc
from jaxcslc._environment import core_count
from jaxcslc.least_squares import Unknowns, dense_factors, factors_of, kernel_of, minimum
from scripts.benchmarks.exact_solution import exact_coefficients
from scripts.benchmarks.metrics import Metric, best_of


jc.enable_x64()

_ROBOTS = ("puma560", "panda")
_ACCURACY_PATTERNS, _SEED = 1 << 14, 20261123
# Million patterns/s to be reached.
_TARGETS = {
    "puma560, 1 gpu": 1500.0,
    "panda, 1 gpu": 400.0,
    "puma560 streamed, cpu, workers 2": 2.5,
    "puma560 streamed, cpu, workers 16": 15.0,
}
_SOLVER = jc.LeastSquares(joint_weights="equal", errors="independent")

Row = dict[str, Any]


def network_named(name: str) -> jc.CSLC:
    """PUMA 560 with the thesis's coefficients, Panda with base parameters."""
    if name == "puma560":
        return jc.derive(jc.puma560())
    return jc.derive(jc.panda(), lengths="numeric")


def random_patterns(network: jc.CSLC, count: int, mesh: Mesh | None) -> jc.Patterns:
    """Random states and torques, made on the device or spread over several."""
    n = network.joint_count
    sharding = None if mesh is None else NamedSharding(mesh, PartitionSpec("patterns"))

    def made() -> tuple[jax.Array, ...]:
        keys = jax.random.split(jax.random.key(0), 4)
        motion = (jax.random.uniform(key, (count, n), minval=-3.0, maxval=3.0) for key in keys)
        everything = jnp.ones((count, n), bool)
        return jnp.arange(count, dtype=float), *motion, everything, everything

    return jc.Patterns(*jax.block_until_ready(jax.jit(made, out_shardings=sharding)()))


def ceilings() -> Row:
    """Return what a copy and a product of large matrices reach: bytes/s and operations/s."""
    large = jax.default_backend() != "cpu"
    x = jnp.ones(1 << (29 if large else 22))
    copy, product = jax.jit(lambda x: x + 1.0), jax.jit(lambda x: x @ x)
    copied = best_of(lambda: copy(x))
    size = 8192 if large else 512
    matrix = jnp.asarray(np.random.default_rng(0).normal(size=(size, size)))
    multiplied = best_of(lambda: product(matrix))
    return {"bytes/s": 2 * x.nbytes / copied, "operations/s": 2 * size**3 / multiplied}


def solve_rate(name: str, count: int, ceiling: Row, devices: int = 1) -> Row:
    """Patterns in the memory of one or several devices to coefficients, `LeastSquares.fit`."""
    network = network_named(name)
    mesh = Mesh(np.array(jax.devices()[:devices]), ("patterns",)) if devices > 1 else None
    patterns = random_patterns(network, count, mesh)
    fit: Callable[[], Any] = lambda: _SOLVER.fit(network, patterns).k
    start = time.perf_counter()
    jax.block_until_ready(fit())
    first = time.perf_counter() - start
    seconds = best_of(fit, 3)
    sizes = np.array([len(support) + 1 for support in network.support])
    moved, operations = 8.0 * 4 * sizes.sum() * count, 4.0 * (sizes**2).sum() * count
    return {
        "row": f"{name}, {devices} {jax.default_backend()}",
        "patterns": count,
        "million patterns/s": count / seconds / 1e6,
        "seconds": seconds,
        "compile s": first - seconds,
        "bytes a pattern": moved / count,
        "operations a pattern": operations / count,
        "of copy": moved / seconds / ceiling["bytes/s"] / devices,
        "of product": operations / seconds / ceiling["operations/s"] / devices,
    }


def stream_rate(name: str, count: int, workers: int | None) -> Row:
    """Patterns in the host's memory, streamed: `LeastSquares.fit_stream`."""
    network = network_named(name)
    piece = min(1 << (21 if jax.default_backend() != "cpu" else 16), count)
    n = network.joint_count
    q, qd, qdd, torque = np.random.default_rng(0).uniform(-3.0, 3.0, (4, piece, n))
    everything = np.ones(q.shape, bool)
    patterns = jc.Patterns(np.arange(float(piece)), q, qd, qdd, torque, everything, everything)
    pieces = max(count // piece, 1)

    def fit() -> Any:
        chunks = (patterns for _ in range(pieces))
        return _SOLVER.fit_stream(network, chunks, workers=workers).k

    _SOLVER.fit_stream(network, [patterns], workers=1)
    start = time.process_time()
    seconds = best_of(fit, 2)
    processor = (time.process_time() - start) / 2
    return {
        "row": f"{name} streamed, {jax.default_backend()}, workers {workers or 'default'}",
        "patterns": pieces * piece,
        "million patterns/s": pieces * piece / seconds / 1e6,
        "million patterns/processor s": pieces * piece / processor / 1e6,
    }


def accuracy(name: str) -> Iterator[Row]:
    """Coefficients by products on the device and by reflections on the CPU beside exact ones.

    Torques have noise of a thousandth of them. Where coefficients are not determined, ranks alone.
    """
    network = network_named(name)
    n, cpu = network.joint_count, jax.devices("cpu")[0]
    unknowns, weights = Unknowns.of(network), np.ones(n)
    kernel = kernel_of(network, jax.default_backend())
    motions = {"all": np.ones(n), "1e-2": np.full(n, 1e-2), "1e-3": np.full(n, 1e-3)}
    motions["third joint still"] = np.where(np.arange(n) == 2, 0.0, 1.0)
    for motion_name, scale in motions.items():
        rng = np.random.default_rng(_SEED)
        k = rng.normal(size=network.size)
        q, qd, qdd = rng.uniform(-1.0, 1.0, (3, _ACCURACY_PATTERNS, n)) * scale
        with jax.default_device(cpu):
            torque = np.asarray(jax.jit(network.torque)(*(jnp.asarray(x) for x in (k, q, qd, qdd))))
            noisy = torque + 1e-3 * torque.std() * rng.normal(size=torque.shape)
            motion = q, qd, qdd, noisy, np.ones(q.shape)
        instants, mask = np.arange(float(len(q))), np.ones(q.shape, bool)
        on_host = jc.Patterns(instants, q, qd, qdd, noisy, mask, mask)
        reflected = minimum(unknowns, dense_factors(network, on_host), weights, None)
        products = minimum(unknowns, factors_of(network, motion, kernel)[0], weights, None)
        row: Row = {
            "row": f"{name}, motion {motion_name}",
            "condition": float(reflected.condition),
            "rank": int(products.rank),
            "rank by reflections": int(reflected.rank),
        }
        if reflected.rank == network.size:
            patterns = jax.tree.map(jnp.asarray, on_host)
            exact = exact_coefficients(network, motion)
            deviation = np.sqrt(reflected.variance * np.diag(reflected.inverse_gram))
            for what, coefficients in (
                ("reflections", reflected.k),
                ("products", products.k),
                ("fit", _SOLVER.fit(network, patterns).k),
            ):
                error = np.abs(np.asarray(coefficients) - exact) / deviation
                row[f"error of {what}, standard errors"] = float(np.max(error))
        yield row


def rows(patterns: int, cores: int | None) -> Iterator[Row]:
    """Return all measurements, one after the other."""
    if cores is not None:
        for workers in sorted({1, 2, core_count()}):
            yield stream_rate("puma560", cores * workers // core_count(), workers)
        yield stream_rate("panda", cores // 8, None)
        return
    ceiling = ceilings()
    yield {"row": f"ceilings, {jax.devices()[0].device_kind}", **ceiling}
    for name in _ROBOTS:
        yield from accuracy(name)
        yield solve_rate(name, patterns, ceiling)
        if len(jax.devices()) > 1:
            yield solve_rate(name, patterns, ceiling, 2)
            yield solve_rate(name, 2 * patterns, ceiling, 2)
    yield stream_rate("puma560", patterns // 2, None)


def metrics() -> Iterator[Metric]:
    """Return the metrics of all GPUs with 10⁸ patterns, or of the cores alone with 8 million."""
    on_gpu = jax.default_backend() != "cpu"
    for row in rows(int(1e8), None if on_gpu else int(8e6)):
        yield from metrics_of(row)


def metrics_of(row: Row) -> Iterator[Metric]:
    """The figures of a row, by its name."""
    name = re.sub(r"[^a-z0-9.]+", "_", row["row"].lower()).strip("_")
    directions = {"compile s": "lower", "largest difference, standard errors": "lower"}
    units = {"compile s": "s", "million patterns/s": "million patterns/s"}
    for key, value in row.items():
        if key in ("row", "patterns", "seconds") or key.endswith("a pattern"):
            continue
        figure = re.sub(r"[^a-z0-9]+", "_", key.lower()).strip("_")
        unit = units.get(key, key if "/" in key else "1")
        target = None
        if key == "million patterns/s" and row["row"] in _TARGETS:
            target = _TARGETS[row["row"]]
        better = "lower" if directions.get(key) == "lower" else "higher"
        yield Metric(f"{name}.{figure}", float(value), unit, better, target=target)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--patterns", type=float, default=1e4, help="of a PUMA 560")
    parser.add_argument("--cores", type=float, help="patterns; on cores alone")
    parser.add_argument("--out", type=Path, help="a JSON file of all rows")
    options = parser.parse_args(argv)
    measured: list[Row] = []
    for row in rows(int(options.patterns), options.cores and int(options.cores)):
        measured.append(row)
        shown = (f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())
        print(", ".join(shown), flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(measured, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

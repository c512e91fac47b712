"""Rates of torque, forward dynamics and regressor columns, by every evaluator and precision.

    python -m scripts.benchmarks.evaluation                    # on this machine's processor
    python -m scripts.benchmarks.evaluation --samples 2e7      # on a GPU

Random states in the memory of JAX's default device. Compiling and running are apart; the share of
the limit is the bytes of inputs and outputs, moved at the rate of a copy in the same run.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

import jaxcslc as jc
from scripts.benchmarks.metrics import Metric, best_of, report


jc.enable_x64()

Evaluation = Callable[..., Any]


def networks() -> Iterator[tuple[str, jc.CSLC]]:
    """The PUMA 560's tables, and the Panda's recursion in both forms."""
    yield "puma560.tables", jc.derive(jc.puma560())
    yield "panda.rolled", jc.derive(jc.panda(), lengths="numeric", evaluator="rolled")
    yield "panda.unrolled", jc.derive(jc.panda(), lengths="numeric", evaluator="unrolled")


def evaluations(network: jc.CSLC) -> Iterator[tuple[str, Evaluation, int]]:
    """Functions of k, q, qd and qdd, the part of the samples that they get, and their outputs."""
    n = network.joint_count
    yield "torque", network.torque, n

    def columns(k: jax.Array, *motion: jax.Array) -> Any:
        del k
        return network.columns(*(x.T for x in motion))

    yield "columns", columns, sum(len(row) for row in network.support)
    yield "forward_dynamics", network.forward_dynamics, n


def copy_rate(size: int) -> float:
    """Bytes/s of a copy, read and written."""
    x = jnp.ones(size)
    copy = jax.jit(lambda x: x + 1.0)
    copy(x)
    return 2 * x.nbytes / best_of(lambda: copy(x))


def metrics(samples: int) -> Iterator[Metric]:
    """Million samples/s, seconds of compiling, and the share of a copy's rate."""
    limit = copy_rate(min(10 * samples, 1 << 28))
    for name, network in networks():
        n = network.joint_count
        k = jnp.ones(network.size)
        for dtype in (jnp.float32, jnp.float64):
            keys = list(jax.random.split(jax.random.key(0), 3))
            whole = [jax.random.uniform(key, (samples, n), dtype, -3.0, 3.0) for key in keys]
            for what, function, outputs in evaluations(network):
                # Columns are a hundred numbers a sample, a mass matrix and its factors as many.
                count = samples if what == "torque" else max(samples // 10, 1)
                motion = [x[:count] for x in whole]
                start = time.perf_counter()
                compiled = jax.jit(function).lower(k.astype(dtype), *motion).compile()
                compiling = time.perf_counter() - start
                run = partial(compiled, k.astype(dtype), *motion)
                jax.block_until_ready(run())
                seconds = best_of(run, 3)
                key = f"{name}.{what}.{dtype.__name__}"
                yield Metric(f"{key}.compile", compiling, "s", "lower", 0.5)
                yield Metric(key, count / seconds / 1e6, "million samples/s", "higher")
                moved = (3 * n + outputs) * jnp.dtype(dtype).itemsize * count
                yield Metric(f"{key}.of_copy", moved / seconds / limit, "1", "higher")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=float, default=2e5)
    parser.add_argument("--out", type=Path, help="a JSON file of all figures")
    options = parser.parse_args(argv)
    measured: list[Metric] = []
    for metric in metrics(int(options.samples)):
        print(f"  {metric.name} {metric.value:.4g} {metric.unit}", flush=True)
        measured.append(metric)
        if options.out is not None:
            options.out.write_text(json.dumps({m.name: m.value for m in measured}, indent=1))
    report(measured, {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Time trainings of the PUMA 560's CSLC: one, many side by side, and on normal equations.

Prints named metrics with unit and direction; compile and run time apart. The weights of
trainings side by side are compared with those of one training alone.

    python -m scripts.benchmarks.training                        256 trainings, this machine
    python -m scripts.benchmarks.training --trainings 4096       as for a GPU
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
from jaxcslc.training import (
    PERAL,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    Plan,
    examples,
    half_square,
    inverse_dynamics,
    train,
    with_normal_equations,
)
from scripts.benchmarks.metrics import Metric, report


jc.enable_x64()


def timed(
    network: AdaptiveNetwork,
    patterns: Examples,
    weights: jax.Array,
    plan: Plan,
    epochs: int,
    block: int | None = None,
) -> tuple[float, float, jax.Array]:
    """Seconds of the first and of the second training, the same but for compiling; its weights."""

    def once() -> tuple[float, jax.Array]:
        start = time.perf_counter()
        result = train(
            network,
            patterns,
            weights,
            plan,
            epochs=epochs,
            chunk=epochs,
            keep_weights=False,
            block=block,
            throw=False,
        )
        jax.block_until_ready(result.weights)
        return time.perf_counter() - start, result.weights

    (first, _), (second, result) = once(), once()
    return first, second, result


def recorded_patterns() -> jc.Patterns:
    """Return those of the simulated training recording, 3,300 samples."""
    import sim

    recording = sim.simulate(sim.puma560(), sim.training(), seed=1).recording
    return jc.prepare(recording, threshold_fraction=0.01)


def random_patterns(cslc: jc.CSLC, samples: int) -> jc.Patterns:
    """Random states with their torques, where there is no simulator."""
    q, qd, qdd = np.random.default_rng(0).uniform(-2.0, 2.0, (3, samples, cslc.joint_count))
    torque = np.asarray(jax.jit(cslc.torque)(jnp.ones(cslc.size), q, qd, qdd))
    mask = np.ones(q.shape, bool)
    return jc.Patterns(0.01 * np.arange(samples), q, qd, qdd, torque, mask, mask)


def training(
    trainings: int = 256, epochs: int = 100, block: int | None = None, samples: int | None = None
) -> Iterator[Metric]:
    """PERAL on the training recording, or random states, and backpropagation on its equations."""
    cslc = jc.derive(jc.puma560())
    network = inverse_dynamics(cslc)
    patterns = recorded_patterns() if samples is None else random_patterns(cslc, samples)
    training_set = examples(network, patterns, patterns.torque, patterns.mask)
    samples = training_set.targets.shape[-1]
    start = jnp.asarray(
        jc.LeastSquares(joint_weights="equal", errors="independent").fit(cslc, patterns).k
    ) * (1.0 + 0.3 * np.random.default_rng(0).normal(size=network.size))

    def rate(seconds: float, passed: int, number: int = 1) -> float:
        return samples * passed * number / seconds / 1e6

    unit = "million pattern-epochs/s"
    for name, plan in (
        ("fixed_rates", Plan(PERAL(), FixedRates(0.05))),
        ("adapted_rates", Plan(PERAL(), AdaptedRates(0.05))),
    ):
        first, second, alone = timed(network, training_set, start, plan, epochs)
        yield Metric(f"peral.{name}.compile", first - second, "s", "lower", 0.5)
        yield Metric(f"peral.{name}.rate", rate(second, epochs), unit, "higher")
        starts = start * (
            1.0 + 0.01 * np.random.default_rng(1).normal(size=(trainings, network.size))
        )
        starts = starts.at[0].set(start)
        few = max(epochs // 20, 2)
        first, many, _ = timed(network, training_set, starts, plan, few, block)
        yield Metric(f"peral.{name}.{trainings}.compile", first - many, "s", "lower", 0.5)
        together = rate(many, few, trainings)
        yield Metric(f"peral.{name}.{trainings}.rate", together, unit, "higher")
        factor = together / rate(second, epochs)
        yield Metric(f"peral.{name}.{trainings}.over_single", factor, "1", "higher")
        one = timed(network, training_set, start, plan, few)[2]
        both = timed(network, training_set, starts[:2], plan, few, block)[2]
        error = float(jnp.max(jnp.abs(both[0] - one)) / jnp.max(jnp.abs(alone)))
        yield Metric(f"peral.{name}.disagreement", error, "1", "lower", 10.0)

    equations = with_normal_equations(network, training_set)
    plan = Plan(Backpropagation(), AdaptedRates(1e-3), cost=half_square, patience=10**9)
    passed = 200 * epochs
    first, second, _ = timed(network, equations, start, plan, passed)
    yield Metric("normal_equations.compile", first - second, "s", "lower", 0.5)
    yield Metric("normal_equations.rate", passed / second, "epochs/s", "higher")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--trainings", type=int, default=256)
    parser.add_argument("--epochs", type=int, default=100, help="of the single training")
    parser.add_argument("--block", type=int, default=None, help="trainings side by side")
    parser.add_argument("--samples", type=int, help="random states, not the simulated recording")
    options = parser.parse_args(argv)
    if min(options.trainings, options.epochs) < 2:
        parser.error("--trainings and --epochs must be at least 2")
    metrics: list[Metric] = []
    for metric in training(options.trainings, options.epochs, options.block, options.samples):
        print(f"  {metric.name} {metric.value:.4g} {metric.unit}", file=sys.stderr, flush=True)
        metrics.append(metric)
    report(metrics, {})
    device = jax.devices()[0]
    peak = (device.memory_stats() or {}).get("peak_bytes_in_use", 0)
    print(f"# on {device.device_kind}" + (f", peak {peak / 1e9:.2f} GB" if peak else ""))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

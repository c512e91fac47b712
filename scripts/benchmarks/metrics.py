"""Named metrics with unit and direction, timing, and the comparison with a baseline."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax


@dataclass(frozen=True)
class Metric:
    """One figure.

    - `tolerance`: the relative change that counts as one.
    - `target`: what is to be reached, if anything.
    """

    name: str
    value: float
    unit: str
    better: Literal["lower", "higher"]
    tolerance: float = 0.25
    target: float | None = None


def best_of(function: Callable[[], Any], repeats: int = 5) -> float:
    """Shortest of several run times [s], each until the result is there."""
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return min(times)


def report(metrics: Sequence[Metric], baseline: Mapping[str, float]) -> int:
    """Prints metrics beside the baseline.

    **Returns** how many became worse by more than their tolerance.
    """
    worse = 0
    print(f"{'metric':32} {'value':>10} {'baseline':>10} {'change':>8}  unit")
    for metric in metrics:
        line = f"{metric.name:32} {metric.value:10.4g}"
        before = baseline.get(metric.name)
        if before:
            change = metric.value / before - 1
            bad = change > metric.tolerance
            if metric.better == "higher":
                bad = change < -metric.tolerance / (1 + metric.tolerance)
            worse += bad
            line += f" {before:10.4g} {change:+8.1%}{'!' if bad else ' '}"
        else:
            line += f" {'-':>10} {'':8} "
        aim = "" if metric.target is None else f", target {metric.target:g}"
        print(f"{line} {metric.unit}, {metric.better} is better{aim}")
    return worse

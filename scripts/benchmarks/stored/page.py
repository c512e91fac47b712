"""The page of benchmarks: a table a group and machine, written from the committed figures."""

from collections.abc import Iterable
from pathlib import Path

from scripts.benchmarks.groups import GROUPS
from scripts.benchmarks.metrics import Metric
from scripts.benchmarks.stored.results import Measurement


PAGE = Path(__file__).parents[3] / "docs" / "benchmarks.md"
_BEGINNING = """# Benchmarks

- `identify` answers in seconds on two cores, from the shell to the page.
- A fit streams patterns two to seven times as fast as Pinocchio computes its regressor in C++.
- Every group names its machine and its day. Targets that are met are bold.

![Bars: seconds of three identifications, first and later run](images/evidence/scale.svg)

`make bench` measures these figures, and `make bench ARGS=--update` writes this page. Each table
says on which machine and day it was measured. A group that is not run again keeps its figures, as
in `make bench ARGS="--groups 'first answer' --update"`. To add another machine, write a file there
with `--out FILE`, and read it here with `--merge FILE`. [Speed and scale](scale.md) explains what
limits the figures.

Seconds are wall-clock time, or processor time where the name says so. Other processes that ran or
waited for a core when a group began are counted: they make wall-clock times and rates worse.
Compiling and running are measured separately. A target that is met is **bold**.
"""


def page(measurements: Iterable[Measurement]) -> str:
    """The page in Markdown, groups in the order in which they are listed."""
    by_group: dict[str, list[Measurement]] = {}
    for measurement in measurements:
        by_group.setdefault(measurement.group, []).append(measurement)
    parts = [_BEGINNING]
    for name, group in GROUPS.items():
        if name not in by_group:
            continue
        parts.append(f"## {name[0].upper()}{name[1:]}\n\n{group.text}\n")
        parts += [_table(measurement) for measurement in by_group[name]]
    return "\n".join(parts)


def _table(measurement: Measurement) -> str:
    targets = any(metric.target is not None for metric in measurement.metrics)
    head = ["figure", "value", "unit", "better", *(["target"] if targets else [])]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for metric in measurement.metrics:
        value = f"**{metric.value:.3g}**" if _met(metric) else f"{metric.value:.3g}"
        unit = "" if metric.unit == "1" else metric.unit
        cells = [f"`{metric.name}`", value, unit, metric.better]
        if targets:
            cells.append("" if metric.target is None else f"{metric.target:g}")
        lines.append(f"| {' | '.join(cells)} |")
    load = f", {measurement.load:g} other processes" if measurement.load >= 0.5 else ""
    return f"{measurement.machine}; {measurement.date}{load}:\n\n" + "\n".join(lines) + "\n"


def _met(metric: Metric) -> bool:
    if metric.target is None:
        return False
    if metric.better == "lower":
        return metric.value <= metric.target
    return metric.value >= metric.target

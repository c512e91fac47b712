"""Measured figures by group and machine, kept in a file: a group that is not run keeps its own."""

import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import jax

from jaxcslc._environment import core_count
from scripts.benchmarks.metrics import Metric


RESULTS = Path(__file__).with_name("results.json")
"""The committed figures: the baseline of later runs, and what the page shows."""


@dataclass(frozen=True)
class Measurement:
    """The figures of one group on one machine.

    **Attributes**

    - `group`: its name in `scripts.benchmarks.groups`.
    - `machine`, `date`: in words, and in ISO's form.
    - `metrics`: the figures.
    - `load`: processes that ran or waited for a core before, the mean of a minute.
    """

    group: str
    machine: str
    date: str
    metrics: tuple[Metric, ...]
    load: float = 0.0

    @classmethod
    def of(cls, group: str, metrics: Iterable[Metric], machine: str | None = None) -> "Measurement":
        """Figures that are measured now, on this machine unless another one is named."""
        load = round(os.getloadavg()[0], 1)
        return cls(group, machine or this_machine(), date.today().isoformat(), tuple(metrics), load)


def this_machine() -> str:
    """Cores, processor, memory and GPUs of this machine."""
    pages = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    cores = core_count()
    processor = _processor()
    parts = [f"{cores} core{'s' * (cores > 1)}, {processor}", f"{pages / 2**30:.0f} GiB"]
    devices = jax.devices()
    if devices[0].platform != "cpu":
        parts.append(f"{len(devices)} {devices[0].device_kind}")
    return ", ".join(parts)


def _processor() -> str:
    file = Path("/proc/cpuinfo")  # Linux alone says it here
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    names = (line.partition(":")[2] for line in lines if line.startswith("model name"))
    return " ".join(next(names, platform.processor() or platform.machine()).split())


def load(path: Path = RESULTS) -> list[Measurement]:
    """Measurements of a file, none if there is none.

    **Raises** `ValueError` for a file of something else.
    """
    if not path.exists():
        return []
    document: Any = json.loads(path.read_text(encoding="utf-8"))
    try:
        return [_measurement(entry) for entry in document]
    except (TypeError, KeyError) as error:
        raise ValueError(f"{path}: expected measurements: {error}") from None


def _measurement(entry: Mapping[str, Any]) -> Measurement:
    metrics = tuple(Metric(**metric) for metric in entry["metrics"])
    load = float(entry.get("load", 0.0))
    return Measurement(entry["group"], entry["machine"], entry["date"], metrics, load)


def save(measurements: Iterable[Measurement], path: Path = RESULTS) -> None:
    """Writes measurements, five digits of each figure."""
    document = [asdict(measurement) for measurement in measurements]
    for entry in document:
        for metric in entry["metrics"]:
            metric["value"] = float(f"{metric['value']:.5g}")
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def merged(earlier: Iterable[Measurement], later: Iterable[Measurement]) -> list[Measurement]:
    """Return all of them; later ones instead of earlier ones of the same group and machine."""
    by_key = {(x.group, x.machine): x for x in (*earlier, *later)}
    return sorted(by_key.values(), key=lambda x: (x.group, x.machine))


def baseline_of(measurements: Iterable[Measurement], machine: str) -> dict[str, float]:
    """The values of one machine, by name."""
    return {
        metric.name: metric.value
        for measurement in measurements
        if measurement.machine == machine
        for metric in measurement.metrics
    }
